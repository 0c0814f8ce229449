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
Fundamental matrices of planar motion, pair by pair and over all pairs at once (thesis 6.2).

F = cos t [z0]x + sin t (l m^T + m l^T): l the horizon, m the image of the screw axis, z0 a point
of l. In the batch form all pairs share l, and every m passes through the one vanishing point v.
The form survives a common change of coordinates of both images, so that the work is done in
normalised coordinates; only t then differs from half the angle of rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.estimate import NoEstimate
from selfcal_ros.geometry.fundamental import (describe, eight_point, normal_equations,
                                              pair_residuals, PairMatches, refine_general,
                                              refine_pairs, ROUNDING_PX)
from selfcal_ros.geometry.projective import (completed_frame, cross_matrix, line_pair,
                                             small_rotation, unit, unit_covariance)


@dataclass(frozen=True)
class PlanarPairs:
    """
    Horizon and vanishing point from many pairs, in pixels.

    Attributes
    ----------
    horizon, vanishing_point : ndarray, shape (3,)
        l and v, unit norm.
    horizon_covariance, vanishing_point_covariance : ndarray, shape (3, 3)
        Of the unit vectors.
    F : ndarray, shape (n, 3, 3)
        Fundamental matrix of every pair, unit norm.
    screw_axes : ndarray, shape (n, 3)
        Images m of the screw axes, unit norm.
    residuals : ndarray, shape (n, m, 2)
        Signed epipolar distances in pixels; zero beyond the matches of a pair.
    noise_px : float
        Estimated standard deviation of one image coordinate.
    iterations : int

    """

    horizon: np.ndarray
    vanishing_point: np.ndarray
    horizon_covariance: np.ndarray
    vanishing_point_covariance: np.ndarray
    F: np.ndarray
    screw_axes: np.ndarray
    residuals: np.ndarray
    noise_px: float
    iterations: int = 0


def decompose_planar(F):
    """
    Horizon and screw axis of planar fundamental matrices (5.12-5.15).

    Parameters
    ----------
    F : ndarray, shape (n, 3, 3)

    Returns
    -------
    horizon, axis, centre : ndarray, shape (n, 3)
        Unit vectors l, m, and z0 on l.
    angle : ndarray, shape (n,)
        t.
    real : ndarray of bool, shape (n,)
        False where the symmetric part is not a pair of real lines.

    """
    F = np.asarray(F, float)
    values, vectors = np.linalg.eigh(F + np.swapaxes(F, 1, 2))
    # ascending order: the middle value is the one that vanishes for planar motion
    real = (values[:, 0] < 0) & (values[:, 2] > 0)
    low = np.sqrt(np.maximum(-values[:, 0], 0))[:, None] * vectors[:, :, 0]
    high = np.sqrt(np.maximum(values[:, 2], 0))[:, None] * vectors[:, :, 2]
    lines = np.stack([high + low, high - low], axis=1)
    size = np.linalg.norm(lines, axis=2)
    lines = lines / np.where(size > 0, size, 1)[..., None]
    U, _, Vt = np.linalg.svd(F)
    epipoles = np.stack([Vt[:, 2], U[:, :, 2]], axis=2)
    miss = np.abs(lines @ epipoles).sum(axis=2)
    first = miss[:, 0] <= miss[:, 1]
    horizon = np.where(first[:, None], lines[:, 0], lines[:, 1])
    axis = np.where(first[:, None], lines[:, 1], lines[:, 0])
    # the antisymmetric part holds z0; F + F^T = 2 sin t (l m^T + m l^T)
    skew = np.stack([F[:, 2, 1] - F[:, 1, 2], F[:, 0, 2] - F[:, 2, 0],
                     F[:, 1, 0] - F[:, 0, 1]], axis=1) / 2
    skew = skew - (skew * horizon).sum(axis=1, keepdims=True) * horizon
    angle = np.arctan2(size.prod(axis=1) / 4, np.linalg.norm(skew, axis=1))
    return horizon, axis, unit(skew + 1e-300), angle, real


# ---- one pair: state (t, frame (l, z0, l x z0), frame (m, ., .)), six degrees of freedom

def _planar_model(state):
    t, Q, M = state
    c, s = np.cos(t)[:, None, None], np.sin(t)[:, None, None]
    line, centre, third = np.moveaxis(Q, 2, 0)
    axis = M[:, :, 0]
    pair, skew = line_pair(line, axis), cross_matrix(centre)
    slopes = np.stack([c * pair - s * skew,
                       c * cross_matrix(third),
                       -s * line_pair(third, axis),
                       s * line_pair(centre, axis) - c * cross_matrix(line),
                       s * line_pair(line, M[:, :, 1]),
                       s * line_pair(line, M[:, :, 2])], axis=1)
    return c * skew + s * pair, np.swapaxes(slopes.reshape(len(t), 6, 9), 1, 2)


def _planar_step(state, change):
    t, Q, M = state
    turn = np.stack([np.zeros(len(t)), -change[:, 5], change[:, 4]], axis=-1)
    return t + change[:, 0], Q @ small_rotation(change[:, 1:4]), M @ small_rotation(turn)


def _planar_state(F):
    line, axis, centre, angle, real = decompose_planar(F)
    Q = np.stack([line, centre, np.cross(line, centre)], axis=2)
    states = []
    for sign in (1, -1):
        states.append((sign * angle, Q, completed_frame(axis)))
    fits = [np.abs((_planar_model(s)[0] * F).sum(axis=(1, 2))) for s in states]
    # the sign of sin t is what the decomposition leaves open
    t = np.where(fits[0] >= fits[1], angle, -angle)
    return (t, Q, states[0][2]), real


def refine_planar(data: PairMatches, F):
    """Refine F (n, 3, 3) of every pair in planar form: state, cost, hessian (n, 6, 6)."""
    state, _ = _planar_state(F)
    return refine_pairs(data, state, _planar_model, _planar_step)


def planar_fundamental(xy_a, xy_b):
    """
    Fundamental matrix of one pair under planar motion, with 6 degrees of freedom (A.1).

    Parameters
    ----------
    xy_a, xy_b : array_like, shape (m, 2)

    Returns
    -------
    fundamental.FundamentalEstimate or NoEstimate

    """
    if len(xy_a) < 8:
        return NoEstimate('A planar fundamental matrix needs at least 8 matches; there are '
                          f'{len(xy_a)}.', 'too_few')
    data = PairMatches.from_pixels([(xy_a, xy_b)])
    state, cost, hessian = refine_planar(data, refine_general(data, eight_point(data))[0])
    F, dF = _planar_model(state)
    return describe(data, F, cost, hessian, dF)[0]


# ---- all pairs: global frames (l, r, s) and (v, p, q), per pair (t, phi, delta)

def _batch_model(L, V, own):
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


def _turned(frame, change):
    """Move the frame's first column by change (2,) along the other two."""
    return frame @ small_rotation(np.array([0.0, -change[1], change[0]]))


def _arrow(matrix, gradient, common, single):
    """Blocks of the normal equations: A (4, 4), B (n, 4, 3), D (n, 3, 3), and both gradients."""
    turned = np.swapaxes(common, 1, 2)
    MC, MS = matrix @ common, matrix @ single
    own = np.swapaxes(single, 1, 2)
    return ((turned @ MC).sum(axis=0), turned @ MS, own @ MS,
            (turned @ gradient[..., None])[..., 0].sum(axis=0),
            (own @ gradient[..., None])[..., 0])


def batch_start(state):
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
    L, V = completed_frame(line), completed_frame(v)
    same = np.sign((lines * line).sum(axis=1))
    phi = np.arctan2(*((axes * same[:, None]) @ V[:, [2, 1]]).T)
    delta = np.arctan2(*(Q[:, :, 1] @ L[:, [2, 1]]).T)
    return L, V, np.column_stack([t, phi, delta])


def refine_batch(data: PairMatches, L, V, own, iterations: int = 60):
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


def _damped(M, damping):
    diagonal = np.einsum('...ii->...i', M)
    least = 1e-12 * diagonal.max(axis=-1, keepdims=True) + 1e-300
    return M + (damping * np.maximum(diagonal, least))[..., None] * np.eye(M.shape[-1])


def _solve_arrow(A, B, D, a, d, damping):
    D = _damped(D, damping + 1e-14)
    right = np.linalg.solve(D, np.concatenate([np.swapaxes(B, 1, 2), d[..., None]], axis=2))
    S = _damped(A, damping) - (B @ right[:, :, :4]).sum(axis=0)
    step = -np.linalg.solve(S, a - (B @ right[:, :, 4:])[..., 0].sum(axis=0))
    return step, -right[:, :, 4] - right[:, :, :4] @ step


def _image_influence(data: PairMatches, F, common, single):
    """
    First-order change of (l, v) with the image coordinates of every match.

    Returns
    -------
    influence : ndarray, shape (n, m, 4, 4)
        Globals by (x_b, y_b, x_a, y_a) in pixels.
    share : float
        Expected cost for noise of one pixel.

    """
    residuals, slope = pair_residuals(data, F, derivative=True)
    matrix = np.einsum('nmri,nmrj->nij', slope, slope, optimize=True)
    A, B, D, _, _ = _arrow(matrix, np.zeros((len(F), 9)), common, single)
    D = _damped(D, 1e-14)
    back = np.swapaxes(np.linalg.solve(D, np.swapaxes(B, 1, 2)), 1, 2)
    S = A - (B @ np.swapaxes(back, 1, 2)).sum(axis=0)
    # gradient of the globals with the pairs' own parameters eliminated
    reduced = np.swapaxes(common, 1, 2) - back @ np.swapaxes(single, 1, 2)
    # where v is open along m the pseudo-inverse leaves that direction out
    by_residual = np.linalg.pinv(S, rcond=1e-13, hermitian=True) @ np.einsum(
        'ngi,nmri->gnmr', reduced, slope, optimize=True).reshape(4, -1)
    by_residual = by_residual.reshape(4, *residuals.shape)
    line_b = data.first @ np.swapaxes(F, 1, 2)
    line_a = data.second @ F
    norm_b = np.linalg.norm(line_b[..., :2], axis=-1)
    norm_a = np.linalg.norm(line_a[..., :2], axis=-1)
    # at the minimum the residual is small: its numerator alone moves with the points
    move = np.concatenate([line_b[..., :2], line_a[..., :2]], axis=-1)
    by_point = np.stack([move / norm_b[..., None], move / norm_a[..., None]], axis=-2)
    by_point *= data.weight[..., None, None]
    influence = np.einsum('gnmr,nmrc->nmgc', by_residual, by_point, optimize=True)
    return influence, float((by_point ** 2).sum())


def batch_covariance(data: PairMatches, L, V, own, observation=None):
    """
    Covariance of the common parameters per pixel^2 of image noise, and the expected cost.

    First-order propagation from the image points (C.1): two pairs that share a view share that
    view's noise, which 2 C / (m - p) H^-1 neglects.

    Parameters
    ----------
    observation : ndarray of int, shape (n, m, 2), optional
        Identity of the observations in the second and in the first image; -1 for padding.
        Without it the matches count as independent.

    Returns
    -------
    covariance : ndarray, shape (4, 4)
    share : float

    """
    F, common, single = _batch_model(L, V, own)
    influence, share = _image_influence(data, F, common, single)
    moved = np.stack([influence[..., :2], influence[..., 2:]], axis=2)
    used = data.weight > 0
    rows = moved[used].reshape(-1, 8)
    if observation is not None:
        identity = observation[used].ravel()
        rows = np.column_stack([np.bincount(identity, weights=column) for column in rows.T])
    rows = rows.reshape(-1, 4, 2)
    return np.einsum('kgc,khc->gh', rows, rows, optimize=True), share


def hessian_covariance(data: PairMatches, L, V, own, cost):
    """Covariance 2 C / (m - p) H^-1 of the common parameters (thesis C.1), shape (4, 4)."""
    F, common, single = _batch_model(L, V, own)
    _, gradient, matrix = normal_equations(data, F)
    A, B, D, _, _ = _arrow(matrix, gradient, common, single)
    S = A - (B @ np.linalg.solve(_damped(D, 1e-14), np.swapaxes(B, 1, 2))).sum(axis=0)
    spare = max(data.counts.sum() - 4 - 3 * len(F), 1)
    return cost.sum() / spare * np.linalg.pinv(S, hermitian=True)


def result_in_pixels(data: PairMatches, L, V, own, cost, covariance, share,
                     iterations: int = 0) -> PlanarPairs:
    """Carry the batch result to pixels; covariance (4, 4) and share are per pixel^2 of noise."""
    F = _batch_model(L, V, own)[0]
    spare = 1 - (4 + 3 * len(F)) / max(data.counts.sum(), 1)
    noise = np.sqrt(cost.sum() / share / max(spare, 1e-3))
    T = data.transform
    line, line_cov = unit_covariance(T.T @ L[:, 0], T.T @ L[:, 1:] @ covariance[:2, :2]
                                     @ L[:, 1:].T @ T * noise ** 2)
    back = np.linalg.inv(T)
    point, point_cov = unit_covariance(back @ V[:, 0], back @ V[:, 1:] @ covariance[2:, 2:]
                                       @ V[:, 1:].T @ back.T * noise ** 2)
    axes = np.cos(own[:, 1:2]) * V[:, 1] + np.sin(own[:, 1:2]) * V[:, 2]
    return PlanarPairs(line, point, line_cov, point_cov, data.pixels_F(F), unit(axes @ T),
                       pair_residuals(data, F), float(noise), iterations)
