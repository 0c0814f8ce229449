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
"""Paths and poses of the camera for synthetic recordings."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

# base frame x forward, y left, z up (REP 103) to optical frame x right, y down, z forward
_OPTICAL_FROM_BASE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def drive_path(count: int, length_m: float = 3.2, left_deg: float = 65.0, right_deg: float = 55.0,
               start_deg: float = -25.0) -> tuple[np.ndarray, np.ndarray]:
    """
    Sample an S-shaped path: a turn to the left, then one to the right.

    Parameters
    ----------
    count : int
        Positions, equally spaced along the path; the path does not depend on it.
    length_m : float
        Length of the path of the rear axle.
    left_deg, right_deg : float
        Change of heading in each turn.
    start_deg : float
        First heading, from x towards y.

    Returns
    -------
    xy : ndarray, shape (count, 2)
        Axle positions in metres.
    heading_rad : ndarray, shape (count,)

    """
    s = np.linspace(0, 1, 4001)
    share = left_deg / (left_deg + right_deg)
    bend = np.tanh((share - s) / 0.03)  # +1 to the left, -1 to the right
    rate = np.where(bend > 0, bend * left_deg, bend * right_deg)
    middle = (s[1:] + s[:-1]) / 2
    step = np.interp(middle, s, rate)
    for turn, total in ((step > 0, left_deg), (step < 0, right_deg)):
        step[turn] *= total / np.abs(step[turn]).sum()
    heading = np.deg2rad(start_deg + np.append(0, np.cumsum(step)))
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    xy = np.concatenate([[[0, 0]], np.cumsum((ahead[1:] + ahead[:-1]) / 2, axis=0)])
    xy *= length_m / (len(s) - 1)
    at = np.linspace(0, 1, count)
    return (np.stack([np.interp(at, s, axis) for axis in xy.T], axis=1),
            np.interp(at, s, heading))


def planar_poses(xy: np.ndarray, heading_rad: np.ndarray, height_m: float, ahead_m: float,
                 pitch_deg: float, roll_deg: float = 0.0) -> np.ndarray:
    """
    Poses of a camera fixed to a vehicle on a plane.

    Parameters
    ----------
    xy : ndarray, shape (V, 2)
        Positions of the vehicle.
    heading_rad : ndarray, shape (V,)
        Its headings, from x towards y.
    height_m, ahead_m : float
        The camera's place above the ground and ahead of the vehicle's centre.
    pitch_deg : float
        How far the optical axis points down.
    roll_deg : float
        Rotation about the optical axis.

    Returns
    -------
    ndarray, shape (V, 3, 4)
        cam_from_world.

    """
    mount = Rotation.from_euler('xz', [pitch_deg, -roll_deg], degrees=True).as_matrix()
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    zero, one = np.zeros_like(c), np.ones_like(c)
    base_from_world = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])
    R = mount @ _OPTICAL_FROM_BASE @ np.moveaxis(base_from_world, 2, 0)
    centre = np.column_stack([xy[:, 0] + ahead_m * c, xy[:, 1] + ahead_m * s, height_m * one])
    return np.concatenate([R, -R @ centre[:, :, None]], axis=2)


def look_at(centre: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Pose (3, 4) of a camera at `centre` whose optical axis passes through `target`."""
    centre = np.asarray(centre, float)
    z = np.asarray(target, float) - centre
    z /= np.linalg.norm(z)
    x = np.cross(z, np.asarray(up, float))
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    return np.column_stack([R, -R @ centre])
