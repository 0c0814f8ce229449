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
What the curvature of a wide lens does to registered positions.

A patch is registered with an affine warp. From the middle of a fisheye's image to its rim the true
warp has a second-order part as well, which points inwards. Fitting an affine warp to it moves the
position by half the Laplacian of the true one times the variance of the window. It is predicted
here for a patch that faces the camera.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.division import DivisionModel

#: Effective variance of the window of a registered patch, pixels squared. The window's own is 12;
#: the affine warp and the gain take up a part. Rendered images of 185 degrees ask for 9 to 11.
WINDOW_VARIANCE = 10.0
#: lambda of an equidistant lens whose corner is at a focal length, and of the least that counts.
_EQUIDISTANT, _WIDE = -0.36, -0.15
#: Square of the radius about which one coefficient stands for two.
_USUAL_SQUARE = 0.35
#: Step of the differences, pixels.
_STEP = 2.0
_STENCIL = _STEP * np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])


def ideal_fisheye(bend: DivisionModel) -> Camera | None:
    """Return the equidistant camera that bends about as much; None where the bend is small."""
    overall = sum(value * _USUAL_SQUARE**k for k, value in enumerate(bend.coefficients))
    if overall > _WIDE:
        return None
    f = bend.half_diagonal_px * float(np.sqrt(_EQUIDISTANT / overall))
    cx, cy = bend.centre
    return Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], (), *bend.image_size, 'equidistant')


def curvature_bias(camera: Camera, xy_a: np.ndarray, xy_b: np.ndarray,
                   affine: np.ndarray) -> np.ndarray:
    """
    Predict how far registered positions are off.

    Parameters
    ----------
    camera : Camera
        Roughly.
    xy_a, xy_b : ndarray, shape (N, 2)
        Pixels of the template, and where it was found.
    affine : ndarray, shape (N, 2, 2)
        Template offsets to offsets where it was found.

    Returns
    -------
    ndarray, shape (N, 2)
        Pixels, for a window at full resolution; zero where the lens has no rays.

    """
    ray_b = camera.rays(xy_b)
    basis_b = _across(ray_b)
    at_a = _on_plane(camera, xy_a, camera.rays(xy_a))
    by_a, by_b = _derivative(at_a), _derivative(_on_plane(camera, xy_b, ray_b))
    with np.errstate(all='ignore'):
        # from one plane to the other
        across = by_b @ affine @ _inverse(by_a)
        moved = ray_b[:, None] + (at_a @ np.swapaxes(across, 1, 2)) @ np.swapaxes(basis_b, 1, 2)
        laplacian = (camera.project(moved) - xy_b[:, None]).sum(axis=1) / _STEP**2
    bias: np.ndarray = 0.5 * WINDOW_VARIANCE * laplacian
    return np.where(np.isfinite(bias).all(axis=1, keepdims=True), bias, 0.0)


def _across(ray: np.ndarray) -> np.ndarray:
    """Two directions at right angles to unit vectors (N, 3), shape (N, 3, 2)."""
    turned = ray + [0.0, 0.0, 1.0] * np.where(ray[:, 2:] >= 0, 1, -1)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    basis: np.ndarray = np.eye(3)[:, :2] - 2 * turned[:, :, None] * turned[:, None, :2]
    return basis


def _on_plane(camera: Camera, xy: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Neighbours of pixels, in the planes at right angles to their rays, shape (N, 4, 2)."""
    near = camera.rays(xy[:, None] + _STENCIL)
    flat: np.ndarray = (near @ _across(ray)) / (near @ ray[:, :, None])
    return flat


def _derivative(near: np.ndarray) -> np.ndarray:
    """Derivative (N, 2, 2) of places (N, 4, 2) on the stencil."""
    slope: np.ndarray = np.stack([near[:, 0] - near[:, 1], near[:, 2] - near[:, 3]], axis=2)
    return slope / (2 * _STEP)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of matrices (N, 2, 2), infinite where there is none."""
    a, b, c, d = (matrix[:, i, j] for i in (0, 1) for j in (0, 1))
    adjugate = np.stack([np.stack([d, -b], axis=1), np.stack([-c, a], axis=1)], axis=1)
    inverse: np.ndarray = adjugate / (a * d - b * c)[:, None, None]
    return inverse
