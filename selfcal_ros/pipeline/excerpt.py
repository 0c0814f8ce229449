# Copyright 2026 selfcal_ros contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""A part of a recording: from when, how long, and every how many images."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace
import math
from typing import get_args, Literal, TYPE_CHECKING

from selfcal_ros.errors import ArgumentError

if TYPE_CHECKING:
    import numpy as np

#: Halves of an image that may be the image of a camera of its own.
Half = Literal['left', 'right', 'top', 'bottom']
HALVES: tuple[Half, ...] = get_args(Half)
#: Stamps of a bag may lie so far out of order, seconds; reading goes on for so long.
DISORDER_S = 1.0
#: A stamp far beyond the end may be a wrong one; after so many in a row nothing is to come.
SURELY_OVER = 10


@dataclass(frozen=True)
class Excerpt:
    """
    Which images of a recording are used, and what of them; all of all by default.

    Parameters
    ----------
    start_s : float
        Seconds from the first image on that are passed over. Images of a folder count as 30 a
        second, because they have no clock.
    duration_s : float, optional
        Seconds that are used.
    every : int
        One of so many images is used, from the first within on.
    half : {'left', 'right', 'top', 'bottom'}, optional
        The half of each image that is used, as where a stereo camera puts two views into one.

    Raises
    ------
    ArgumentError
        If a number is impossible.

    """

    start_s: float = 0.0
    duration_s: float | None = None
    every: int = 1
    half: Half | None = None

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        if not (math.isfinite(self.start_s) and self.start_s >= 0):
            raise ArgumentError(f'The start must be zero or more seconds, not {self.start_s:g}.')
        if self.duration_s is not None and not (math.isfinite(self.duration_s)
                                                and self.duration_s > 0):
            raise ArgumentError('The duration must be a positive number of seconds, not '
                                f'{self.duration_s:g}.')
        if self.every < 1:
            raise ArgumentError(f'Every how many images must be 1 or more, not {self.every}.')
        if self.half is not None and self.half not in HALVES:
            raise ArgumentError(f'The half of the images is one of {", ".join(HALVES)}, not '
                                f'{self.half!r:.40}.')

    @property
    def is_whole(self) -> bool:
        """Tell whether every image is used."""
        return replace(self, half=None) == Excerpt()

    def cut(self, image: np.ndarray) -> np.ndarray:
        """Return the part of an image (H, W) or (H, W, 3) that is used, without a copy."""
        height, width = image.shape[0] // 2, image.shape[1] // 2
        if self.half == 'left':
            return image[:, :width]
        if self.half == 'right':
            return image[:, -width:]
        if self.half == 'top':
            return image[:height]
        return image[-height:] if self.half == 'bottom' else image

    def among(self, count: int, rate_hz: float) -> int:
        """Return how many of `count` images at a rate are used, roughly."""
        left_s = count / rate_hz - self.start_s
        used_s = left_s if self.duration_s is None else min(left_s, self.duration_s)
        return max(math.ceil(round(used_s * rate_hz) / self.every), 0)

    def __str__(self) -> str:
        """Name the part in words."""
        words = []
        if self.start_s or self.duration_s is not None:
            words.append(f'from {self.start_s:g} s on')
        if self.duration_s is not None:
            words.append(f'{self.duration_s:g} s long')
        if self.every > 1:
            words.append(f'one of {self.every} images')
        if self.half:
            words.append(f'{self.half} half')
        return ', '.join(words)


class Reading:
    """
    Says image by image, in the order of recording, what an excerpt uses.

    Parameters
    ----------
    excerpt : Excerpt
    wanted : container of int, optional
        Only these images of the excerpt, by their count in the recording. After the largest of a
        set nothing is read.

    Attributes
    ----------
    past_s : float
        Time of the newest image that was asked for, seconds from the first.
    used : int
        Images that the excerpt uses so far.

    """

    def __init__(self, excerpt: Excerpt, wanted: Container[int] | None = None) -> None:
        """Start before the first image."""
        self._excerpt, self._wanted = excerpt, wanted
        self._last = max(wanted, default=-1) if isinstance(wanted, set) else None
        self._first_ns: int | None = None
        self.past_s = 0.0
        self.used = self._inside = self._beyond = 0

    def uses(self, index: int, stamp_ns: int) -> bool:
        """Tell whether an image is to be decoded."""
        if self._first_ns is None:
            self._first_ns = stamp_ns
        self.past_s = 1e-9 * (stamp_ns - self._first_ns)
        # stamps are whole nanoseconds
        after_s = self.past_s - self._excerpt.start_s + 1e-9
        if after_s < 0 or self._excerpt.duration_s is not None and \
                after_s >= self._excerpt.duration_s:
            return False
        self._inside, self._beyond = self._inside + 1, 0
        if (self._inside - 1) % self._excerpt.every:
            return False
        self.used += 1
        return self._wanted is None or index in self._wanted

    def is_over(self, index: int) -> bool:
        """Tell whether nothing is to come after this image, which was asked for."""
        if self._last is not None and index >= self._last:
            return True
        end = self._excerpt.duration_s
        if end is None or self.past_s <= self._excerpt.start_s + end + DISORDER_S:
            return False
        self._beyond += 1
        return self._beyond >= SURELY_OVER
