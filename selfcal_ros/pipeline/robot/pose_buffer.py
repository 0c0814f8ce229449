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
"""Poses as they come, in bounded memory: dense where images were kept, sparse elsewhere."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from selfcal_ros.pipeline.robot.pose_topics import OVERTAKEN_NS

#: Poses that are kept at most: a hundred seconds at 200 Hz, and then those around the images.
MOST_POSES = 20_000
#: So far from an image poses may still be of use: clocks differ by half a second at most.
NEAR_IMAGE_NS = 800_000_000
#: A clock counts as set back when so many poses in a row, in order, say so: one may be a stray.
CONFIRMED_BACK = 3


class PoseBuffer:
    """
    Instants and poses of one body, in the order of time.

    A stray stamp, ahead or behind, costs at most the poses that contradict what follows it.

    Parameters
    ----------
    most : int, optional

    Attributes
    ----------
    set_back : int
        How often the clock was set back: what had been later was dropped.

    """

    def __init__(self, most: int = MOST_POSES) -> None:
        self._most = most
        self._poses: dict[int, np.ndarray] = {}
        self._newest = 0
        self._behind: list[tuple[int, np.ndarray]] = []
        self.set_back = 0

    def __len__(self) -> int:
        """Count the poses."""
        return len(self._poses)

    def add(self, stamp_ns: int, pose: np.ndarray) -> None:
        """
        Take a pose; of two at one instant the later counts.

        Parameters
        ----------
        stamp_ns : int
        pose : ndarray, shape (4, 4)

        """
        if self._poses and stamp_ns < self._newest - OVERTAKEN_NS:
            if self._behind and stamp_ns <= self._behind[-1][0]:
                self._behind = []
            self._behind.append((stamp_ns, pose))
            if len(self._behind) >= CONFIRMED_BACK:
                self._begin_again()
            return
        self._behind = []
        self._poses[stamp_ns] = pose
        self._newest = max(self._newest, stamp_ns)

    def _begin_again(self) -> None:
        """Go on where the clock has been set to; what was before that remains."""
        begin = self._behind[0][0]
        self._poses = {stamp: pose for stamp, pose in self._poses.items() if stamp < begin}
        self._poses.update(self._behind)
        self._newest, self._behind = self._behind[-1][0], []
        self.set_back += 1

    def thin(self, images_ns: Iterable[int]) -> None:
        """
        Keep within the bound: of what is far from all images every second goes, then the oldest.

        Parameters
        ----------
        images_ns : iterable of int
            Instants of the images that are kept.

        """
        if len(self._poses) <= self._most:
            return
        stamps = np.sort(np.fromiter(self._poses, np.int64, len(self._poses)))
        images = np.sort(np.fromiter(images_ns, np.int64))
        far = np.ones(len(stamps), bool)
        if len(images):
            after = np.searchsorted(images, stamps).clip(0, len(images) - 1)
            apart = np.minimum(np.abs(stamps - images[after]),
                               np.abs(stamps - images[np.maximum(after - 1, 0)]))
            far = apart > NEAR_IMAGE_NS
        # what just came may be near an image that is on its way
        far &= stamps < stamps[-1] - NEAR_IMAGE_NS
        gone = np.flatnonzero(far)[::2]
        kept = np.delete(stamps, gone)[-(self._most * 3 // 4):] if (
            len(stamps) - len(gone) > self._most) else np.delete(stamps, gone)
        self._poses = {stamp: self._poses[stamp] for stamp in kept.tolist()}

    @property
    def is_full(self) -> bool:
        """Whether `thin` is due."""
        return len(self._poses) > self._most

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps (N,), ascending, and poses (N, 4, 4)."""
        stamps = np.array(sorted(self._poses), np.int64)
        if not len(stamps):
            return stamps, np.zeros((0, 4, 4))
        return stamps, np.array([self._poses[stamp] for stamp in stamps.tolist()])
