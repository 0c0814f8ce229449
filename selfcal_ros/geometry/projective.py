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
"""Homogeneous points, lines and conics of the plane, and the frames they are worked in."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.no_estimate import NoEstimate


def homogeneous(xy: ArrayLike) -> np.ndarray:
    """Append 1 to points (..., n); returns (..., n + 1)."""
    xy = np.asarray(xy)
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


def euclidean(x: ArrayLike) -> np.ndarray:
    """Divide homogeneous points (..., n + 1) by their last entry; infinite where it is 0."""
    x = np.asarray(x)
    with np.errstate(divide='ignore', invalid='ignore'):
        xy: np.ndarray = x[..., :-1] / x[..., -1:]
    return xy


def unit(x: ArrayLike) -> np.ndarray:
    """Scale vectors (..., n) to unit norm."""
    x = np.asarray(x)
    scaled: np.ndarray = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return scaled


def cross_matrix(a: ArrayLike) -> np.ndarray:
    """Matrix [a]x of the cross product, (..., 3) to (..., 3, 3)."""
    a = np.asarray(a)
    matrix = np.zeros((*a.shape, 3), a.dtype)
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    matrix[..., 2, 1], matrix[..., 1, 2] = x, -x
    matrix[..., 0, 2], matrix[..., 2, 0] = y, -y
    matrix[..., 1, 0], matrix[..., 0, 1] = z, -z
    return matrix


def about_axis(vector: np.ndarray, one: np.ndarray, skew: np.ndarray, square: np.ndarray,
               ) -> np.ndarray:
    """
    Return one · I + skew · [v]x + square · v vᵀ: what rotations and their derivatives are made of.

    Parameters
    ----------
    vector : ndarray, shape (..., 3)
    one, skew, square : ndarray, shape (...,)

    Returns
    -------
    ndarray, shape (..., 3, 3)

    """
    matrix: np.ndarray = (square[..., None] * vector)[..., None] * vector[..., None, :]
    turned = skew[..., None] * vector
    x, y, z = turned[..., 0], turned[..., 1], turned[..., 2]
    for k in range(3):
        matrix[..., k, k] += one
    matrix[..., 2, 1] += x
    matrix[..., 1, 2] -= x
    matrix[..., 0, 2] += y
    matrix[..., 2, 0] -= y
    matrix[..., 1, 0] += z
    matrix[..., 0, 1] -= z
    return matrix


def tangent_basis(points: np.ndarray) -> np.ndarray:
    """Orthonormal complements of unit vectors (P, 4), shape (P, 4, 3), by a Householder map."""
    u = points.copy()
    u[:, 3] += np.copysign(1.0, u[:, 3])
    # |u|² / 2 of a unit vector is 1 + |w|
    scaled = u / -np.abs(u[:, 3:])
    basis: np.ndarray = scaled[:, :, None] * u[:, None, :3]
    for k in range(3):
        basis[:, k, k] += 1
    return basis


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors (N, k), shape (N,), in less time than `numpy.linalg.norm`."""
    squares: np.ndarray = np.einsum('nk,nk->n', vectors, vectors)
    np.sqrt(squares, out=squares)
    return squares


def rms_length(vectors: np.ndarray) -> float:
    """Return the root mean square length of vectors (N, k), without those that are NaN."""
    return float(np.sqrt(np.nanmean(np.sum(vectors**2, axis=1))))


def normalising_transform(xy: ArrayLike) -> np.ndarray:
    """
    Similarity that brings points to centroid 0 and mean distance sqrt 2 (Hartley).

    Parameters
    ----------
    xy : array_like, shape (N, 2)

    Returns
    -------
    ndarray, shape (3, 3)
        Points that all coincide are only shifted.

    """
    xy = np.asarray(xy, float).reshape(-1, 2)
    centre = xy.mean(axis=0)
    distance = np.linalg.norm(xy - centre, axis=1).mean()
    scale = np.sqrt(2) / distance if distance > 0 else 1.0
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])


def completed_frame(a: ArrayLike) -> np.ndarray:
    """Rotation (..., 3, 3) whose first column is the unit vector a (..., 3)."""
    a = np.asarray(a, float)
    helper = np.eye(3)[np.argmin(np.abs(a), axis=-1)]
    second = unit(np.cross(a, helper))
    return np.stack([a, second, np.cross(a, second)], axis=-1)


def small_rotation(w: ArrayLike) -> np.ndarray:
    """Orthogonal matrix equal to I + [w]x to first order (Cayley), (..., 3) to (..., 3, 3)."""
    half = np.asarray(w, float) / 2
    square = np.sum(half * half, axis=-1)
    scale = 2 / (1 + square)
    return about_axis(half, 1 - scale * square, scale, scale)


def rq(M: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """
    Decompose M = U Q with U upper triangular with positive diagonal and Q orthogonal.

    Parameters
    ----------
    M : array_like, shape (3, 3)
        Regular.

    Returns
    -------
    U, Q : ndarray, shape (3, 3)
        det Q has the sign of det M.

    """
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ np.asarray(M, float)).T)
    U, Q = flip @ r.T @ flip, flip @ q.T
    sign = np.where(np.diag(U) < 0, -1.0, 1.0)
    return U * sign, sign[:, None] * Q


def camera_centres(poses: np.ndarray) -> np.ndarray:
    """Return the camera centres (V, 3) of poses [R | t], shape (V, 3, 4)."""
    centres: np.ndarray = -np.einsum('vji,vj->vi', poses[:, :, :3], poses[:, :, 3])
    return centres


def line_pair(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Degenerate conic a b^T + b a^T of two lines (..., 3)."""
    a, b = np.asarray(a), np.asarray(b)
    conic: np.ndarray = a[..., :, None] * b[..., None, :] + b[..., :, None] * a[..., None, :]
    return conic


def canonical_transform(line: ArrayLike, point: ArrayLike) -> np.ndarray:
    """
    Homography that carries the horizon and the vanishing point to (0, 1, 0) both (5.30).

    Parameters
    ----------
    line : array_like, shape (3,)
        Horizon l; not the line at infinity.
    point : array_like, shape (3,)
        Vanishing point v; not on l.

    Returns
    -------
    ndarray, shape (3, 3)
        A similarity makes l the x axis. Then a projectivity fixes that axis and sends v to the
        point at infinity of the y axis.

    """
    line = np.asarray(line, float)
    l1, l2, l3 = line / np.hypot(line[0], line[1])
    first = np.array([[l2, -l1, 0], [l1, l2, l3], [0, 0, 1]])
    a, b, c = first @ np.asarray(point, float)
    second: np.ndarray = np.array([[1, -a / b, 0], [0, 1, 0], [0, -c / b, 1]])
    transform: np.ndarray = second @ first
    return transform


def canonical_slopes(line: ArrayLike, point: ArrayLike) -> np.ndarray:
    """
    Derivative of `canonical_transform`.

    Parameters
    ----------
    line, point : array_like, shape (3,)

    Returns
    -------
    ndarray, shape (3, 3, 6)
        By the entries of the line, then of the point.

    """
    line, point = np.asarray(line, float), np.asarray(point, float)
    norm = np.hypot(line[0], line[1])
    l1, l2, l3 = line / norm
    first = np.array([[l2, -l1, 0], [l1, l2, l3], [0, 0, 1]])
    scaled = np.zeros((3, 6))
    scaled[:, :3] = (np.eye(3) - np.outer([l1, l2, l3], [l1, l2, 0])) / norm
    d_first = np.zeros((3, 3, 6))
    d_first[0, 0], d_first[0, 1] = scaled[1], -scaled[0]
    d_first[1] = scaled
    a, b, c = first @ point
    moved = np.einsum('ijk,j->ik', d_first, point)
    moved[:, 3:] += first
    second = np.array([[1, -a / b, 0], [0, 1, 0], [0, -c / b, 1]])
    d_second = np.zeros((3, 3, 6))
    d_second[0, 1] = (a / b * moved[1] - moved[0]) / b
    d_second[2, 1] = (c / b * moved[1] - moved[2]) / b
    slopes: np.ndarray = (np.einsum('ijk,jl->ilk', d_second, first)
                          + np.einsum('ij,jlk->ilk', second, d_first))
    return slopes


def unit_slope(carry: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Map x (n,) by a matrix and scale to unit norm: the vector, and its derivative (n, n)."""
    x = np.asarray(carry) @ x
    norm = np.linalg.norm(x)
    x = x / norm
    return x, (np.eye(len(x)) - np.outer(x, x)) @ carry / norm


def unit_covariance(x: ArrayLike, covariance: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """
    Scale a homogeneous vector to unit norm together with its covariance.

    Parameters
    ----------
    x : array_like, shape (n,)
    covariance : array_like, shape (n, n)

    Returns
    -------
    x, covariance : ndarray
        The covariance is singular along x.

    """
    x = np.asarray(x, float)
    norm = np.linalg.norm(x)
    scaled: np.ndarray = x / norm
    jacobian = (np.eye(len(scaled)) - np.outer(scaled, scaled)) / norm
    return scaled, jacobian @ covariance @ jacobian.T


def euclidean_covariance(x: ArrayLike, covariance: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """
    Divide a homogeneous vector by its last entry together with its covariance.

    Parameters
    ----------
    x : array_like, shape (3,)
    covariance : array_like, shape (3, 3)

    Returns
    -------
    x : ndarray, shape (2,)
    covariance : ndarray, shape (2, 2)

    """
    x = np.asarray(x, float)
    jacobian = np.array([[1, 0, -x[0] / x[2]], [0, 1, -x[1] / x[2]]]) / x[2]
    return x[:2] / x[2], jacobian @ covariance @ jacobian.T


def weighted_mean(vectors: np.ndarray, covariances: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Covariance-weighted mean of homogeneous vectors that should be equal (6.4, 6.5).

    Parameters
    ----------
    vectors : ndarray, shape (n, 3)
        Unit norm, any sign.
    covariances : ndarray, shape (n, 3, 3)

    Returns
    -------
    mean : ndarray, shape (3,)
        Unit norm.
    covariance : ndarray, shape (3, 3)

    """
    mean = vectors[np.argmin(np.trace(covariances, axis1=1, axis2=2))]
    for _ in range(3):
        frame = completed_frame(mean)
        signed = vectors * np.sign(vectors @ mean)[:, None]
        flat = signed @ frame
        offset = flat[:, 1:] / flat[:, :1]
        tangent = frame[:, 1:].T @ covariances @ frame[:, 1:]
        information = np.linalg.pinv(tangent, hermitian=True)
        covariance = np.linalg.pinv(information.sum(axis=0), hermitian=True)
        step = covariance @ (information @ offset[..., None])[..., 0].sum(axis=0)
        mean = unit(mean + frame[:, 1:] @ step)
    return mean, frame[:, 1:] @ covariance @ frame[:, 1:].T


def iac_from_calibration(K: ArrayLike) -> np.ndarray:
    """Image of the absolute conic, (K K^T)^-1, shape (3, 3)."""
    inverse = np.linalg.inv(np.asarray(K))
    omega: np.ndarray = inverse.T @ inverse
    return omega


def calibration_from_iac(omega: ArrayLike) -> np.ndarray | NoEstimate:
    """
    Calibration matrix of an image of the absolute conic, by Cholesky's method.

    Parameters
    ----------
    omega : array_like, shape (3, 3)
        Symmetric, any non-zero scale.

    Returns
    -------
    ndarray, shape (3, 3), or NoEstimate
        K, upper triangular with K[2, 2] = 1; no K where omega is not definite.

    """
    conic: np.ndarray = np.asarray(omega, float)
    if not np.isfinite(conic).all():
        return NoEstimate('conic_not_finite')
    conic = (conic + conic.T) / 2
    if conic[0, 0] < 0:
        conic = -conic
    # pixels and units differ by orders of magnitude: judge definiteness on a scaled matrix
    diagonal = np.abs(np.diag(conic))
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    try:
        lower = np.linalg.cholesky(conic / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        least = np.linalg.eigvalsh(conic / np.outer(scale, scale))[0]
        return NoEstimate('conic_not_definite', least=float(least))
    K = np.linalg.inv((lower * scale[:, None]).T)
    upper: np.ndarray = np.triu(K / K[2, 2])
    return upper
