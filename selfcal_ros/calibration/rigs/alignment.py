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
Two reconstructions of one drive, laid over each other: hand-eye with a scale.

Cameras a and b are rigid to each other, X_a = R X_b + p, and their worlds differ by a similarity,
X_world_a = s Q X_world_b + q. Rotations come first: the turns of both between any two instants
are the same vector but for R (Tsai and Lenz 1989). Then p, s and q follow linearly from the
centres (Andreff, Horaud and Espiau 2001, with the scale). Where all turns are about one axis,
rotations leave the angle about it open; it comes from the centres with the scale.
"""

from __future__ import annotations

from dataclasses import dataclass
import itertools

import numpy as np

from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.geometry.rotation import nearest_rotation, rotation_matrix, rotation_vector

#: Turns about other axes than the main one count where their squares sum to more than this share.
OFF_AXIS = 1e-2
#: Fewer common instants say too little.
MIN_INSTANTS = 4


@dataclass(frozen=True)
class Alignment:
    """
    The second camera in the frame of the first, and the second world in the first.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        R, from the coordinates of the second camera to those of the first.
    place : ndarray, shape (3,)
        p, centre of the second camera in the first; its part along a single axis is zero.
    scale : float
        s, of the first world over the second.
    turn : ndarray, shape (3, 3)
        Q.
    shift : ndarray, shape (3,)
        q.
    misfit : float
        Root mean square distance between the centres of the second camera, over the spread of
        those of the first.

    """

    rotation: np.ndarray
    place: np.ndarray
    scale: float
    turn: np.ndarray
    shift: np.ndarray
    misfit: float

    @property
    def pose(self) -> np.ndarray:
        """[R | p] of the second camera in the first, shape (3, 4)."""
        return np.column_stack([self.rotation, self.place])


def align(first: np.ndarray, second: np.ndarray) -> list[Alignment]:
    """
    Lay the path of a second camera over that of a first.

    Parameters
    ----------
    first, second : ndarray, shape (V, 3, 4)
        [R | t] of either camera at the same instants, each in its own world.

    Returns
    -------
    list of Alignment
        What the second may be, the likeliest first; empty where there is nothing to go by.

    """
    if len(first) < MIN_INSTANTS:
        return []
    R_a, R_b = first[:, :, :3], second[:, :, :3]
    pairs = np.array(list(itertools.combinations(range(len(first)), 2)))
    turns_a = rotation_vector(R_a[pairs[:, 1]] @ np.swapaxes(R_a[pairs[:, 0]], 1, 2))
    turns_b = rotation_vector(R_b[pairs[:, 1]] @ np.swapaxes(R_b[pairs[:, 0]], 1, 2))
    U, sizes, Vt = np.linalg.svd(turns_a.T @ turns_b)
    if not sizes[0] > 0:
        return []
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    found = [_from_centres(first, second, R)]
    if sizes[1] < OFF_AXIS * sizes[0]:
        about_axis = _about_axis(first, second, R, U[:, 0])
        found.insert(0, about_axis)
    return [one for one in found if one is not None]


def _world_turn(R: np.ndarray, R_a: np.ndarray, R_b: np.ndarray) -> np.ndarray:
    """Return the mean Q of all instants, from R."""
    return nearest_rotation(np.mean(np.swapaxes(R_a, 1, 2) @ R @ R_b, axis=0))


def _from_centres(first: np.ndarray, second: np.ndarray, R: np.ndarray) -> Alignment | None:
    """Solve c_a + R_aᵀ p = s Q c_b + q for p, s and q."""
    R_a, c_a, c_b = first[:, :, :3], camera_centres(first), camera_centres(second)
    Q = _world_turn(R, R_a, second[:, :, :3])
    turned = c_b @ Q.T
    rows = np.zeros((len(c_a), 3, 7))
    rows[:, :, :3] = -np.swapaxes(R_a, 1, 2)
    rows[:, :, 3], rows[:, :, 4:] = turned, np.eye(3)
    found = np.linalg.lstsq(rows.reshape(-1, 7), c_a.ravel(), rcond=1e-9)[0]
    return _alignment(R, found[:3], found[3], Q, found[4:], rows @ found - c_a, c_a)


def _about_axis(first: np.ndarray, second: np.ndarray, R: np.ndarray, axis: np.ndarray,
                ) -> Alignment | None:
    """Solve for the angle about the one axis (3,), in the first camera, and for p, s, q."""
    R_a, c_a, c_b = first[:, :, :3], camera_centres(first), camera_centres(second)
    Q = _world_turn(R, R_a, second[:, :, :3])
    up = np.mean(np.swapaxes(R_a, 1, 2) @ axis, axis=0)
    up /= np.linalg.norm(up)
    # two directions of the plane, in the world and in the camera
    plane = np.linalg.svd(up[None])[2][1:]
    in_camera = np.linalg.svd(axis[None])[2][1:]
    along = c_b @ Q.T
    rows = np.zeros((len(c_a), 2, 6))
    rows[:, :, :2] = -np.einsum('ki,vji,lj->vkl', plane, R_a, in_camera)
    rows[:, :, 2] = along @ plane.T
    rows[:, :, 3] = np.cross(up, along) @ plane.T
    rows[:, :, 4:] = np.eye(2)
    wanted = c_a @ plane.T
    found = np.linalg.lstsq(rows.reshape(-1, 6), wanted.ravel(), rcond=1e-9)[0]
    angle = np.arctan2(found[3], found[2])
    shift = plane.T @ found[4:]
    scale = float(np.hypot(found[2], found[3]))
    Q = rotation_matrix(angle * up) @ Q
    shift += up * float(np.mean(c_a @ up - scale * c_b @ Q.T @ up))
    return _alignment(rotation_matrix(angle * axis) @ R, in_camera.T @ found[:2], scale, Q, shift,
                      rows @ found - wanted, c_a)


def _alignment(R: np.ndarray, place: np.ndarray, scale: float, Q: np.ndarray, shift: np.ndarray,
               left: np.ndarray, centres: np.ndarray) -> Alignment | None:
    """Return what was found, where the scale is one."""
    spread = float(np.sqrt(np.mean(np.sum((centres - centres.mean(axis=0))**2, axis=1))))
    if not (scale > 0 and spread > 0):
        return None
    misfit = float(np.sqrt(np.mean(np.sum(left**2, axis=1)))) / spread
    return Alignment(R, place, float(scale), Q, shift, misfit)
