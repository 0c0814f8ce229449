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
What an estimate would leave of a track if it did not rest on it.

A gross error in a short track that alone ties views together pulls their poses until it fits.
Its residuals are no larger than the noise then. What the others predict of it shows the error.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.calibration.bundle.robust_fit import refit, RobustFit
from selfcal_ros.geometry.chain_inverse import carried_blocks
from selfcal_ros.geometry.distributions import chi2_sf

#: What the others predict of a track contradicts it by chance in less than this share, and leaves
#: so much more than the estimate that rests on it, in sigma².
CHANCE, HIDDEN = 1e-6, 20.0
#: In a round those are left out that are at least so near to the worst; the next worst may only
#: seem so beside it. More rounds than these are not made.
BESIDE_WORST, ROUNDS = 0.5, 5
#: Tracks of more views contradict a gross error in one of them by themselves.
MOST_VIEWS = 10
#: What others predict with less than this share of the information on it is not held against it.
LEAST_BY_OTHERS = 1e-3
#: Tracks that are computed at a time, which bounds the memory.
_AT_A_TIME = 512


class DeletedTracks(NamedTuple):
    """
    Sums of squared residuals of tracks, in sigma².

    Attributes
    ----------
    point : ndarray of int, shape (T,)
        Which points; those of long tracks are left out.
    freedom : ndarray of int, shape (T,)
        Degrees of freedom of the squares.
    with_it, without_it : ndarray, shape (T,)
        By the estimate that rests on the track, and by that of all the others.

    """

    point: np.ndarray
    freedom: np.ndarray
    with_it: np.ndarray
    without_it: np.ndarray


def deleted_tracks(fit: RobustFit) -> DeletedTracks:
    """
    Tell what each short track leaves with it and without it, to first order.

    Without a track the squares of its residuals r are rᵀ (I - H)⁻¹ r. H is the covariance of the
    predictions of its observations over that of their noise, once its point is eliminated (R. D.
    Cook and S. Weisberg 1982, Residuals and Influence in Regression, 2.2.1 and 3.6).
    """
    blocks, unknowns, found = fit.bundle.blocks, fit.bundle.unknowns, fit.information
    system = found.system
    m, width = system.jac_rest.shape[1:]
    every, by_view = np.arange(len(unknowns))[unknowns.shared], unknowns.by_view
    # rows of the points' derivatives that are orthonormal in each track
    through = np.einsum('nmk,njk->nmj', system.jac_point, system.inverse_root[blocks.point])
    parts = []
    for length in np.unique(blocks.length[blocks.length <= MOST_VIEWS]):
        members = np.flatnonzero(blocks.length == length)
        for at in range(0, len(members), _AT_A_TIME):
            some = members[at:at + _AT_A_TIME]
            rows = blocks.first[some][:, None] + np.arange(length)
            size = m * int(length)
            places = np.concatenate([np.broadcast_to(every, (*rows.shape, len(every))),
                                     by_view[blocks.view[rows]]], axis=2)
            forms = csr_array((system.jac_rest[rows].ravel(), np.repeat(places, m, axis=1).ravel(),
                               np.arange(0, rows.size * m * width + 1, width)),
                              shape=(rows.size * m, len(unknowns)))
            predicted = carried_blocks(forms, found.covariance, size) / found.factor
            Q = through[rows].reshape(len(some), size, -1)
            left = np.eye(size) - Q @ np.swapaxes(Q, 1, 2)
            r = np.einsum('tij,tj->ti', left, system.residual[rows].reshape(len(some), size))
            share, vectors = np.linalg.eigh(np.eye(size) - left @ predicted @ left)
            along = np.einsum('tij,ti->tj', vectors, r)**2
            freedom = size - np.rint(np.einsum('tij,tij->t', Q, Q)).astype(int)
            parts.append((some, freedom, along.sum(axis=1), np.sum(
                along / np.where(share > LEAST_BY_OTHERS, share, 1.0), axis=1)))
    if not parts:
        return DeletedTracks(*np.zeros((2, 0), int), *np.zeros((2, 0)))
    return DeletedTracks(*(np.concatenate(column) for column in zip(*parts)))


def without_hidden_errors(fit: RobustFit) -> RobustFit:
    """Leave out tracks that seem right only because the estimate rests on them, and fit again."""
    for _ in range(ROUNDS):
        found = deleted_tracks(fit)
        more = found.without_it - found.with_it
        wrong = (more > HIDDEN) & (chi2_sf(found.without_it, found.freedom) < CHANCE)
        if not wrong.any():
            break
        wrong &= more >= BESIDE_WORST * more[wrong].max()
        rest, points = fit.observations.select(
            ~np.isin(fit.observations.point, found.point[wrong]))
        if len(np.unique(rest.view)) < len(fit.state.path):
            break
        state = replace(fit.state, points=fit.state.points[points])
        lost = len(fit.observations.view) - len(rest.view)
        fit = refit(replace(fit, observations=rest, state=state, outliers=fit.outliers + lost),
                    fit.motion)
        fit = replace(fit, bundle=fit.bundle.with_sigma(fit.bundle.noise_rms(fit.state)))
    return fit
