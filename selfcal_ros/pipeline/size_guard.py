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
"""Which size of images to follow where several come on one topic."""

from __future__ import annotations

#: A size is left once nothing of it has come for so long, in seconds and in its own intervals.
PATIENCE_S, PATIENCE_INTERVALS = 0.5, 3.0
#: Of another size that came between the images that are followed, nothing is said after so long.
MIXED_S = 10.0


class SizeGuard:
    """
    Tells images of a camera that changed its resolution from those of two cameras on one topic.

    A camera that changes its resolution sends nothing of the former size any more. Of two cameras
    on one topic, the one that was there first is kept to.

    Attributes
    ----------
    size : (int, int) or None
        Of the images to follow.

    """

    def __init__(self) -> None:
        self.size: tuple[int, int] | None = None
        self._seen_s = self._interval_s = 0.0
        self._stray: tuple[tuple[int, int], float] | None = None
        self._mixed: tuple[tuple[int, int], float] | None = None

    def takes(self, size: tuple[int, int], now_s: float) -> bool:
        """
        Tell whether an image is one to follow; `size` is that of the followed ones from then on.

        Parameters
        ----------
        size : (int, int)
            Width and height.
        now_s : float
            When it came, by a clock that never jumps.

        """
        silent_s = now_s - self._seen_s
        if size == self.size:
            self._interval_s += 0.2 * (silent_s - self._interval_s)
            # the former size goes on although another has come: they are of two cameras
            self._mixed, self._stray = self._stray or self._mixed, None
        elif self.size is not None and silent_s <= max(
                PATIENCE_S, PATIENCE_INTERVALS * self._interval_s):
            self._stray = size, now_s
            return False
        else:
            self.size, self._interval_s, self._stray, self._mixed = size, 0.0, None, None
        self._seen_s = now_s
        return True

    def mixed_with(self, now_s: float) -> tuple[int, int] | None:
        """Return the size of images that lately came between those that are followed."""
        if self._mixed is None or now_s - self._mixed[1] > MIXED_S:
            return None
        return self._mixed[0]
