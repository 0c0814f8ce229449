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
How uncertain a calibration makes projection: in pixels, over the image.

Sigmas of single parameters mislead where parameters trade against each other. A small rotation of
the camera frame hides part of every error from whoever calibrates the mounting as well. So the
covariance of all parameters is propagated to the image, after the small rotation that fits best
(the reprojection uncertainty of D. Kogan's mrcal does so, too).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, Projection
from selfcal_ros.geometry.camera import Camera

#: An angle so near to the axis that every lens is ideal there, radians.
_PARAXIAL = 1e-5


@dataclass(frozen=True)
class ProjectionUncertainty:
    """
    Uncertainty of projection on a grid of image points.

    Attributes
    ----------
    u, v : ndarray, shape (columns,), (rows,)
        Pixels.
    covariance : ndarray, shape (rows, columns, 2, 2)
        Of the projected point, pixels²; NaN where the distortion cannot be undone.

    """

    u: np.ndarray
    v: np.ndarray
    covariance: np.ndarray

    @property
    def sigma_px(self) -> np.ndarray:
        """Standard deviation in the worst direction, shape (rows, columns)."""
        C = self.covariance
        mean = (C[..., 0, 0] + C[..., 1, 1]) / 2
        apart = np.hypot((C[..., 0, 0] - C[..., 1, 1]) / 2, C[..., 0, 1])
        return np.asarray(np.sqrt(np.maximum(mean + apart, 0)))

    def direction_sigma_rad(self, camera: Camera) -> np.ndarray:
        """
        Standard deviation of the direction of a ray, along its worst, shape (rows, columns).

        The pixel that is known the least turns a ray the least near the border of many lenses. So
        it is of A C Aᵀ, by the derivatives A of the ray. NaN where the lens does not see.
        """
        pixels = np.stack(np.meshgrid(self.u, self.v), axis=-1).reshape(-1, 2)
        A = np.stack([camera.rays(pixels + step) - camera.rays(pixels - step)
                      for step in ([0.5, 0.0], [0.0, 0.5])], axis=2)
        # of the same eigenvalues but for a zero
        AAC = np.swapaxes(A, 1, 2) @ A @ self.covariance.reshape(-1, 2, 2)
        half = np.einsum('nii->n', AAC) / 2
        with np.errstate(invalid='ignore'):
            largest = half + np.sqrt(np.maximum(half**2 - np.linalg.det(AAC), 0))
        return np.asarray(np.sqrt(np.maximum(largest, 0)).reshape(self.covariance.shape[:2]))


def projection_uncertainty(camera: Camera, covariance: np.ndarray, columns: int = 40,
                           rotate: bool = True) -> ProjectionUncertainty:
    """
    Propagate the covariance of a camera to its image.

    A ray that a pixel sees is projected by a camera that is off by one draw of the covariance. A
    small rotation turns it, the one that best undoes this over the whole image (first order).

    Parameters
    ----------
    camera : Camera
        With its image size.
    covariance : ndarray, shape (k, k)
        Of the camera's parameters.
    columns : int
        Grid points along the width.
    rotate : bool
        False: leave the rotation out, for a camera whose mounting is known by other means.

    Returns
    -------
    ProjectionUncertainty

    """
    rows = max(int(round(columns * camera.height / camera.width)), 2)
    u = np.linspace(0, camera.width - 1, columns)
    v = np.linspace(0, camera.height - 1, rows)
    J = parameter_effect(camera, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2), rotate)
    C = J @ np.asarray(covariance, float) @ J.transpose(0, 2, 1)
    return ProjectionUncertainty(u, v, C.reshape(rows, columns, 2, 2))


def axis_scale(camera: Camera) -> float:
    """
    Return what the focal lengths of a camera have to be multiplied by to hold on its axis.

    One for every lens that is estimated; lenses that look at a sphere from off its centre have
    focal lengths of another scale.
    """
    ray = np.array([[np.sin(_PARAXIAL), 0, np.cos(_PARAXIAL)]])
    return float(camera.lens.image(ray, camera.distortion).xy[0, 0]) / _PARAXIAL


def parameter_effect(camera: Camera, pixels: np.ndarray, rotate: bool = True) -> np.ndarray:
    """
    Differentiate where the rays of pixels are projected to by the camera's parameters.

    Parameters
    ----------
    camera : Camera
    pixels : ndarray, shape (N, 2)
    rotate : bool
        Take out of each derivative the small rotation that best undoes it over all pixels.

    Returns
    -------
    ndarray, shape (N, 2, k)
        By the camera's parameters; NaN where the distortion cannot be undone.

    """
    rays = camera.rays(pixels)
    usable = np.isfinite(rays).all(axis=1)
    seen = Projection(Lens.of(camera), rays[usable])
    J = np.full((len(rays), 2, len(camera.parameter_names)), np.nan)
    J[usable] = seen.by_parameters()
    if rotate and usable.sum() >= 3:
        # a small rotation w moves a ray by w x ray
        turn = np.cross(seen.by_points(), rays[usable][:, None], axisa=2, axisb=2) * -1
        M = np.einsum('nki,nkj->ij', turn, turn)
        best = np.linalg.solve(M, np.einsum('nki,nkj->ij', turn, J[usable]))
        J[usable] -= turn @ best
    return J
