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
"""Where the points of an image were in the images just before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SeenPoints:
    """
    The points of one image.

    Attributes
    ----------
    ids : ndarray of int, shape (M,)
        Ascending.
    xy : ndarray, shape (M, 2)
        Pixels.
    stamp_ns : int

    """

    ids: np.ndarray
    xy: np.ndarray
    stamp_ns: int

    def beside(self, other: SeenPoints | None) -> np.ndarray:
        """
        Look the points up in another image.

        Returns
        -------
        ndarray, shape (M, 3)
            Pixels there, and seconds from here to there; NaN for points that are not seen there.

        """
        found = np.full((len(self.ids), 3), np.nan)
        if other is None or other.stamp_ns == self.stamp_ns:
            return found
        _, here, there = np.intersect1d(self.ids, other.ids, assume_unique=True,
                                        return_indices=True)
        found[here, :2] = other.xy[there]
        found[here, 2] = 1e-9 * (other.stamp_ns - self.stamp_ns)
        return found


@dataclass
class Filmed:
    """
    An image of a video that is kept, between the two beside it.

    Attributes
    ----------
    points : SeenPoints
    before, after : SeenPoints or None
        None at the ends of the video, and before the next image has come.

    """

    points: SeenPoints
    before: SeenPoints | None = None
    after: SeenPoints | None = None

    @property
    def neighbours(self) -> np.ndarray:
        """Pixels and seconds of the points before and after, (M, 2, 3); NaN where not seen."""
        return np.stack([self.points.beside(self.before), self.points.beside(self.after)], axis=1)


class Film:
    """
    Remembers what is beside the images that are kept.

    Attributes
    ----------
    newest : SeenPoints or None
        The points of the last image.

    """

    def __init__(self) -> None:
        """Start without an image."""
        self.newest: SeenPoints | None = None
        self._before: SeenPoints | None = None
        self._open: Filmed | None = None

    def add(self, points: SeenPoints) -> None:
        """Take the next image; it is the one after the last, if that was kept."""
        if self._open is not None:
            self._open.after, self._open = points, None
        self._before, self.newest = self.newest, points

    def keep(self) -> Filmed:
        """Keep the newest image."""
        assert self.newest is not None
        self._open = Filmed(self.newest, self._before)
        return self._open
