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
"""How a tracked object moves while an image is read, from its poses in the images beside it."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.rotation import rotation_vector


class PosesInTime:
    """Poses of an object that is followed."""

    def __init__(self) -> None:
        """Begin without any."""
        self._stamps_ns: list[int] = []
        self._poses: list[tuple[np.ndarray, np.ndarray] | None] = []

    def add(self, stamp_ns: int, pose: tuple[np.ndarray, np.ndarray] | None) -> None:
        """Take in an image: its pose (3, 3) and (3,), None where nothing was followed."""
        self._stamps_ns.append(stamp_ns)
        self._poses.append(pose)

    @property
    def interval_s(self) -> float | None:
        """Time between two images, in the median; None where there is no such time."""
        steps = np.diff(self._stamps_ns)
        return 1e-9 * float(np.median(steps)) if len(steps) and np.median(steps) > 0 else None

    def move_a_second(self, stamp_ns: int) -> np.ndarray | None:
        """
        Tell how the object moves at an image, between its poses in those beside it.

        Parameters
        ----------
        stamp_ns : int
            Of the image, which was taken in.

        Returns
        -------
        ndarray, shape (6,), or None
            Turn about the camera's axes and shift in a second; None where no other image tells.

        """
        at = self._stamps_ns.index(stamp_ns)
        near = [k for k in (at - 1, at, at + 1) if 0 <= k < len(self._poses)]
        known = [(self._stamps_ns[k], pose) for k in near if (pose := self._poses[k]) is not None]
        if not known or known[-1][0] <= known[0][0]:
            return None
        (first_ns, first), (last_ns, last) = known[0], known[-1]
        turn = rotation_vector(last[0] @ first[0].T)
        return np.concatenate([turn, last[1] - first[1]]) / (1e-9 * (last_ns - first_ns))
