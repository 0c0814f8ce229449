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
Recordings of smooth parts given as meshes, with exact poses.

Faces are drawn from the farthest to the nearest, eight samples along each side of a pixel, shaded
by their normals; so fine a mesh has the outline of the smooth part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import cv2
import numpy as np
from scipy import ndimage

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic.render import quantise

#: Samples along each side of a pixel, and bits of the fractions of the drawn corners.
_SAMPLES, _BITS = 8, 4

#: Of points, x, y and z: the rows of an array, or three arrays.
_Coordinates: TypeAlias = np.ndarray | tuple[np.ndarray, np.ndarray, np.ndarray]


def _grid(rows: int, columns: int, place: Callable[[np.ndarray, np.ndarray], _Coordinates],
          closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Triangles over a grid that closes around its columns, and around its rows if `closed`."""
    v, u = np.meshgrid(np.arange(rows) / (rows - (not closed)), np.arange(columns) / columns,
                       indexing='ij')
    vertices = np.stack(list(place(u * 2 * np.pi, v)), axis=-1).reshape(-1, 3)
    r, c = np.meshgrid(np.arange(rows - (not closed)), np.arange(columns), indexing='ij')
    a, b = r * columns + c, r * columns + (c + 1) % columns
    d, e = (r + 1) % rows * columns + c, (r + 1) % rows * columns + (c + 1) % columns
    return vertices, np.concatenate([np.stack([a, b, e], axis=-1).reshape(-1, 3),
                                     np.stack([a, e, d], axis=-1).reshape(-1, 3)])


def bean(size_m: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Make a smooth lump without any edge: vertices (V, 3) metres, triangles (F, 3)."""
    def place(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        angle = np.pi * v
        way = np.array([np.sin(angle) * np.cos(u), np.sin(angle) * np.sin(u), np.cos(angle)])
        radius = 0.36 + 0.08 * way[0] * way[1] + 0.1 * way[2] * way[0] - 0.07 * way[1]**2 \
            + 0.06 * way[2]**3
        return np.asarray(size_m * radius * way * np.array([1.3, 1.0, 0.8])[:, None, None])

    vertices, triangles = _grid(48, 72, place, False)
    return vertices, triangles[:, ::-1]


def ring(size_m: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Make a ring that is thicker and higher on one side."""
    def place(u: np.ndarray, v: np.ndarray) -> _Coordinates:
        around = 2 * np.pi * v
        thick = size_m * (0.13 + 0.06 * np.cos(u) + 0.02 * np.sin(2 * u))
        radius = 0.36 * size_m + thick * np.cos(around)
        return (radius * np.cos(u), 0.75 * radius * np.sin(u),
                thick * np.sin(around) + 0.15 * size_m * np.sin(u)**2)

    return _grid(40, 80, place, True)


def handle(size_m: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Make a turned knob with a bent axis, with flat ends: two creases."""
    def place(u: np.ndarray, v: np.ndarray) -> _Coordinates:
        profile = size_m * (0.2 + 0.09 * np.cos(5 * v) - 0.05 * np.sin(9 * v))
        profile = np.where((v == 0) | (v == 1), 0.0, profile)
        height = np.clip((v - 1 / 47) / (45 / 47), 0, 1)
        return (profile * np.cos(u) * 1.25 + 0.25 * size_m * height**2,
                profile * np.sin(u), size_m * (height - 0.5))

    return _grid(48, 64, place, False)


SMOOTH = {'bean': bean, 'ring': ring, 'handle': handle}


class MeshRenderer:
    """
    Draws one mesh before a background.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
    triangles : ndarray of int, shape (F, 3)
    camera : Camera
        Without distortion.
    rng : numpy.random.Generator, optional
        For a background of blobs; plain grey without.
    textured : bool
        Whether the part is patterned.
    behind : ndarray, shape (height, width), optional
        Grey levels of another background.

    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, camera: Camera,
                 rng: np.random.Generator | None = None, textured: bool = False,
                 behind: np.ndarray | None = None) -> None:
        """Paint the background and the faces."""
        if not camera.is_pinhole:
            raise ArgumentError('Meshes are drawn by cameras without distortion only.')
        self._vertices, self._triangles, self._camera = vertices, triangles, camera
        corners = vertices[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1)
        self._drawn = length > 1e-12
        self._normals = normals / np.maximum(length, 1e-300)[:, None]
        self._paint = np.full(len(triangles), 1.0)
        if textured:
            middle = corners.mean(axis=1) / np.ptp(vertices, axis=0).max()
            self._paint += 0.35 * np.sign(np.sin(middle @ [31, 17, 23]) + np.sin(
                middle @ [-19, 29, 11]))
        shape = camera.height, camera.width
        self._background = np.full(shape, 70.0)
        if rng is not None:
            blobs = ndimage.gaussian_filter(rng.normal(size=shape), 5)
            self._background += 45 * np.tanh(2 * blobs / blobs.std())
        if behind is not None:
            self._background = behind

    def render(self, pose: np.ndarray, rng: np.random.Generator | None = None,
               noise_sigma: float = 0.0) -> np.ndarray:
        """
        Draw the part at a pose (3, 4), object to camera; noise needs an rng.

        Returns
        -------
        ndarray of uint8, shape (height, width)

        """
        camera, n = self._camera, _SAMPLES
        seen = self._vertices @ pose[:, :3].T + pose[:, 3]
        # sample k of a pixel lies at (k + 1/2) / n - 1/2 from its centre; half a sample is taken
        # off, for the part is made narrower by one at the left and above
        pixels = (camera.project(seen) + 0.5) * n - 1.0
        middle = seen[self._triangles].mean(axis=1)
        normals = self._normals @ pose[:, :3].T
        front = np.flatnonzero(((normals * middle).sum(axis=1) < 0) & self._drawn)
        order = front[np.argsort(-middle[front, 2])]
        light = np.clip(normals @ np.array([-0.4, -0.6, -0.7]), 0, 1)
        grey = np.clip((95 + 110 * light) * self._paint, 0, 255)
        low = np.maximum(np.floor(pixels.min(axis=0) / n).astype(int) - 2, 0)
        high = np.minimum(np.ceil(pixels.max(axis=0) / n).astype(int) + 3,
                          (camera.width, camera.height))
        wide, tall = high - low
        if min(wide, tall) < 1:
            return quantise(self._background, rng, noise_sigma)
        canvas = np.full((tall * n, wide * n), -1, np.float32)
        corners = np.rint((pixels[self._triangles] - low * n) * 2**_BITS).astype(np.int32)
        for k in order:
            cv2.fillConvexPoly(canvas, corners[k], float(grey[k]), cv2.LINE_8, _BITS)
        # polygons are filled with their borders: half a sample too wide all around
        part = cv2.erode((canvas >= 0).astype(np.uint8), np.ones((2, 2), np.uint8)) > 0
        behind = np.repeat(np.repeat(self._background[low[1]:high[1], low[0]:high[0]], n, axis=0),
                           n, axis=1)
        canvas = np.where(part, canvas, behind)
        image = self._background.copy()
        image[low[1]:high[1], low[0]:high[0]] = canvas.reshape(tall, n, wide, n).mean(axis=(1, 3))
        return quantise(image, rng, noise_sigma)
