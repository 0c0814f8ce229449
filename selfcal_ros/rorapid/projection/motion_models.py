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
"""How the object can move: general, pure translation, or planar (7.3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.rotation import align_z, rotation_vector


def motion_basis(motion: str, size: int, plane_axis: ArrayLike | None = None) -> np.ndarray:
    """
    Corrections that a motion model allows: q = basis p.

    Parameters
    ----------
    motion : {'general', 'translation', 'planar'}
    size : int
        Size of the camera model's correction: 6 (theta, Delta), 7 with zoom, 8 for the affine
        camera. Zoom stays free whatever the motion.
    plane_axis : array_like, shape (3,), optional
        Normal of the plane of motion, camera frame; needed for planar motion.

    Returns
    -------
    ndarray, shape (size, m)
        Orthonormal columns. Planar motion: (theta about the axis, alpha, beta), (7.22)-(7.24).

    Raises
    ------
    ArgumentError
        If planar motion comes without an axis, or with an affine camera.

    """
    if motion == 'general':
        return np.eye(size)
    if size == 8:
        if motion == 'planar':
            raise ArgumentError('The affine camera has no planar motion model.')
        return np.eye(8)[:, 6:]
    if motion == 'translation':
        basis = np.eye(size)[:, 3:]
    else:
        if plane_axis is None:
            raise ArgumentError('Planar motion needs the axis of the plane.')
        frame = align_z(np.asarray(plane_axis, float))
        basis = np.zeros((size, size - 3))
        basis[:3, 0] = frame[:, 2]
        basis[3:6, 1:3] = frame[:, :2]
        if size == 7:
            basis[6, 3] = 1
    return basis


def completed(basis: np.ndarray) -> np.ndarray:
    """
    Complete the columns of a motion's basis to all corrections, (size, size), orthonormal.

    The first m columns are those allowed; in the others the object stays as it is, but how it is
    must be found out.
    """
    size, m = basis.shape
    if m == size:
        return basis
    rest = np.linalg.svd(basis, full_matrices=True)[0][:, m:]
    return np.concatenate([basis, rest], axis=1)


@dataclass(frozen=True)
class LearnedPlane:
    """
    Attributes of a plane of motion, learned from a track.

    Attributes
    ----------
    axis : ndarray, shape (3,)
        Unit normal, camera frame.
    sigma_rad : float
        Standard deviation of its direction in its worse direction; infinite if the track leaves
        it open.

    """

    axis: np.ndarray
    sigma_rad: float


class PlaneLearner:
    """
    Learn the plane of planar motion from a general track (7.3.3).

    The translations of the object's origin lie in a plane whose normal is the axis. The rotations
    between any two poses turn about the axis. Both are sums that are updated with each pose, so
    that the work does not grow with the track.

    Parameters
    ----------
    least_spread : float
        How many times its own noise the motion must span in both directions.

    """

    def __init__(self, least_spread: float = 8.0):
        """Start without any pose."""
        self.least_spread = least_spread
        self.reset()

    def reset(self) -> None:
        """Forget the track."""
        self._first: np.ndarray | None = None
        self._count = 0
        self._mean = np.zeros(3)
        self._spread = np.zeros((3, 3))
        self._turns = np.zeros((3, 3))
        self._noise = np.zeros(2)

    @property
    def count(self) -> int:
        """Number of poses so far."""
        return self._count

    def add(self, rotation: np.ndarray, translation: np.ndarray, covariance: np.ndarray) -> None:
        """Take in a pose and its covariance (6, 6), (theta, Delta)."""
        if self._first is None:
            self._first = rotation.copy()
        self._count += 1
        step = translation - self._mean
        self._mean = self._mean + step / self._count
        self._spread += np.outer(step, translation - self._mean)
        turn = rotation_vector(rotation @ self._first.T)
        self._turns += np.outer(turn, turn)
        self._noise += (np.trace(covariance[3:, 3:]) / 3, 2 * np.trace(covariance[:3, :3]) / 3)

    def plane(self) -> LearnedPlane:
        """Return the axis as it follows from all poses so far."""
        if self._count < 4:
            return LearnedPlane(np.array([0.0, 0.0, 1.0]), np.inf)
        noise_t, noise_r = np.maximum(self._noise / self._count, 1e-18)
        # information about the axis: across the path, and along the rotations
        across = self._spread / noise_t
        along = self._turns / noise_r
        information = across + np.trace(along) * np.eye(3) - along
        values, vectors = np.linalg.eigh(information)
        axis = vectors[:, 0]
        if axis @ self._mean > 0:
            axis = -axis                      # towards the camera
        needed = self.least_spread**2 * self._count
        gap = values[1] - values[0]
        if not gap > needed:
            return LearnedPlane(axis, np.inf)
        # the error of the first rotation is in all turns and does not average out
        common = 0.0
        if np.trace(along) > 0.01 * np.trace(information):
            common = 0.5 * noise_r / max(np.trace(self._turns) / self._count, 1e-12)
        return LearnedPlane(axis, float(np.sqrt(1 / gap + common)))


def recentring(arm: np.ndarray) -> np.ndarray:
    """
    Carry (theta, Delta) at the object's middle to its own origin, (6, 6).

    The middle moves by Delta and the origin lies at -arm from it: it moves by
    Delta - theta x arm.
    """
    x, y, z = arm.tolist()
    carry = np.eye(6)
    carry[3:, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    return carry
