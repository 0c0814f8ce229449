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
"""The path block before a known object: a free pose for every view, in the object's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.rotation import rotation_matrix

#: Unknowns of a view: a small turn on the camera's side (rad), then the translation.
VIEW_NAMES = ('turn_x', 'turn_y', 'turn_z', 'x', 'y', 'z')


@dataclass(frozen=True)
class ObjectPoses:
    """
    Pose of the object in every view; the object fixes the gauge.

    Attributes
    ----------
    cam_from_object : ndarray, shape (V, 3, 4)
        [R | t] of every view.

    """

    cam_from_object: np.ndarray

    def __len__(self) -> int:
        """Count the views."""
        return len(self.cam_from_object)

    def turned(self, vectors: np.ndarray, view: np.ndarray) -> np.ndarray:
        """Turn vectors (N, 3) of the object's frame into those of views (N,), ascending."""
        first, turned = np.searchsorted(view, np.arange(len(self) + 1)), np.empty_like(vectors)
        for R, begin, end in zip(self.cam_from_object[:, :, :3], first, first[1:]):
            np.matmul(vectors[begin:end], R.T, out=turned[begin:end])
        return turned

    def translations(self, view: np.ndarray) -> np.ndarray:
        """Translations (N, 3) of the views."""
        return self.cam_from_object[view, :, 3]

    def moved(self, steps: np.ndarray) -> ObjectPoses:
        """Return the poses after steps (V, 6) of `VIEW_NAMES`."""
        poses = np.array(self.cam_from_object)
        poses[:, :, :3] = rotation_matrix(steps[:, :3]) @ poses[:, :, :3]
        poses[:, :, 3] += steps[:, 3:]
        return ObjectPoses(poses)

    def of_views(self, kept: np.ndarray) -> ObjectPoses:
        """Return the poses of some of the views."""
        return ObjectPoses(self.cam_from_object[kept])

    @staticmethod
    def by_steps(J: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """
        Differentiate by `VIEW_NAMES`.

        Parameters
        ----------
        J : ndarray, shape (N, m, 3)
            Derivatives by the points in the camera's frame.
        turned : ndarray, shape (N, 3)
            The points, turned but not yet moved.

        Returns
        -------
        ndarray, shape (N, m, 6)

        """
        return np.concatenate([np.cross(turned[:, None], J), J], axis=2)
