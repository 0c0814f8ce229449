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
"""Pairs images with depth images by stamp; an image waits for a limited time only."""

from __future__ import annotations

from collections import deque
from typing import Any

from selfcal_ros.pipeline.stamp_order import stamp_order, StampOrder

#: Stamps of one instant differ by no more than this, nanoseconds.
SAME_NS = 10_000_000
#: Where the last depth image is older than this, none is waited for.
SILENT_NS = 1_000_000_000
#: Depth images are kept for so long: they may come before their images.
KEPT_NS = 500_000_000
#: So many of them at most, whatever their stamps say: half a second at 120 Hz.
MOST_KEPT = 60


class DepthPairing:
    """
    Brings images together with depth images, whichever comes first.

    An image waits for its depth until the next image comes, and then goes without. Nothing
    waits before the first depth image, or a second after the last. Where their time jumps back
    the depth images of before are forgotten.
    """

    def __init__(self) -> None:
        """Start with nothing."""
        self._image: tuple[int, Any] | None = None
        self._depths: deque[tuple[int, Any]] = deque(maxlen=MOST_KEPT)

    def image(self, stamp_ns: int, image: Any) -> list[tuple[Any, Any]]:
        """
        Take an image.

        Parameters
        ----------
        stamp_ns : int
        image : object

        Returns
        -------
        list of (image, depth or None)
            What is complete now, or waited long enough, in the order of time.

        """
        done = [] if self._image is None else [(self._image[1], None)]
        self._image = stamp_ns, image
        if not self._depths or abs(stamp_ns - self._depths[-1][0]) > SILENT_NS:
            self._image = None
            return [*done, (image, None)]
        return done + self._matched()

    def depth(self, stamp_ns: int, depth: Any) -> list[tuple[Any, Any]]:
        """Take a depth image; returns what is complete now."""
        newest_ns = self._depths[-1][0] if self._depths else None
        if stamp_order(stamp_ns, newest_ns) is StampOrder.JUMPED_BACK:
            self._depths.clear()
        self._depths.append((stamp_ns, depth))
        while self._depths[-1][0] - self._depths[0][0] > KEPT_NS:
            self._depths.popleft()
        return self._matched()

    def _matched(self) -> list[tuple[Any, Any]]:
        if self._image is None:
            return []
        stamp_ns, image = self._image
        near = min(self._depths, key=lambda one: abs(one[0] - stamp_ns), default=None)
        if near is None or abs(near[0] - stamp_ns) > SAME_NS:
            return []
        self._image = None
        return [(image, near[1])]
