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
"""
Poses of a robot's body: what its odometry, its arm or its motion capture say where it was.

Poses are those of the body in a fixed frame of the robot (world_T_body), in metres; axes of the
body are those of REP 103. They say where the body was, the images where the camera was: from
both together follows where the camera sits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.errors import InputError

#: Absolute poses err each by itself; those of odometry err from one to the next.
ABSOLUTE, ODOMETRY = 'absolute', 'odometry'
KINDS = (ABSOLUTE, ODOMETRY)
#: A rotation matrix differs from an orthogonal one by this at most.
ORTHOGONAL = 1e-3
#: No robot is further from where its poses count from, metres.
FARTHEST_M = 1e9


@dataclass(frozen=True)
class BodyPoses:
    """
    Poses of the body, in the order of time.

    Parameters
    ----------
    rotation : ndarray, shape (N, 3, 3)
        World from body.
    position : ndarray, shape (N, 3)
        Of the body's origin in the world, metres.
    stamps_ns : ndarray of int, shape (N,), optional
        Instants by the body's clock, ascending. One of `stamps_ns` and `frames` is given.
    frames : ndarray of int, shape (N,), optional
        Frame index of the image that each pose belongs to, ascending.
    kind : {'absolute', 'odometry'}
    sigma_position_m, sigma_rotation_rad : float, optional
        Stated standard deviation of a pose ('absolute', a coordinate; a small turn about an axis),
        or of a metre and of a radian of the way ('odometry'). None: estimated from the misfit.
    body_frame, world_frame : str
        Names of the frames, as TF has them.

    Raises
    ------
    InputError
        If shapes differ, a value is not finite, or a matrix is no rotation.

    """

    rotation: np.ndarray
    position: np.ndarray
    stamps_ns: np.ndarray | None = None
    frames: np.ndarray | None = None
    kind: str = ABSOLUTE
    sigma_position_m: float | None = None
    sigma_rotation_rad: float | None = None
    body_frame: str = 'base_link'
    world_frame: str = 'odom'

    def __post_init__(self) -> None:
        """Check the poses."""
        count = len(self.position)
        if not count:
            raise InputError('There is no pose of the body.')
        if self.rotation.shape != (count, 3, 3) or self.position.shape != (count, 3):
            raise InputError('Poses of a body need rotation (N, 3, 3) and position (N, 3); got '
                             f'{self.rotation.shape} and {self.position.shape}.')
        if (self.stamps_ns is None) == (self.frames is None):
            raise InputError('Poses of a body need either their instants or the frames of the '
                             'images that they belong to.')
        when = self.stamps_ns if self.frames is None else self.frames
        if when is None or len(when) != count or (np.diff(when) <= 0).any():
            raise InputError('Poses of a body must be in the order of time, one at an instant.')
        if not (np.isfinite(self.rotation).all() and np.isfinite(self.position).all()):
            raise InputError('A pose of the body is not finite; remove it.')
        if np.abs(self.position).max(initial=0) > FARTHEST_M:
            raise InputError(f'A pose of the body lies more than {FARTHEST_M:g} m away; correct '
                             'it, or state the unit of the positions.')
        defect = self.rotation @ np.swapaxes(self.rotation, 1, 2) - np.eye(3)
        wrong = (np.abs(defect).max(axis=(1, 2), initial=0) > ORTHOGONAL) | (
            np.linalg.det(self.rotation) < 0)
        if wrong.any():
            raise InputError(f'Pose {int(np.argmax(wrong))} of the body has no right-handed '
                             'rotation of unit length; correct how it was written.')
        if self.kind not in KINDS:
            raise InputError(f'Poses are {" or ".join(KINDS)}, not {self.kind!r}.')

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.position)
