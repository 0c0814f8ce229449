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

from typing import Any

#: Stamps of one instant differ by no more than this, nanoseconds.
SAME_NS = 10_000_000
#: Where the last depth image is older than this, none is waited for.
SILENT_NS = 1_000_000_000


class DepthPairing:
    """
    Brings images together with depth images, whichever comes first.

    An image waits for its depth until the next image comes, and then goes without. Nothing
    waits before the first depth image, or a second after the last.
    """

    def __init__(self) -> None:
        """Start with nothing."""
        self._image: tuple[int, Any] | None = None
        self._depth: tuple[int, Any] | None = None

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
        if self._depth is None or stamp_ns - self._depth[0] > SILENT_NS:
            self._image = None
            return [*done, (image, None)]
        return done + self._matched()

    def depth(self, stamp_ns: int, depth: Any) -> list[tuple[Any, Any]]:
        """Take a depth image; returns what is complete now."""
        self._depth = stamp_ns, depth
        return self._matched()

    def _matched(self) -> list[tuple[Any, Any]]:
        if self._image is None or self._depth is None or abs(
                self._image[0] - self._depth[0]) > SAME_NS:
            return []
        pair = self._image[1], self._depth[1]
        self._image = None
        return [pair]
