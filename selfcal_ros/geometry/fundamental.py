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
Fundamental matrices of many image pairs at once: x'^T F x = 0 (thesis, appendix A).

Every refinement minimises the symmetric epipolar distance (A.2) in pixels. All
parameterisations share one thing: the normal equations with respect to the nine entries of each
F, to which each adds the derivative of F by its own few parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import (completed_frame, cross_matrix,
                                             normalising_transform, small_rotation)
from selfcal_ros.geometry.propagation import pair_influence, residual_slopes

#: Below this root mean square, in pixels, a residual is rounding and no longer noise.
ROUNDING_PX = 1e-7


@dataclass(frozen=True)
class PairMatches:
    """
    Matches of several image pairs in one array, normalised by one common similarity.

    Attributes
    ----------
    first, second : ndarray, shape (n, m, 3)
        Homogeneous normalised points; rows beyond a pair's matches are (0, 0, 1).
    weight : ndarray, shape (n, m)
        1 for a match, 0 for padding or a match that is left out.
    transform : ndarray, shape (3, 3)
        From pixels to normalised coordinates, the same for both images of every pair.

    """

    first: np.ndarray
    second: np.ndarray
    weight: np.ndarray
    transform: np.ndarray

    @classmethod
    def from_pixels(cls, pairs: Iterable[tuple[ArrayLike, ArrayLike]],
                    transform: np.ndarray | None = None) -> PairMatches:
        """Stack [(xy_a (m, 2), xy_b (m, 2)), ...]; the counts may differ."""
        points = [(np.asarray(a, float), np.asarray(b, float)) for a, b in pairs]
        if transform is None:
            transform = normalising_transform(np.vstack([p for pair in points for p in pair]))
        counts = np.array([len(a) for a, _ in points])
        valid = np.arange(counts.max(initial=1)) < counts[:, None]
        first = np.zeros((*valid.shape, 3))
        first[..., 2] = 1
        second = first.copy()
        scale, shift = transform[0, 0], transform[:2, 2]
        first[valid, :2] = np.concatenate([a for a, _ in points]) * scale + shift
        second[valid, :2] = np.concatenate([b for _, b in points]) * scale + shift
        return cls(first, second, valid.astype(float), transform)

    def subset(self, rows: np.ndarray | slice) -> PairMatches:
        """Keep the pairs of the given rows."""
        return PairMatches(self.first[rows], self.second[rows], self.weight[rows],
                           self.transform)

    @property
    def counts(self) -> np.ndarray:
        """Matches per pair, shape (n,)."""
        counts: np.ndarray = (self.weight > 0).sum(axis=1)
        return counts

    def pixels_F(self, F: np.ndarray) -> np.ndarray:
        """Carry F (n, 3, 3) to pixels, scaled to unit norm."""
        F = self.transform.T @ F @ self.transform
        unit_F: np.ndarray = F / np.linalg.norm(F, axis=(-2, -1), keepdims=True)
        return unit_F


@dataclass(frozen=True)
class FundamentalEstimate:
    """
    One fundamental matrix with its covariance.

    Attributes
    ----------
    F : ndarray, shape (3, 3)
        In pixels, unit norm.
    covariance : ndarray, shape (9, 9)
        Of the row-wise entries of F, of rank p: first order, from the image points (thesis C.1).
    residuals : ndarray, shape (m, 2)
        Distances to the epipolar lines in the second and first image, pixels, signed.
    degrees_of_freedom : int
        p: 7 general, 2 translation, 6 planar.
    noise_px : float
        Estimated standard deviation of one image coordinate.

    """

    F: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    degrees_of_freedom: int
    noise_px: float

    @property
    def rms_px(self) -> float:
        """Root mean square distance with m - p degrees of freedom."""
        spare = max(len(self.residuals) - self.degrees_of_freedom, 1)
        return float(np.sqrt((self.residuals ** 2).sum() / (2 * spare)))


@overload
def pair_residuals(data: PairMatches, F: np.ndarray,
                   derivative: Literal[False] = False) -> np.ndarray: ...


@overload
def pair_residuals(data: PairMatches, F: np.ndarray,
                   derivative: Literal[True]) -> tuple[np.ndarray, np.ndarray]: ...


def pair_residuals(data: PairMatches, F: np.ndarray, derivative: bool = False,
                   ) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
    """
    Residuals of every pair in pixels and, if asked, their derivative by the entries of F.

    Parameters
    ----------
    data : PairMatches
    F : ndarray, shape (n, 3, 3)
        In normalised coordinates.
    derivative : bool

    Returns
    -------
    residuals : ndarray, shape (n, m, 2)
    slope : ndarray, shape (n, m, 2, 9)
        Only with `derivative`.

    """
    a, b = data.first, data.second
    line_b, line_a = a @ np.swapaxes(F, 1, 2), b @ F
    product = np.einsum('nmk,nmk->nm', line_b, b)
    tiny = 1e-300
    norm_b = np.sqrt(line_b[..., 0] ** 2 + line_b[..., 1] ** 2) + tiny
    norm_a = np.sqrt(line_a[..., 0] ** 2 + line_a[..., 1] ** 2) + tiny
    pixel = data.weight / data.transform[0, 0]
    residuals = np.stack([product / norm_b * pixel, product / norm_a * pixel], axis=-1)
    if not derivative:
        return residuals
    # both are outer products: a line turns about its point
    turned_b, turned_a = b * (pixel / norm_b)[..., None], a * (pixel / norm_a)[..., None]
    turned_b[..., :2] -= (residuals[..., 0] / norm_b ** 2)[..., None] * line_b[..., :2]
    turned_a[..., :2] -= (residuals[..., 1] / norm_a ** 2)[..., None] * line_a[..., :2]
    slope = np.empty((*a.shape[:2], 2, 3, 3))
    np.einsum('nmi,nmj->nmij', turned_b, a, out=slope[:, :, 0])
    np.einsum('nmi,nmj->nmij', b, turned_a, out=slope[:, :, 1])
    return residuals, slope.reshape(*a.shape[:2], 2, 9)


def normal_equations(data: PairMatches, F: np.ndarray,
                     ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Cost, gradient and Gauss-Newton matrix of every pair by the entries of F.

    Returns
    -------
    cost : ndarray, shape (n,)
    gradient : ndarray, shape (n, 9)
    matrix : ndarray, shape (n, 9, 9)

    """
    residuals, slope = pair_residuals(data, F, derivative=True)
    pairs = len(F)
    r, J = residuals.reshape(pairs, -1), slope.reshape(pairs, -1, 9)
    transposed = np.swapaxes(J, 1, 2)
    return (r * r).sum(axis=1), (transposed @ r[..., None])[..., 0], transposed @ J


def eight_point(data: PairMatches) -> np.ndarray:
    """
    Linear F of every pair, of rank 2, unit norm, normalised coordinates, shape (n, 3, 3).

    Pairs need at least eight matches; the caller sees to that.
    """
    rows = (data.second[..., :, None] * data.first[..., None, :]).reshape(
        *data.weight.shape, 9) * data.weight[..., None]
    # eigenvectors of the 9 x 9 matrix lose half of the digits; the triangular factor does not
    triangle = np.linalg.qr(rows, mode='r') if rows.shape[1] > 9 else rows
    full = np.linalg.svd(triangle, full_matrices=True)[2][:, -1].reshape(-1, 3, 3)
    U, s, Vt = np.linalg.svd(full)
    s[:, 2] = 0
    F: np.ndarray = (U * s[:, None, :]) @ Vt
    unit_F: np.ndarray = F / np.linalg.norm(F, axis=(1, 2), keepdims=True)
    return unit_F


def refine_pairs(data: PairMatches, state: tuple[np.ndarray, ...],
                 model: Callable[[tuple[np.ndarray, ...]], tuple[np.ndarray, np.ndarray]],
                 step: Callable[[tuple[np.ndarray, ...], np.ndarray], tuple[np.ndarray, ...]],
                 iterations: int = 40, tolerance: float = 1e-8,
                 ) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
    """
    Levenberg-Marquardt on every pair independently, all pairs at once.

    Parameters
    ----------
    data : PairMatches
    state : tuple of ndarray
        Parameters, each with a leading axis of pairs.
    model : callable
        state to (F (n, 3, 3), dF (n, 9, p)).
    step : callable
        (state, change (n, p)) to a new state.
    iterations : int
    tolerance : float
        A pair is done when an iteration changes its cost by a smaller share.

    Returns
    -------
    state : tuple of ndarray
    cost : ndarray, shape (n,)
    hessian : ndarray, shape (n, p, p)
        J^T J.

    """
    state = tuple(np.array(s) for s in state)
    F, dF = model(state)
    dF = np.array(dF)
    cost, gradient, matrix = normal_equations(data, F)
    damping = np.full(len(cost), 1e-3)
    floor = data.counts * ROUNDING_PX ** 2
    rows = np.arange(len(cost))
    part = data
    for _ in range(iterations):
        slopes = dF[rows]
        turned = np.swapaxes(slopes, 1, 2)
        A = turned @ matrix[rows] @ slopes
        g = (turned @ gradient[rows, :, None])[..., 0]
        scale = np.einsum('npp->np', A)
        scale = np.maximum(scale, 1e-12 * scale.max(axis=1, keepdims=True) + 1e-300)
        damped = A + (damping[rows, None] * scale)[..., None] * np.eye(A.shape[1])
        change = -np.linalg.solve(damped, g[..., None])[..., 0]
        trial = step(tuple(s[rows] for s in state), change)
        new_F, new_dF = model(trial)
        new = normal_equations(part, new_F)
        better = new[0] < cost[rows]
        gain = cost[rows] - new[0]
        damping[rows] *= np.where(better, 0.1, 10)
        won = rows[better]
        for old, values in zip((*state, dF, gradient, matrix, cost),
                               (*trial, new_dF, new[1], new[2], new[0])):
            old[won] = values[better]
        # a cost that neither falls nor rises is at its minimum
        keep = (~(np.abs(gain) <= tolerance * cost[rows]) & (damping[rows] < 1e6)
                & (cost[rows] > floor[rows]))
        if not keep.all():
            rows, part = rows[keep], part.subset(keep)
        if not len(rows):
            break
    return state, cost, np.swapaxes(dF, 1, 2) @ matrix @ dF


# ---- general motion: F = U diag(cos s, sin s, 0) V^T, seven degrees of freedom

_AXES = cross_matrix(np.eye(3))


def general_model(state: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Matrices (n, 3, 3) of the general form, and their slopes (n, 9, 7)."""
    U, sigma, V = state
    c, s = np.cos(sigma), np.sin(sigma)
    zero = np.zeros_like(c)
    D = np.stack([c, s, zero], axis=-1)[:, None, :]
    Vt = np.swapaxes(V, 1, 2)
    F = (U * D) @ Vt
    left = (U[:, None] @ _AXES * D[:, None]) @ Vt[:, None]
    right = -((U * D)[:, None] @ _AXES) @ Vt[:, None]
    middle = (U * np.stack([-s, c, zero], axis=-1)[:, None, :]) @ Vt
    slopes = np.concatenate([left, right, middle[:, None]], axis=1)
    return F, np.swapaxes(slopes.reshape(len(F), 7, 9), 1, 2)


def general_step(state: tuple[np.ndarray, ...], change: np.ndarray) -> tuple[np.ndarray, ...]:
    """Move the general form by seven small changes (n, 7)."""
    U, sigma, V = state
    return (U @ small_rotation(change[:, :3]), sigma + change[:, 6],
            V @ small_rotation(change[:, 3:6]))


def general_state(F: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameters of rank-2 matrices (n, 3, 3) for the general form."""
    U, s, Vt = np.linalg.svd(F)
    return U, np.arctan2(s[:, 1], s[:, 0]), np.swapaxes(Vt, 1, 2)


def _translation_model(state: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    (frame,) = state
    slopes = cross_matrix(np.swapaxes(frame[:, :, 1:], 1, 2))
    return cross_matrix(frame[:, :, 0]), np.swapaxes(slopes.reshape(len(frame), 2, 9), 1, 2)


def _translation_step(state: tuple[np.ndarray, ...], change: np.ndarray,
                      ) -> tuple[np.ndarray, ...]:
    (frame,) = state
    # turning about the third column moves the first along the second
    turn = np.stack([np.zeros(len(change)), -change[:, 1], change[:, 0]], axis=-1)
    return (frame @ small_rotation(turn),)


def refine_general(data: PairMatches, F: np.ndarray, iterations: int = 40,
                   tolerance: float = 1e-8,
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Refine F (n, 3, 3) of every pair with 7 degrees of freedom: F, cost (n,), hessian, dF."""
    state, cost, hessian = refine_pairs(data, general_state(F), general_model, general_step,
                                        iterations, tolerance)
    F, dF = general_model(state)
    return F, cost, hessian, dF


def refine_translation(data: PairMatches, tolerance: float = 1e-8,
                       ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Estimate F = [e]x of every pair: linear start, then refinement; as `refine_general`."""
    a, b = data.first, data.second
    moment = np.cross(a, b) * data.weight[..., None]
    epipole = np.linalg.svd(moment, full_matrices=True)[2][:, -1]
    state, cost, hessian = refine_pairs(data, (completed_frame(epipole),), _translation_model,
                                        _translation_step, tolerance=tolerance)
    F, dF = _translation_model(state)
    return F, cost, hessian, dF


def describe(data: PairMatches, F: np.ndarray, cost: np.ndarray, dF: np.ndarray,
             ) -> list[FundamentalEstimate]:
    """Turn normalised results of n pairs into estimates in pixels."""
    # row-wise entries: vec(T^T F T) = (T^T kron T^T) vec(F)
    carry = np.kron(data.transform.T, data.transform.T)
    residuals, slope = pair_residuals(data, F, derivative=True)
    moved = pair_influence(residual_slopes(data, F), slope @ dF[:, None])
    estimates = []
    for k, noise_px in enumerate(moved.noise_px(cost)):
        pixels = carry @ F[k].ravel()
        norm = np.linalg.norm(pixels)
        pixels /= norm
        slope = (np.eye(9) - np.outer(pixels, pixels)) @ carry @ dF[k] / norm
        # the noise is an estimate, too: the variance of Student's distribution
        spare = max(data.counts[k] - dF.shape[2], 3)
        variance = noise_px ** 2 * spare / (spare - 2)
        estimates.append(FundamentalEstimate(
            pixels.reshape(3, 3), variance * slope @ moved.covariance[k] @ slope.T,
            residuals[k, data.weight[k] > 0], dF.shape[2], float(noise_px)))
    return estimates


def fundamental(xy_a: ArrayLike, xy_b: ArrayLike, motion: str = 'general',
                ) -> FundamentalEstimate | NoEstimate:
    """
    Fundamental matrix of one pair by maximum likelihood (thesis A.1, A.2).

    Parameters
    ----------
    xy_a, xy_b : array_like, shape (m, 2)
        Matches in pixels.
    motion : {'general', 'translation'}
        For planar motion see `planar_pairs.planar_fundamental`.

    Returns
    -------
    FundamentalEstimate or NoEstimate

    """
    a, b = np.asarray(xy_a, float), np.asarray(xy_b, float)
    needed = {'general': 8, 'translation': 3}[motion]
    if len(a) < needed:
        return NoEstimate('too_few', what=f'fundamental matrix of {motion} motion', needed=needed,
                          items='matches', found=len(a))
    data = PairMatches.from_pixels([(a, b)])
    F, cost, _, dF = (refine_translation(data) if motion == 'translation'
                      else refine_general(data, eight_point(data)))
    return describe(data, F, cost, dF)[0]
