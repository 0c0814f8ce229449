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
"""Points from rays: the correction line of translated views, and many views at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.projective import tangent_basis


def correct_to_epipolar_line(epipole: ArrayLike, xy_a: ArrayLike, xy_b: ArrayLike,
                             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Move matches of two translated views onto one line through the epipole (algorithm 4.1).

    The correction line is the one that minimises the summed squared distance to both points;
    it equals the optimum of Hartley and Sturm for F = [e]x, in closed form.

    Parameters
    ----------
    epipole : array_like, shape (3,)
        e, the same point in both images; may lie at infinity.
    xy_a, xy_b : array_like, shape (m, 2)
        Pixels.

    Returns
    -------
    xy_a, xy_b : ndarray, shape (m, 2)
        Corrected, pixels.
    moved : ndarray, shape (m, 2)
        Signed distance of each original point from its line, pixels: first image, second.

    """
    e = np.asarray(epipole, float)
    a, b = np.asarray(xy_a, float), np.asarray(xy_b, float)
    middle, half = (a + b) / 2, (b - a) / 2
    # everything relative to the middle of the two points, so that e may be at infinity
    towards = e[:2] - e[2] * middle
    reach = np.maximum(np.linalg.norm(towards, axis=1), 1e-300)
    along = towards / reach[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    h, p = np.sum(half * along, axis=1), np.sum(half * across, axis=1)
    # the line's direction is the principal one of both offsets from e
    angle = 0.5 * np.arctan2(2 * e[2]**2 * h * p, reach**2 + e[2]**2 * (h * h - p * p))
    normal = np.cos(angle)[:, None] * across - np.sin(angle)[:, None] * along
    offset = -reach * np.sin(angle) / e[2] if e[2] else np.zeros(len(a))
    moved = np.stack([np.sum((a - middle) * normal, axis=1) - offset,
                      np.sum((b - middle) * normal, axis=1) - offset], axis=1)
    return a - moved[:, :1] * normal, b - moved[:, 1:] * normal, moved


def translated_points(epipole: ArrayLike, xy_a: ArrayLike, xy_b: ArrayLike) -> np.ndarray:
    """
    Affine points of two translated views, P = [I | 0] and P' = [I | e] (lemma 4.1).

    Parameters
    ----------
    epipole : array_like, shape (3,)
        Its scale sets that of the inverse depths.
    xy_a, xy_b : array_like, shape (m, 2)
        Pixels; corrected first, see `correct_to_epipolar_line`.

    Returns
    -------
    ndarray, shape (m, 4)
        Homogeneous points (x, y, 1, inverse depth); the last is zero at infinity.

    """
    e = np.asarray(epipole, float)
    a, b, _ = correct_to_epipolar_line(e, xy_a, xy_b)
    # x' (1 + r e3) = x + r (e1, e2) with r the inverse depth
    slope = e[:2] - e[2] * b
    square = np.maximum(np.sum(slope**2, axis=1), 1e-300)
    inverse_depth = np.sum((b - a) * slope, axis=1) / square
    return np.column_stack([a, np.ones(len(a)), inverse_depth])


def project(cameras: ArrayLike, points: ArrayLike) -> np.ndarray:
    """
    Project homogeneous points by camera matrices, row by row.

    Parameters
    ----------
    cameras : array_like, shape (..., 3, 4)
    points : array_like, shape (..., 4)

    Returns
    -------
    ndarray, shape (..., 2)
        Pixels; infinite or NaN on the camera's focal plane.

    """
    x = np.einsum('...ij,...j->...i', np.asarray(cameras), np.asarray(points))
    with np.errstate(divide='ignore', invalid='ignore'):
        xy: np.ndarray = x[..., :2] / x[..., 2:]
    return xy


def triangulate(cameras: ArrayLike, view: ArrayLike, point: ArrayLike, xy: ArrayLike,
                iterations: int = 3) -> np.ndarray:
    """
    Intersect the rays of many points in many views: linear, then Gauss-Newton on the image.

    Parameters
    ----------
    cameras : array_like, shape (V, 3, 4)
        Of any stratum: projective, affine or metric.
    view, point : array_like of int, shape (N,)
        Indices from zero; every point is seen at least twice.
    xy : array_like, shape (N, 2)
        Pixels.
    iterations : int
        Gauss-Newton steps on the reprojection error; a step that does not lower a point's
        error is not taken.

    Returns
    -------
    ndarray, shape (P, 4)
        Unit homogeneous points in the frame of the cameras.

    """
    cameras, xy = np.asarray(cameras, float), np.asarray(xy, float)
    view, point = np.asarray(view), np.asarray(point)
    count = int(point.max(initial=-1)) + 1
    P = cameras[view]
    # two equations of each observation, brought to distances on the image of unit scale
    centre, scale = xy.mean(axis=0), max(float(xy.std()), 1e-12)
    T = np.array([[1 / scale, 0, -centre[0] / scale], [0, 1 / scale, -centre[1] / scale],
                  [0, 0, 1]])
    P, uv = T @ P, (xy - centre) / scale
    P = P / np.linalg.norm(P[:, 2, :3], axis=1)[:, None, None]
    rows = uv[:, :, None] * P[:, None, 2] - P[:, :2]
    rows /= np.maximum(np.linalg.norm(rows, axis=2, keepdims=True), 1e-300)
    X = np.linalg.eigh(_summed(point, count, np.swapaxes(rows, 1, 2) @ rows))[1][..., 0]
    error = _errors(P, X, point, count, uv)
    for _ in range(iterations):
        basis = tangent_basis(X)
        x = np.einsum('nij,nj->ni', P, X[point])
        with np.errstate(divide='ignore', invalid='ignore'):
            image = x[:, :2] / x[:, 2:]
            slope = (P[:, :2] - image[:, :, None] * P[:, None, 2]) / x[:, 2, None, None]
        J = slope @ basis[point]
        J, r = np.nan_to_num(J, posinf=0, neginf=0), np.nan_to_num(image - uv, posinf=0, neginf=0)
        H = _summed(point, count, np.swapaxes(J, 1, 2) @ J)
        H += (1e-12 * np.trace(H, axis1=1, axis2=2)[:, None, None] + 1e-300) * np.eye(3)
        g = _summed(point, count, np.einsum('nij,ni->nj', J, r))
        trial = X - np.einsum('pij,pj->pi', basis, np.linalg.solve(H, g[..., None])[..., 0])
        trial /= np.linalg.norm(trial, axis=1, keepdims=True)
        new = _errors(P, trial, point, count, uv)
        better = new < error
        X, error = np.where(better[:, None], trial, X), np.where(better, new, error)
    return X


def _summed(point: np.ndarray, count: int, values: np.ndarray) -> np.ndarray:
    """Add rows (N, ...) of each point."""
    flat = values.reshape(len(values), -1)
    total = np.stack([np.bincount(point, column, count) for column in flat.T], axis=1)
    return total.reshape(count, *values.shape[1:])


def _errors(P: np.ndarray, X: np.ndarray, point: np.ndarray, count: int,
            uv: np.ndarray) -> np.ndarray:
    """Sum of squared distances of each point in the image."""
    square = np.sum((project(P, X[point]) - uv)**2, axis=1)
    return np.bincount(point, np.where(np.isfinite(square), square, 1e12), count)


def metric_points(K: ArrayLike, affine_points: ArrayLike) -> np.ndarray:
    """
    Carry affine points of a frame in which view 1 is [I | 0] to Euclidean ones (2.16).

    Parameters
    ----------
    K : array_like, shape (3, 3)
    affine_points : array_like, shape (m, 4)

    Returns
    -------
    ndarray, shape (m, 3)
        In the frame of view 1, up to scale; infinite where a point is at infinity.

    """
    X = np.asarray(affine_points, float)
    with np.errstate(divide='ignore', invalid='ignore'):
        points: np.ndarray = (X[:, :3] / X[:, 3:]) @ np.linalg.inv(np.asarray(K)).T
    return points
