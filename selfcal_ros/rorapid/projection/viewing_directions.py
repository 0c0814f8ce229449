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
"""Directions that a camera may look at an object from, and poses that are seen along them."""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.projection.camera_models import ObjectPose


def spread_directions(count: int) -> np.ndarray:
    """Directions (count, 3) spread evenly (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def looking_along(axis: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a camera whose optical axis lies along a direction of the object."""
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    return np.array([side, np.cross(axis, side), axis])


def seen_at(pixel: np.ndarray, scale: float, rotation: np.ndarray, K: np.ndarray) -> ObjectPose:
    """
    Carry a pose from the middle of the image to where it is seen.

    Parameters
    ----------
    pixel : ndarray, shape (2,)
        Where the origin of the object is seen.
    scale : float
        Pixels a metre.
    rotation : ndarray, shape (3, 3)
        As if it were seen along the optical axis.
    K : ndarray, shape (3, 3)

    Returns
    -------
    ObjectPose

    """
    ray = np.linalg.solve(K, [*pixel, 1.0])
    ray /= np.linalg.norm(ray)
    focal = float(np.sqrt(K[0, 0] * K[1, 1]))
    return ObjectPose(_turning_axis_to(ray) @ rotation, focal / scale * ray)


def _turning_axis_to(ray: np.ndarray) -> np.ndarray:
    """Smallest rotation (3, 3) that takes the optical axis to a unit ray."""
    x, y, z = ray
    turn: np.ndarray = np.eye(3) + np.array([[0, 0, x], [0, 0, y], [-x, -y, 0]]) - np.array(
        [[x * x, x * y, 0], [x * y, y * y, 0], [0, 0, x * x + y * y]]) / (1 + z)
    return turn
