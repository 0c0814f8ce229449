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
"""How far apart two lenses are, whatever their models: angles of pixels, pixels of rays."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def pixel_grid(width: int, height: int, across: int, down: int) -> np.ndarray:
    """Return a regular grid over an image, shape (across * down, 2)."""
    return np.stack(np.meshgrid(np.linspace(0, width - 1, across),
                                np.linspace(0, height - 1, down)), axis=-1).reshape(-1, 2)


def best_rotation(rays: np.ndarray, onto: np.ndarray) -> Rotation:
    """Return the rotation of unit rays (N, 3) that brings them nearest to others (N, 3)."""
    return Rotation.align_vectors(onto, rays)[0]


def angles_deg(camera, true, reach_deg: float, step_px: int = 4) -> np.ndarray:
    """
    Compare the rays of pixels, after the best rotation.

    Parameters
    ----------
    camera, true : Camera
    reach_deg : float
        Pixels up to this angle from the true axis count.
    step_px : int
        Every pixel of so many, each way.

    Returns
    -------
    ndarray, shape (N,)
        Angle between both rays of each pixel; infinite where the camera has none.

    """
    pixels = pixel_grid(true.width, true.height, true.width // step_px, true.height // step_px)
    right, own = true.rays(pixels), camera.rays(pixels)
    counts = right[:, 2] >= np.cos(np.deg2rad(reach_deg))
    right, own = right[counts], own[counts]
    seen = np.isfinite(own).all(axis=1)
    angle = np.full(len(right), np.inf)
    turned = best_rotation(own[seen], right[seen]).apply(own[seen])
    # the arc cosine is blind to small angles
    chord = np.linalg.norm(turned - right[seen], axis=1)
    angle[seen] = np.rad2deg(2 * np.arcsin(np.minimum(chord / 2, 1)))
    return angle


def projection_distance(camera, true, pixels: np.ndarray) -> np.ndarray:
    """
    Compare where the true camera sees the rays of pixels, after the best rotation.

    Parameters
    ----------
    camera, true : Camera
    pixels : ndarray, shape (N, 2)

    Returns
    -------
    ndarray, shape (N,)
        Pixels; infinite where one of them sees nothing.

    """
    rays = camera.rays(pixels)
    right = true.rays(pixels)
    seen = np.isfinite(rays).all(axis=1) & np.isfinite(right).all(axis=1)
    start = best_rotation(rays[seen], right[seen])

    def apart(vector):
        turned = (Rotation.from_rotvec(vector) * start).apply(rays[seen])
        return np.nan_to_num(true.project(turned) - pixels[seen], nan=1e3)

    best = least_squares(lambda vector: apart(vector).ravel(), np.zeros(3), x_scale=1e-3)
    distance = np.full(len(pixels), np.inf)
    distance[seen] = np.linalg.norm(apart(best.x), axis=1)
    return distance


def rms(values: np.ndarray) -> float:
    """Root mean square; infinite where a value is."""
    return float(np.sqrt(np.mean(np.square(values))))
