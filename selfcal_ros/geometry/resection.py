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
"""Resection: a camera matrix from points and their image, its parts, and their covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import homogeneous, normalising_transform, rq
from selfcal_ros.geometry.robust_loss import huber_weights
from selfcal_ros.geometry.robust_scale import robust_sigma_of_lengths

#: A camera matrix has eleven degrees of freedom; six points give twelve equations.
MIN_POINTS = 6


@dataclass(frozen=True)
class Resection:
    """
    A camera matrix with its covariance.

    Attributes
    ----------
    P : ndarray, shape (3, 4)
        Unit norm, from homogeneous points to pixels.
    covariance : ndarray, shape (12, 12)
        Of the row-wise entries of P, of rank 11, scaled by the residuals.
    residuals : ndarray, shape (n, 2)
        Projected minus measured, pixels.
    weights : ndarray, shape (n,)
        Of the points in the last iteration; below 1 for gross errors.

    """

    P: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    weights: np.ndarray

    @property
    def mean_error_px(self) -> float:
        """Mean reprojection distance (the measure of the thesis's table 3.1)."""
        return float(np.linalg.norm(self.residuals, axis=1).mean())

    @property
    def sigma_px(self) -> float:
        """Standard deviation of an image coordinate, with 2 n - 11 degrees of freedom."""
        spare = max(2 * len(self.residuals) - 11, 1)
        return float(np.sqrt(np.sum(self.residuals**2) / spare))


@dataclass(frozen=True)
class CameraParts:
    """
    Calibration and pose of a camera matrix, P ~ K R [I | -c].

    Attributes
    ----------
    K : ndarray, shape (3, 3)
        Pixels, K[2, 2] = 1, positive diagonal.
    R : ndarray, shape (3, 3)
        Camera from world; a rotation.
    centre : ndarray, shape (3,)
        World coordinates.
    covariance : ndarray, shape (11, 11), or None
        Of fx, fy, cx, cy, skew, the rotation (a small turn on the camera's side, rad) and the
        centre.

    """

    K: np.ndarray
    R: np.ndarray
    centre: np.ndarray
    covariance: np.ndarray | None = None

    @property
    def cam_from_world(self) -> np.ndarray:
        """Return [R | t], shape (3, 4)."""
        return np.column_stack([self.R, -self.R @ self.centre])


def _homogeneous_points(points: ArrayLike) -> np.ndarray:
    points = np.asarray(points, float)
    return homogeneous(points) if points.shape[1] == 3 else points


def resect_linear(points: ArrayLike, xy: ArrayLike) -> np.ndarray | NoEstimate:
    """
    Camera matrix by direct linear transformation (3.11), points and image normalised.

    Parameters
    ----------
    points : array_like, shape (n, 3) or (n, 4)
        Points, or homogeneous points of any stratum.
    xy : array_like, shape (n, 2)
        Pixels.

    Returns
    -------
    ndarray, shape (3, 4), unit norm, or NoEstimate
        No camera from fewer than six points, or from points that lie on a plane.

    """
    X, xy = _homogeneous_points(points), np.asarray(xy, float)
    if len(X) < MIN_POINTS:
        return NoEstimate('too_few', what='camera matrix', needed=MIN_POINTS, items='points',
                          found=len(X))
    X = X / np.linalg.norm(X, axis=1, keepdims=True)
    # any change of the points' frame will do; the one that whitens them conditions best
    values, vectors = np.linalg.eigh(X.T @ X / len(X))
    if not values[0] > 1e-13 * values[3]:
        return NoEstimate('points_on_plane')
    whiten = (vectors / np.sqrt(values)).T
    T = normalising_transform(xy)
    Y, uv = X @ whiten.T, xy * T[0, 0] + T[:2, 2]
    Y = Y / np.linalg.norm(Y, axis=1, keepdims=True)
    zero = np.zeros_like(Y)
    rows = np.concatenate([np.concatenate([Y, zero, -uv[:, :1] * Y], axis=1),
                           np.concatenate([zero, Y, -uv[:, 1:] * Y], axis=1)])
    _, singular, Vt = np.linalg.svd(rows, full_matrices=False)
    if not singular[-2] > 1e-10 * singular[0]:
        return NoEstimate('camera_matrix_open')
    P = np.linalg.solve(T, Vt[-1].reshape(3, 4)) @ whiten
    P /= np.linalg.norm(P)
    oriented: np.ndarray = P * np.sign((X @ P[2]).sum() or 1.0)
    return oriented


def projection_jacobian(P: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Project homogeneous points and differentiate by the entries of P (3.9).

    Parameters
    ----------
    P : ndarray, shape (3, 4)
    X : ndarray, shape (n, 4)

    Returns
    -------
    xy : ndarray, shape (n, 2)
    slope : ndarray, shape (n, 2, 12)

    """
    x = X @ P.T
    with np.errstate(divide='ignore', invalid='ignore'):
        xy, scaled = x[:, :2] / x[:, 2:], X / x[:, 2:]
    slope = np.zeros((len(X), 2, 3, 4))
    slope[:, 0, 0] = slope[:, 1, 1] = scaled
    slope[:, :, 2] = -xy[:, :, None] * scaled[:, None]
    return xy, slope.reshape(len(X), 2, 12)


def resect(points: ArrayLike, xy: ArrayLike, start: ArrayLike | None = None,
           iterations: int = 30, huber_sigmas: float = np.inf) -> Resection | NoEstimate:
    """
    Camera matrix of least reprojection error: linear start, Levenberg-Marquardt (3.9).

    Parameters
    ----------
    points : array_like, shape (n, 3) or (n, 4)
        Points, or homogeneous points of any stratum.
    xy : array_like, shape (n, 2)
        Pixels.
    start : array_like, shape (3, 4), optional
        In place of the linear solution.
    iterations : int
    huber_sigmas : float
        Residuals beyond so many (robust) sigmas weigh less; infinite: least squares.

    Returns
    -------
    Resection or NoEstimate

    """
    X, xy = _homogeneous_points(points), np.asarray(xy, float)
    P = resect_linear(X, xy) if start is None else np.array(start, float)
    if isinstance(P, NoEstimate):
        return P
    # the whitened frame of the linear solution keeps the normal equations well scaled, too
    scale = np.linalg.norm(X, axis=1, keepdims=True)
    X = X / np.maximum(scale, 1e-300)
    values, vectors = np.linalg.eigh(X.T @ X / len(X))
    whiten = (vectors / np.sqrt(np.maximum(values, 1e-15 * values[3]))).T
    T = normalising_transform(xy)
    Q = T @ P @ np.linalg.inv(whiten)
    found = _descended(Q / np.linalg.norm(Q), X @ whiten.T, xy * T[0, 0] + T[:2, 2], iterations,
                       huber_sigmas)
    if isinstance(found, NoEstimate):
        return found
    # vec(P) = back vec(Q), up to scale
    back = np.kron(np.linalg.inv(T), np.eye(4)) @ np.kron(np.eye(3), whiten.T)
    P = back @ found.Q.ravel()
    norm = np.linalg.norm(P)
    P = P / norm
    carry = (np.eye(12) - np.outer(P, P)) @ back / norm
    return Resection(P.reshape(3, 4), carry @ found.covariance() @ carry.T, found.r / T[0, 0],
                     found.weight)


@dataclass(frozen=True)
class _Optimum:
    """
    A camera matrix in whitened frames, at the minimum of the weighted reprojection error.

    Attributes
    ----------
    Q : ndarray, shape (3, 4)
        Unit norm.
    r : ndarray, shape (n, 2)
        Residuals in the normalised image.
    J : ndarray, shape (n, 2, 12)
        Their derivatives by the row-wise entries of Q.
    weight : ndarray, shape (n,)

    """

    Q: np.ndarray
    r: np.ndarray
    J: np.ndarray
    weight: np.ndarray

    @classmethod
    def at(cls, Q: np.ndarray, Y: np.ndarray, uv: np.ndarray, weight: np.ndarray) -> _Optimum:
        """Project points Y (n, 4) and compare with the image uv (n, 2)."""
        image, J = projection_jacobian(Q, Y)
        return cls(Q, image - uv, J, weight)

    @property
    def cost(self) -> float:
        """Weighted sum of squares."""
        return float(np.sum(self.weight[:, None] * self.r**2))

    @property
    def basis(self) -> np.ndarray:
        """Directions across vec(Q), in which its unit norm lets it move, shape (12, 11)."""
        across: np.ndarray = np.linalg.svd(self.Q.reshape(1, 12))[2][1:].T
        return across

    def slopes(self, basis: np.ndarray) -> np.ndarray:
        """Weighted derivatives of all residuals along a basis (12, 11), shape (2 n, 11)."""
        slopes: np.ndarray = (self.J * np.sqrt(self.weight)[:, None, None]).reshape(-1, 12) @ basis
        return slopes

    def reweighted(self, huber_sigmas: float) -> _Optimum:
        """Return the same with Huber's weights, by the residuals' own robust scale."""
        distance = np.linalg.norm(self.r, axis=1)
        limit = huber_sigmas * max(robust_sigma_of_lengths(distance), 1e-12)
        return replace(self, weight=huber_weights(distance, limit))

    def covariance(self) -> np.ndarray:
        """Covariance (12, 12) of vec(Q), scaled by the residuals."""
        basis = self.basis
        A = self.slopes(basis)
        variance = self.cost / max(2 * len(self.r) - 11, 1)
        spread: np.ndarray = (variance * basis @ np.linalg.pinv(A.T @ A, hermitian=True)
                              @ basis.T)
        return spread


def _descended(Q: np.ndarray, Y: np.ndarray, uv: np.ndarray, iterations: int,
               huber_sigmas: float) -> _Optimum | NoEstimate:
    """
    Minimise the reprojection error of points Y (n, 4) at uv (n, 2) by Levenberg-Marquardt.

    A loop of its own: the weights change with every step, and the cost with them, which
    `levenberg_marquardt.minimise` does not allow for.
    """
    here, damping = _Optimum.at(Q, Y, uv, np.ones(len(Y))), 1e-4
    for _ in range(iterations):
        if np.isfinite(huber_sigmas):
            here = here.reweighted(huber_sigmas)
        cost = here.cost
        if not np.isfinite(cost):
            return NoEstimate('point_at_infinity')
        basis = here.basis
        A, b = here.slopes(basis), (here.r * np.sqrt(here.weight)[:, None]).ravel()
        H, g = A.T @ A, A.T @ b
        improved = False
        while damping < 1e8:
            step = basis @ np.linalg.solve(
                H + damping * np.diag(np.maximum(np.diag(H), 1e-300)), g)
            moved = here.Q - step.reshape(3, 4)
            trial = _Optimum.at(moved / np.linalg.norm(moved), Y, uv, here.weight)
            new_cost = trial.cost
            if new_cost <= cost:
                here, improved = trial, True
                damping = max(damping * 0.1, 1e-12)
                break
            damping *= 10
        if not improved or cost - new_cost < 1e-10 * cost:
            break
    return here


def decompose(P: ArrayLike, covariance: ArrayLike | None = None) -> CameraParts | NoEstimate:
    """
    Split a metric camera matrix into calibration, rotation and centre, by RQ decomposition.

    Parameters
    ----------
    P : array_like, shape (3, 4)
        Any non-zero scale and sign.
    covariance : array_like, shape (12, 12), optional
        Of its row-wise entries.

    Returns
    -------
    CameraParts or NoEstimate
        No parts where the left half is singular: a camera at infinity.

    """
    P = np.asarray(P, float)
    M = P[:, :3]
    if not np.linalg.cond(M / np.linalg.norm(M, axis=1, keepdims=True)) < 1e10:
        return NoEstimate('camera_at_infinity')
    sign = np.sign(np.linalg.det(M))
    U, R = rq(sign * M)
    inverse = np.linalg.inv(M)
    centre = -inverse @ P[:, 3]
    K = U / U[2, 2]
    if covariance is None:
        return CameraParts(K, R, centre)
    # U^-1 dM R^T = U^-1 dU + [w]x: an upper triangular and a skew-symmetric part
    slopes = np.eye(12).reshape(12, 3, 4)
    dM = sign * slopes[:, :, :3]
    both = np.linalg.inv(U) @ dM @ R.T
    lower = np.tril(both, -1)
    skew = lower - np.swapaxes(lower, 1, 2)
    dU = U @ (both - skew)
    dK = dU / U[2, 2] - K * (dU[:, 2:, 2:] / U[2, 2])
    dc = -(slopes[:, :, 3] + slopes[:, :, :3] @ centre) @ inverse.T
    J = np.column_stack([dK[:, 0, 0], dK[:, 1, 1], dK[:, 0, 2], dK[:, 1, 2], dK[:, 0, 1],
                         skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0], dc])
    return CameraParts(K, R, centre, J.T @ np.asarray(covariance, float) @ J)
