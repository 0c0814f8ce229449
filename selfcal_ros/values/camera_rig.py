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
"""Cameras with known places to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera

#: A rotation in a file may miss orthogonality by so much, and is made exact.
_ROTATION_TOLERANCE = 1e-3


def _exact() -> np.ndarray:
    return np.zeros((6, 6))


@dataclass(frozen=True)
class PlacedCamera:
    """
    A camera, and where it sits.

    Attributes
    ----------
    name : str
    camera : Camera
    T_rig_camera : ndarray, shape (4, 4)
        Takes points of its optical frame to the frame of the rig, metres.
    covariance : ndarray, shape (6, 6)
        Of x, y, z (metres) and of small turns about the axes of the rig (radians).

    """

    name: str
    camera: Camera
    T_rig_camera: np.ndarray
    covariance: np.ndarray = field(default_factory=_exact)


def placed_beside(cameras: Sequence[PlacedCamera]) -> tuple[PlacedCamera, ...]:
    """
    Put the frame of the rig into the first of some cameras.

    Parameters
    ----------
    cameras : sequence of PlacedCamera
        In any common frame.

    Returns
    -------
    tuple of PlacedCamera
        The errors of the first one's place count for the others.

    Raises
    ------
    InputError
        If a transform is none.

    """
    for one in cameras:
        T = one.T_rig_camera
        R = T[:3, :3] if T.shape == (4, 4) and np.isfinite(T).all() else np.zeros((3, 3))
        if np.abs(R @ R.T - np.eye(3)).max() > _ROTATION_TOLERANCE or np.linalg.det(R) < 0:
            raise InputError(f'The transform of the camera {one.name} is no pose: it needs a '
                             'rotation matrix and finite metres.')
    first = cameras[0]
    back = np.linalg.inv(_rigid(first.T_rig_camera))
    # small turns and shifts of the first frame, seen by the others
    turn = np.kron(np.eye(2), back[:3, :3])
    found = [replace(first, T_rig_camera=np.eye(4), covariance=np.zeros((6, 6)))]
    for one in cameras[1:]:
        T = _rigid(one.T_rig_camera)
        x, y, z = T[:3, 3] - first.T_rig_camera[:3, 3]
        lever = np.eye(6)
        lever[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        spread = one.covariance + lever @ first.covariance @ lever.T
        found.append(replace(one, T_rig_camera=back @ T, covariance=turn @ spread @ turn.T))
    return tuple(found)


def _rigid(T: np.ndarray) -> np.ndarray:
    """Return a transform (4, 4) whose rotation is exactly orthogonal."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = U @ Vt, T[:3, 3]
    return exact
