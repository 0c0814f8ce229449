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
    pixels = corners[:, :, :2] / corners[:, :, 2:] @ camera.K[:2, :2].T + camera.K[:2, 2]
    size = [camera.width, camera.height]
    low = np.clip(np.floor(pixels.min(axis=1)).astype(int), 0, size)
    high = np.clip(np.ceil(pixels.max(axis=1)).astype(int) + 1, 0, size)
    for (a, b, c), start, end in zip(corners, low, high):
        if (start >= end).any():
            continue
        x, y = np.meshgrid(np.arange(start[0], end[0]), np.arange(start[1], end[1]))
        ray = np.stack([(x - camera.K[0, 2]) / camera.K[0, 0],
                        (y - camera.K[1, 2]) / camera.K[1, 1], np.ones(x.shape)], axis=-1)
        # the point of the ray in the plane, by its coordinates along the sides
        inverse = np.linalg.pinv(np.column_stack([b - a, c - a]))
        normal = np.cross(b - a, c - a)
        slope = ray @ normal
        along = np.divide(normal @ a, slope, out=np.full(x.shape, -1.0), where=slope != 0)
        u, v = np.moveaxis((along[..., None] * ray - a) @ inverse.T, -1, 0)
        part = depth[start[1]:end[1], start[0]:end[0]]
        part[:] = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0) & (along < part),
                           along, part)
    depth = np.where(np.isfinite(depth),
                     scale * depth + noise_m * rng.normal(size=depth.shape), 0.0)
    return np.float32(1e-3) * np.rint(1e3 * depth).astype(np.float32)
