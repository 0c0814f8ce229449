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

from selfcal_ros.calibration.bundle.clock import difference_weights
from selfcal_ros.geometry.rotation import rotation_vector

#: So many images on either side tell how the object moves.
BESIDE = 2


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
        Tell how the object moves at an image, from its poses in those beside it.

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
        here = self._poses[at]
        near = range(max(at - BESIDE, 0), min(at + BESIDE + 1, len(self._poses)))
        known = [(self._stamps_ns[k], pose) for k in near if (pose := self._poses[k]) is not None]
        times = 1e-9 * (np.array([stamp for stamp, _ in known], float) - stamp_ns)
        if here is None or len(known) < 2 or (np.diff(times) <= 0).any():
            return None
        since = np.array([[*rotation_vector(R @ here[0].T), *t] for _, (R, t) in known])
        weights = difference_weights(times, len(times))[1]
        motion: np.ndarray = weights[0, int(np.flatnonzero(times == 0)[0])] @ since
        return motion
