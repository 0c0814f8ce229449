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
Fundamental matrices of planar motion, pair by pair (thesis 6.2.1); see also `planar_batch`.

F = cos t [z0]x + sin t (l m^T + m l^T): l the horizon, m the image of the screw axis, z0 a point
of l. The form survives a common change of coordinates of both images, so that the work is done in
normalised coordinates; only t then differs from half the angle of rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.fundamental import (describe, eight_point, FundamentalEstimate,
                                              pair_residuals, PairMatches, refine_general,
                                              refine_pairs)
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import (completed_frame, cross_matrix, line_pair,
                                             small_rotation, unit)
from selfcal_ros.geometry.propagation import pair_influence, residual_slopes


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


def decompose_planar(F: ArrayLike,
                     ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
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

def _planar_model(state: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
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


def _planar_step(state: tuple[np.ndarray, ...], change: np.ndarray) -> tuple[np.ndarray, ...]:
    t, Q, M = state
    turn = np.stack([np.zeros(len(t)), -change[:, 5], change[:, 4]], axis=-1)
    return t + change[:, 0], Q @ small_rotation(change[:, 1:4]), M @ small_rotation(turn)


def _planar_state(F: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    line, axis, centre, angle, real = decompose_planar(F)
    Q = np.stack([line, centre, np.cross(line, centre)], axis=2)
    states = []
    for sign in (1, -1):
        states.append((sign * angle, Q, completed_frame(axis)))
    fits = [np.abs((_planar_model(s)[0] * F).sum(axis=(1, 2))) for s in states]
    # the sign of sin t is what the decomposition leaves open
    t = np.where(fits[0] >= fits[1], angle, -angle)
    return (t, Q, states[0][2]), real


def fundamental_matrices(state: tuple[np.ndarray, ...]) -> np.ndarray:
    """F (n, 3, 3) of every pair, normalised coordinates."""
    return _planar_model(state)[0]


def refine_planar(data: PairMatches, F: np.ndarray,
                  ) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
    """Refine F (n, 3, 3) of every pair in planar form: state, cost, hessian (n, 6, 6)."""
    state, _ = _planar_state(F)
    return refine_pairs(data, state, _planar_model, _planar_step)


def planar_fundamental(xy_a: ArrayLike, xy_b: ArrayLike) -> FundamentalEstimate | NoEstimate:
    """
    Fundamental matrix of one pair under planar motion, with 6 degrees of freedom (A.1).

    Parameters
    ----------
    xy_a, xy_b : array_like, shape (m, 2)

    Returns
    -------
    fundamental.FundamentalEstimate or NoEstimate

    """
    a, b = np.asarray(xy_a, float), np.asarray(xy_b, float)
    if len(a) < 8:
        return NoEstimate('too_few', what='planar fundamental matrix', needed=8, items='matches',
                          found=len(a))
    data = PairMatches.from_pixels([(a, b)])
    state, cost, _ = refine_planar(data, refine_general(data, eight_point(data))[0])
    F, dF = _planar_model(state)
    return describe(data, F, cost, dF)[0]


@dataclass(frozen=True)
class PairLines:
    """
    Horizon and screw axis of every pair by itself, in normalised coordinates.

    Attributes
    ----------
    horizons, axes : ndarray, shape (n, 3)
        l and m, unit norm.
    horizon_influence, axis_influence : ndarray, shape (n, m, 3, 4)
        Change per pixel of (x, y) in the second and (x, y) in the first image.
    noise_px : ndarray, shape (n,)
        Standard deviation of an image coordinate, estimated from each pair.

    """

    horizons: np.ndarray
    axes: np.ndarray
    horizon_influence: np.ndarray
    axis_influence: np.ndarray
    noise_px: np.ndarray

    @property
    def covariances(self) -> tuple[np.ndarray, np.ndarray]:
        """Covariances (n, 3, 3) of horizons and axes."""
        return tuple(np.einsum('n,nmic,nmjc->nij', self.noise_px ** 2, moved, moved,
                               optimize=True)
                     for moved in (self.horizon_influence, self.axis_influence))


def pair_lines(data: PairMatches, state: tuple[np.ndarray, ...], cost: np.ndarray) -> PairLines:
    """Tell l and m of refined pairs (`refine_planar`), and how they move with the matches."""
    _, Q, M = state
    F, dF = _planar_model(state)
    slope = pair_residuals(data, F, derivative=True)[1]
    moved = pair_influence(residual_slopes(data, F), slope @ dF[:, None])
    line_slope = np.stack([-Q[:, :, 2], Q[:, :, 1]], axis=2)
    lines, axes = (frame[:, None] @ moved.influence[:, :, rows]
                   for frame, rows in ((line_slope, slice(2, 4)), (M[:, :, 1:], slice(4, 6))))
    return PairLines(Q[:, :, 0], M[:, :, 0], lines, axes, moved.noise_px(cost))
