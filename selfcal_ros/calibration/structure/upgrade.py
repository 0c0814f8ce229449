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
"""From projective to affine to metric structure by the fixed points (thesis 2.2, 5.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.result import FixedPoints
from selfcal_ros.geometry.projective import cross_matrix


def plane_at_infinity(camera: ArrayLike, fixed: FixedPoints) -> np.ndarray:
    """
    Plane at infinity of a projective frame in which the first camera is [I | 0].

    Parameters
    ----------
    camera : array_like, shape (3, 4)
        Another camera of the same motion; v, i and j are where they are in its image too.
    fixed : FixedPoints

    Returns
    -------
    ndarray, shape (3,)
        pi of (2.14): points at infinity satisfy pi^T X + W = 0.

    """
    P = np.asarray(camera, float)
    P = P / np.linalg.norm(P)
    v, i = fixed.vanishing_point, fixed.circular_point
    rows, right = [], []
    for x in (v, i):
        x = np.asarray(x) / np.linalg.norm(x)
        # [x]x (A x + w a4) = 0 gives the fourth coordinate of the point behind x
        known, slope = cross_matrix(x) @ P[:, :3] @ x, cross_matrix(x) @ P[:, 3]
        w = -(slope.conj() @ known) / (slope.conj() @ slope)
        rows += [x.real, x.imag]
        right += [-w.real, -w.imag]
    plane: np.ndarray = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
    return plane


def affine_upgrade(plane: ArrayLike) -> np.ndarray:
    """Transform (4, 4) of points from the projective to the affine frame (2.14)."""
    H = np.eye(4)
    H[3, :3] = plane
    return H


def metric_upgrade(K: ArrayLike) -> np.ndarray:
    """Transform (4, 4) of points from the affine frame to the metric frame of view 1 (2.16)."""
    H = np.eye(4)
    H[:3, :3] = np.linalg.inv(np.asarray(K, float))
    return H
