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
"""Depth images of rendered objects: what a depth camera in the place of the camera sees."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.camera import Camera


def depth_of(triangles: np.ndarray, pose: np.ndarray, camera: Camera,
             rng: np.random.Generator, wall_m: float | None = None, noise_m: float = 0.002,
             scale: float = 1.0) -> np.ndarray:
    """
    Render the depths of an object before a wall.

    Parameters
    ----------
    triangles : ndarray, shape (T, 3, 3)
        Corners, metres, in the frame of the object.
    pose : ndarray, shape (3, 4)
        Object -> camera.
    camera : Camera
        Without distortion.
    rng : numpy.random.Generator
    wall_m : float, optional
        Depth of a wall behind; nothing (0) without it.
    noise_m : float
        Standard deviation of each pixel.
    scale : float
        Factor by which the depth camera errs.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Metres along the optical axis, in whole millimetres.

    """
    depth = np.full((camera.height, camera.width), np.inf if wall_m is None else wall_m)
    corners = triangles @ pose[:, :3].T + pose[:, 3]
    homogeneous = corners @ camera.K.T
    pixels = homogeneous[:, :, :2] / homogeneous[:, :, 2:]
    size = (camera.width, camera.height)
    low = np.clip(np.floor(pixels.min(axis=1)), 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=1)) + 1, 0, size).astype(int)
    columns, rows = np.maximum(high - low, 0).T
    covered = (np.linalg.det(homogeneous) != 0) & (columns * rows > 0)
    low, columns, count = low[covered], columns[covered], (columns * rows)[covered]
    # every pixel in the box about every triangle
    triangle = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    x = low[triangle, 0] + place % columns[triangle]
    y = low[triangle, 1] + place // columns[triangle]
    # a pixel is the sum of the corners by weights, which are the corners' shares over the depth
    weights = np.linalg.inv(homogeneous[covered])[triangle]
    shares = x[:, None] * weights[:, 0] + y[:, None] * weights[:, 1] + weights[:, 2]
    inside = (shares >= 0).all(axis=1)
    np.minimum.at(depth, (y[inside], x[inside]), 1 / shares[inside].sum(axis=1))
    depth = np.where(np.isfinite(depth),
                     scale * depth + noise_m * rng.normal(size=depth.shape), 0.0)
    return np.float32(1e-3) * np.rint(1e3 * depth).astype(np.float32)
