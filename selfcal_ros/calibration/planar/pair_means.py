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
What image pairs say by themselves, and together: l, m and v (6.4, 6.5, C.5).

At a pixel of noise a pair alone may settle in a wrong minimum; its neighbours show it the way.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry import planar_batch, planar_pairs
from selfcal_ros.geometry.fundamental import PairMatches, refine_general
from selfcal_ros.geometry.planar_pairs import PairLines
from selfcal_ros.geometry.projective import completed_frame, weighted_mean
from selfcal_ros.geometry.two_view_tests import FLOOR_PX


#: The pairs together and each by itself agree if their costs differ by no more than this factor.
AGREEMENT = 1.1


def best_batch(data: PairMatches, state: tuple[np.ndarray, ...], planar_cost: np.ndarray,
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """
    Refine the batch form; from a second start where the first ends far above the pairs' own.

    Returns
    -------
    tuple
        As of `planar_batch.refine_batch`.

    """
    found = planar_batch.refine_batch(data, *planar_batch.batch_start(state))
    if found[3].sum() > AGREEMENT * planar_cost.sum():
        lines = planar_pairs.pair_lines(data, state, planar_cost)
        of_lines, of_axes = line_covariances(lines)
        line, _ = mean_line(lines.horizons, of_lines, lines.horizon_influence)
        point, _ = common_point(lines.axes, of_axes, lines.axis_influence)
        other = planar_batch.refine_batch(data, *planar_batch.start_from(state, line, point))
        if other[3].sum() < found[3].sum():
            found = other
    return found


def agreed_pairs(data: PairMatches, F: np.ndarray, cost: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
    """
    Refine pairs in planar form, and those anew that fit worse than all pairs together do.

    Parameters
    ----------
    data : PairMatches
    F : ndarray, shape (n, 3, 3)
        General fundamental matrices, refined.
    cost : ndarray, shape (n,)
        Their cost.

    Returns
    -------
    F, cost : ndarray
        General form; never worse than the planar one.
    state : tuple of ndarray
        Planar form, see `planar_pairs.refine_planar`.
    planar_cost : ndarray, shape (n,)

    """
    state, planar_cost, _ = planar_pairs.refine_planar(data, F)
    L, V, own, batch_cost, _ = best_batch(data, state, planar_cost)
    # a pair by itself has more freedom, and must not fit worse
    worse = np.flatnonzero(batch_cost < planar_cost * (1 - 1e-6))
    if len(worse):
        again, less, _ = planar_pairs.refine_planar(
            data.subset(worse), planar_batch.fundamental_matrices(L, V, own)[worse])
        better = less < planar_cost[worse]
        state = tuple(np.array(s) for s in state)
        for old, new in zip((*state, planar_cost), (*again, less)):
            old[worse[better]] = new[better]
    worse = np.flatnonzero(planar_cost < cost * (1 - 1e-6))
    if len(worse):
        general, less, _, _ = refine_general(
            data.subset(worse), planar_pairs.fundamental_matrices(state)[worse])
        F, cost = np.array(F), np.array(cost)
        F[worse], cost[worse] = general, less
    return F, cost, state, planar_cost


def line_covariances(lines: PairLines) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (n, 3, 3) of horizons and axes; never zero, so that they can weigh."""
    factor = (np.maximum(lines.noise_px, FLOOR_PX)
              / np.maximum(lines.noise_px, 1e-300))[:, None, None] ** 2
    return tuple(factor * covariance for covariance in lines.covariances)


def mean_line(vectors: np.ndarray, covariances: np.ndarray, influences: np.ndarray,
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Covariance-weighted mean of lines that should be equal, and how it moves with the matches.

    Parameters
    ----------
    vectors : ndarray, shape (n, 3)
        Unit norm, any sign.
    covariances : ndarray, shape (n, 3, 3)
    influences : ndarray, shape (n, m, 3, 4)

    Returns
    -------
    mean : ndarray, shape (3,)
    influence : ndarray, shape (n, m, 3, 4)
        Their sum over what each observation enters is the change of the mean.

    """
    mean, _ = weighted_mean(vectors, covariances)
    frame = completed_frame(mean)
    across = frame[:, 1:]
    information = np.linalg.pinv(across.T @ covariances @ across, hermitian=True)
    weight = np.linalg.pinv(information.sum(axis=0), hermitian=True) @ information
    signed = np.sign(vectors @ mean)[:, None, None] * (across @ weight @ across.T)
    return mean, signed[:, None] @ influences


def common_point(axes: np.ndarray, covariances: np.ndarray, influences: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray]:
    """
    Point v that minimises sum (m v)^2 / variance over lines m (C.5), and how it moves.

    Parameters and results as of `mean_line`.
    """
    v = np.linalg.svd(axes)[2][-1]
    for _ in range(5):
        weight = 1 / np.maximum(np.einsum('i,nij,j->n', v, covariances, v), 1e-300)
        v = np.linalg.svd(axes * np.sqrt(weight / weight.max())[:, None])[2][-1]
    normal = (axes * weight[:, None]).T @ axes
    # v itself is the direction that the equations leave out
    inverse = np.linalg.pinv(normal - np.outer(v, v) * (v @ normal @ v), rcond=1e-13,
                             hermitian=True)
    moved = np.einsum('i,nmic->nmc', v, influences)
    return v, -np.einsum('in,nmc->nmic', inverse @ (axes * weight[:, None]).T, moved)


def mean_screw_axis(lines: PairLines) -> tuple[np.ndarray, np.ndarray, float]:
    """
    Mean screw axis, and how far the pairs' own ones deviate from it.

    Returns
    -------
    mean : ndarray, shape (3,)
        Normalised coordinates.
    influence : ndarray, shape (n, m, 3, 4)
        As of `mean_line`.
    chi2 : float
        Mean squared deviation in sigmas per degree of freedom; near 1 for circular motion.

    """
    _, covariances = line_covariances(lines)
    mean, influence = mean_line(lines.axes, covariances, lines.axis_influence)
    frame = completed_frame(mean)
    flat = lines.axes @ frame
    offset = flat[:, 1:] / flat[:, :1]
    tangent = frame[:, 1:].T @ covariances @ frame[:, 1:]
    chi2 = np.einsum('ni,nij,nj->', offset, np.linalg.pinv(tangent, hermitian=True), offset)
    return mean, influence, float(chi2 / max(2 * len(offset) - 2, 1))
