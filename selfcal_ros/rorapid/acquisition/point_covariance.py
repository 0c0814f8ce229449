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
"""How noise of the image points moves points that two translated views determine."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.triangulation import translated_points

#: Step of the numerical derivatives, normalised coordinates.
_STEP = 1e-6


def point_jacobian(K: np.ndarray, e: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """
    Derivative of all points by all image coordinates.

    A point depends on its own image points, and through the epipole on all of them: the epipole
    is that of least Sampson distances, linearised.

    Parameters
    ----------
    K : ndarray, shape (3, 3)
    e : ndarray, shape (3,)
        Epipole, pixels.
    a, b : ndarray, shape (N, 2)
        Undistorted pixels in the first and the second view.

    Returns
    -------
    ndarray, shape (3 N, 4 N)
        Points in units in which |e| has its given length, per pixel of (u, v, u', v').

    """
    inverse, count = np.linalg.inv(K), len(a)
    e = inverse @ e
    size = np.linalg.norm(e)
    e = e / size
    a, b = (p @ inverse[:2, :2].T + inverse[:2, 2] for p in (a, b))
    basis = np.linalg.svd(e[None])[2][1:].T

    def evaluate(e: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Points, and sines between the epipolar lines' points: zero without noise."""
        h = np.ones((2, len(a), 3))
        h[0, :, :2], h[1, :, :2] = a, b
        X = translated_points(e, a, b)
        return np.column_stack([X[:, :3] / X[:, 3:], np.cross(h[0], h[1]) @ e])

    # columns: u, v in the first image, u, v in the second, pixels
    pixel = inverse[:2, :2].T * _STEP * K[0, 0]
    own = np.stack([evaluate(e, a + d, b) - evaluate(e, a - d, b) for d in pixel]
                   + [evaluate(e, a, b + d) - evaluate(e, a, b - d) for d in pixel],
                   axis=2) / (2 * _STEP * K[0, 0])
    common = np.stack([evaluate(e + _STEP * d, a, b) - evaluate(e - _STEP * d, a, b)
                       for d in basis.T], axis=2) / (2 * _STEP)
    # Sampson: residuals weighted by what pixel noise does to each
    norm = np.maximum(np.linalg.norm(own[:, 3], axis=1), 1e-300)[:, None]
    own_residual, slope = own[:, 3] / norm, common[:, 3] / norm
    gain = -np.linalg.pinv(slope)
    shift = np.einsum('jm,mk->jmk', gain, own_residual).reshape(len(gain), 4 * count)
    jacobian = np.einsum('nij,jm->nim', common[:, :3], shift).reshape(count, 3, count, 4)
    each = np.arange(count)
    jacobian[each, :, each] += own[:, :3]
    scaled: np.ndarray = size * jacobian.reshape(3 * count, 4 * count)
    return scaled


def blocks(covariance: np.ndarray) -> np.ndarray:
    """Return the covariance (N, 3, 3) of each point from that of all, (3 N, 3 N)."""
    count = len(covariance) // 3
    each = np.arange(count)
    return covariance.reshape(count, 3, count, 3)[each, :, each]


def shape_covariances(points: np.ndarray, jacobian: np.ndarray,
                      ends: tuple[int, int] | None = None) -> np.ndarray:
    """
    Covariances of points where a turn and a shift of all of them together do not count.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
    jacobian : ndarray, shape (3 N, M)
        Of the points by noise of unit variance, as the scale of the two views has it.
    ends : (int, int), optional
        Two points whose distance is known exactly, and fixes the scale.

    Returns
    -------
    ndarray, shape (N, 3, 3)

    """
    count = len(points)
    if ends is not None:
        i, j = ends
        span = points[i] - points[j]
        longer = span @ (jacobian.reshape(count, 3, -1)[i] - jacobian.reshape(count, 3, -1)[j])
        jacobian = jacobian - np.outer(points.ravel(), longer / (span @ span))
    x, y, z = (points - points.mean(axis=0)).T
    none = np.zeros(count)
    turns = np.stack([[none, -z, y], [z, none, -x], [-y, x, none]]).transpose(2, 1, 0)
    moves = np.concatenate([turns.reshape(3 * count, 3), np.tile(np.eye(3), (count, 1))], axis=1)
    basis, size, _ = np.linalg.svd(moves, full_matrices=False)
    rigid = basis[:, size > 1e-9 * size.max()]
    left = jacobian - rigid @ (rigid.T @ jacobian)
    return blocks(left @ left.T)
