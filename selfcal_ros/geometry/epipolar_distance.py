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
"""How far matches are from an epipolar geometry, in pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.projective import homogeneous


def epipolar_residuals(F: ArrayLike, xy_a: ArrayLike, xy_b: ArrayLike) -> np.ndarray:
    """
    Signed distances of the symmetric epipolar error (A.2).

    Parameters
    ----------
    F : array_like, shape (..., 3, 3)
    xy_a, xy_b : array_like, shape (m, 2)

    Returns
    -------
    ndarray, shape (..., m, 2)
        Second image, first image; pixels.

    """
    a, b = homogeneous(np.asarray(xy_a, float)), homogeneous(np.asarray(xy_b, float))
    F = np.asarray(F, float)
    line_b, line_a = a @ np.swapaxes(F, -1, -2), b @ F
    product = np.einsum('...i,...i->...', line_b, b)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.stack([product / np.hypot(line_b[..., 0], line_b[..., 1]),
                         product / np.hypot(line_a[..., 0], line_a[..., 1])], axis=-1)


def sampson_distance(F: np.ndarray, xy_a: np.ndarray, xy_b: np.ndarray) -> np.ndarray:
    """
    Signed first-order distance of matches to the epipolar constraint.

    Hartley and Zisserman, 2nd ed., eq. (11.9); x_b' F x_a = 0. For independent noise of one
    sigma in every coordinate it has that sigma.

    Parameters
    ----------
    F : ndarray, shape (3, 3)
    xy_a, xy_b : ndarray, shape (m, 2)
        Pixels.

    Returns
    -------
    ndarray, shape (m,)
        Pixels.

    """
    # one coordinate after the other: sums over an axis of two numbers take several times as long
    x_b, y_b = np.ascontiguousarray(xy_b.T)
    u, v, w = F[:, :2] @ xy_a.T + F[:, 2:]
    p, q = F[:2, :2].T @ xy_b.T + F[2, :2, None]
    square = u * u + v * v + p * p + q * q
    distance: np.ndarray = (x_b * u + y_b * v + w) / np.sqrt(np.maximum(square, 1e-300))
    return distance
