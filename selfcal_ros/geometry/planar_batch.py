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
The batch form of planar fundamental matrices: one horizon, one vanishing point (thesis 6.2.2).

Every pair has F = cos t [z0]x + sin t (l m^T + m l^T) with the same l, and an m through the same
v. Parameters: the frames (l, r, s) and (v, p, q), and (t, phi, delta) of each pair.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.fundamental import (normal_equations, pair_residuals, PairMatches,
                                              ROUNDING_PX)
from selfcal_ros.geometry.planar_pairs import PlanarPairs
from selfcal_ros.geometry.projective import (completed_frame, cross_matrix, line_pair,
                                             small_rotation, unit, unit_slope)
from selfcal_ros.geometry.propagation import add_up, residual_slopes, spread


def _batch_model(L: np.ndarray, V: np.ndarray, own: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F (n, 3, 3), its derivative by the globals (n, 9, 4) and by its own three (n, 9, 3)."""
    t, phi, delta = own.T
    ct, st = np.cos(t)[:, None, None], np.sin(t)[:, None, None]
    cp, sp, cd, sd = (f(x)[:, None] for x in (phi, delta) for f in (np.cos, np.sin))
    line, r, s = L.T
    v, p, q = V.T
    axis, axis_turned = cp * p + sp * q, cp * q - sp * p
    centre, centre_turned = cd * r + sd * s, cd * s - sd * r
    pair, skew = line_pair(line, axis), cross_matrix(centre)
    n = len(t)
    common = np.stack([st * line_pair(r, axis) - ct * cross_matrix(cd * line),
                       st * line_pair(s, axis) - ct * cross_matrix(sd * line),
                       -st * line_pair(line, cp * v), -st * line_pair(line, sp * v)], axis=1)
    single = np.stack([ct * pair - st * skew, st * line_pair(line, axis_turned),
                       ct * cross_matrix(centre_turned)], axis=1)
    return (ct * skew + st * pair, np.swapaxes(common.reshape(n, 4, 9), 1, 2),
            np.swapaxes(single.reshape(n, 3, 9), 1, 2))


def fundamental_matrices(L: np.ndarray, V: np.ndarray, own: np.ndarray) -> np.ndarray:
    """F (n, 3, 3) of every pair, normalised coordinates."""
    return _batch_model(L, V, own)[0]


def _turned(frame: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Move the frame's first column by change (2,) along the other two."""
    turned: np.ndarray = frame @ small_rotation(np.array([0.0, -change[1], change[0]]))
    return turned


def _arrow(matrix: np.ndarray, gradient: np.ndarray, common: np.ndarray, single: np.ndarray,
           ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of the normal equations: A (4, 4), B (n, 4, 3), D (n, 3, 3), and both gradients."""
    turned = np.swapaxes(common, 1, 2)
    MC, MS = matrix @ common, matrix @ single
    own = np.swapaxes(single, 1, 2)
    return ((turned @ MC).sum(axis=0), turned @ MS, own @ MS,
            (turned @ gradient[..., None])[..., 0].sum(axis=0),
            (own @ gradient[..., None])[..., 0])


def batch_start(state: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Common l and v of pairs that were refined separately, and the parameters of each.

    The medoid of the horizons is taken, and the v that minimises sum (m v)^2 with weights that
    fade out the lines that miss it (C.5).
    """
    t, Q, M = state
    lines, axes = Q[:, :, 0], M[:, :, 0]
    closeness = np.abs(lines @ lines.T)
    line = lines[np.argmax(np.median(closeness, axis=1))]
    weight = np.sin(t) ** 2 + 1e-12
    for _ in range(5):
        v = np.linalg.svd(axes * np.sqrt(weight)[:, None])[2][-1]
        miss = np.abs(axes @ v)
        weight = 1 / (miss ** 2 + np.median(miss) ** 2 + 1e-12)
    return start_from(state, line, v)


def start_from(state: tuple[np.ndarray, ...], line: np.ndarray, v: np.ndarray,
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameters of the batch form with given l and v (3,), from pairs refined separately."""
    t, Q, M = state
    L, V = completed_frame(line), completed_frame(v)
    same = np.where(Q[:, :, 0] @ line < 0, -1.0, 1.0)[:, None]
    # turning l over turns m and z0 with it
    phi = np.arctan2(*((M[:, :, 0] * same) @ V[:, [2, 1]]).T)
    delta = np.arctan2(*(Q[:, :, 1] @ L[:, [2, 1]]).T)
    return L, V, np.column_stack([t, phi, delta])


def refine_batch(data: PairMatches, L: np.ndarray, V: np.ndarray, own: np.ndarray,
                 iterations: int = 60,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """
    Minimise (A.2) summed over all pairs by Levenberg-Marquardt (6.6).

    The normal matrix is an arrow - four common parameters, three of each pair - and is solved
    in time linear in the number of pairs.

    Returns
    -------
    L, V : ndarray, shape (3, 3)
    own : ndarray, shape (n, 3)
    cost : ndarray, shape (n,)
    iterations : int

    """
    F, common, single = _batch_model(L, V, own)
    cost, gradient, matrix = normal_equations(data, F)
    damping, floor = 1e-3, data.counts.sum() * ROUNDING_PX ** 2
    count = 0
    for count in range(1, iterations + 1):
        A, B, D, a, d = _arrow(matrix, gradient, common, single)
        accepted = False
        while damping < 1e9 and not accepted:
            step, own_step = _solve_arrow(A, B, D, a, d, damping)
            trial = _turned(L, step[:2]), _turned(V, step[2:]), own + own_step
            model = _batch_model(*trial)
            new = normal_equations(data, model[0])
            accepted = new[0].sum() < cost.sum()
            damping *= 0.1 if accepted else 10
        if not accepted:
            break
        gain = cost.sum() - new[0].sum()
        (L, V, own), (F, common, single), (cost, gradient, matrix) = trial, model, new
        if gain < 1e-8 * cost.sum() or cost.sum() < floor:
            break
    return L, V, own, cost, count


def _damped(M: np.ndarray, damping: float) -> np.ndarray:
    diagonal = np.einsum('...ii->...i', M)
    least = 1e-12 * diagonal.max(axis=-1, keepdims=True) + 1e-300
    damped: np.ndarray = (
        M + (damping * np.maximum(diagonal, least))[..., None] * np.eye(M.shape[-1]))
    return damped


def _solve_arrow(A: np.ndarray, B: np.ndarray, D: np.ndarray, a: np.ndarray, d: np.ndarray,
                 damping: float) -> tuple[np.ndarray, np.ndarray]:
    D = _damped(D, damping + 1e-14)
    right = np.linalg.solve(D, np.concatenate([np.swapaxes(B, 1, 2), d[..., None]], axis=2))
    S = _damped(A, damping) - (B @ right[:, :, :4]).sum(axis=0)
    step = -np.linalg.solve(S, a - (B @ right[:, :, 4:])[..., 0].sum(axis=0))
    return step, -right[:, :, 4] - right[:, :, :4] @ step


def batch_influence(data: PairMatches, L: np.ndarray, V: np.ndarray, own: np.ndarray,
                    observation: np.ndarray | None = None, count: int | None = None,
                    ) -> tuple[np.ndarray, float]:
    """
    First-order change of the common parameters with every image coordinate.

    Two pairs that share a view share that view's noise, which 2 C / (m - p) H^-1 neglects.

    Parameters
    ----------
    observation : ndarray of int, shape (n, m, 2), optional
        Identity of the observations in the second and in the first image; -1 for padding.
        Without it the matches count as independent.
    count : int, optional
        Number of identities.

    Returns
    -------
    influence : ndarray, shape (count, 2, 4)
        Of l along the last two columns of its frame, and of v; per pixel.
    expected : float
        Mean of the cost for noise of one pixel, less what the fit absorbs.

    """
    F, common, single = _batch_model(L, V, own)
    slope = pair_residuals(data, F, derivative=True)[1]
    by_point = residual_slopes(data, F)
    matrix = np.einsum('nmri,nmrj->nij', slope, slope, optimize=True)
    A, B, D, _, _ = _arrow(matrix, np.zeros((len(F), 9)), common, single)
    D = _damped(D, 1e-14)
    back = np.swapaxes(np.linalg.solve(D, np.swapaxes(B, 1, 2)), 1, 2)
    S = A - (B @ np.swapaxes(back, 1, 2)).sum(axis=0)
    # gradient of the globals with the pairs' own parameters eliminated
    reduced = np.swapaxes(common, 1, 2) - back @ np.swapaxes(single, 1, 2)
    # where v is open along m the pseudo-inverse leaves that direction out
    rows = np.linalg.pinv(S, rcond=1e-13, hermitian=True) @ reduced
    by_match = np.einsum('nmri,nmrc->nmic', slope, by_point, optimize=True)
    moved = -(rows[:, None] @ by_match)
    moved = np.stack([moved[..., :2], moved[..., 2:]], axis=2).swapaxes(3, 4)
    if observation is None:
        observation = np.where(data.weight[..., None] > 0,
                               np.arange(2 * data.weight.size).reshape(*data.weight.shape, 2), -1)
    used = np.where(data.weight[..., None] > 0, observation, -1).ravel()
    influence = add_up(used, moved.reshape(-1, 2, 4),
                       int(used.max()) + 1 if count is None else count)
    own_moved = np.swapaxes(single, 1, 2)[:, None] @ by_match
    absorbed = np.trace(S @ spread(influence)) + np.einsum(
        'nij,nmjc,nmic->', np.linalg.inv(D), own_moved, own_moved, optimize=True)
    return influence, float((by_point ** 2).sum() - absorbed)


def common_frames(data: PairMatches, L: np.ndarray, V: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Tell l and v (3,) in pixels, of unit norm, and their derivatives (3, 2) by the globals."""
    line, line_slope = unit_slope(data.transform.T, L[:, 0])
    point, point_slope = unit_slope(np.linalg.inv(data.transform), V[:, 0])
    return line, line_slope @ L[:, 1:], point, point_slope @ V[:, 1:]


def result_in_pixels(data: PairMatches, L: np.ndarray, V: np.ndarray, own: np.ndarray,
                     cost: np.ndarray, covariance: np.ndarray, expected: float,
                     iterations: int = 0) -> PlanarPairs:
    """Carry the batch result to pixels; covariance (4, 4), expected cost as for one pixel."""
    F = _batch_model(L, V, own)[0]
    noise = np.sqrt(cost.sum() / max(expected, 1e-12))
    line, line_slope, point, point_slope = common_frames(data, L, V)
    covariance = covariance * noise ** 2
    axes = np.cos(own[:, 1:2]) * V[:, 1] + np.sin(own[:, 1:2]) * V[:, 2]
    return PlanarPairs(line, point, line_slope @ covariance[:2, :2] @ line_slope.T,
                       point_slope @ covariance[2:, 2:] @ point_slope.T, data.pixels_F(F),
                       unit(axes @ data.transform), pair_residuals(data, F), float(noise),
                       iterations)
