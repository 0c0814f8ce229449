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
First-order propagation of image noise to estimates (thesis C.1), match by match.

An estimate that minimises a sum of squares moves with every image coordinate by a known amount,
its influence. Influences add: what shares an observation shares its noise, however many pairs or
triplets of views the observation enters. That is what 2 C / (m - p) H^-1 of each pair by itself
cannot see. It is why the thesis's spreads of v come out too large and those of l too small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from selfcal_ros.geometry.fundamental import PairMatches


@dataclass(frozen=True)
class PairInfluence:
    """
    How the parameters of every image pair move with its matches.

    Attributes
    ----------
    influence : ndarray, shape (n, m, p, 4)
        Change of the p parameters per pixel of (x, y) in the second and (x, y) in the first
        image.
    covariance : ndarray, shape (n, p, p)
        Per pixel^2 of noise.
    expected_cost : ndarray, shape (n,)
        Mean of the cost (A.2) for noise of one pixel: what the fit absorbs is left out.

    """

    influence: np.ndarray
    covariance: np.ndarray
    expected_cost: np.ndarray

    def noise_px(self, cost: np.ndarray) -> np.ndarray:
        """Estimate the standard deviation of an image coordinate from each cost, (n,)."""
        noise: np.ndarray = np.sqrt(cost / np.maximum(self.expected_cost, 1e-12))
        return noise


def residual_slopes(data: PairMatches, F: np.ndarray) -> np.ndarray:
    """
    Derivative of the epipolar distances by the image points, at a minimum.

    There the distances are small, and their numerator alone moves with the points.

    Parameters
    ----------
    data : PairMatches
    F : ndarray, shape (n, 3, 3)
        Normalised coordinates.

    Returns
    -------
    ndarray, shape (n, m, 2, 4)
        Distances in the second and first image by (x, y) in the second and (x, y) in the first,
        pixels; zero for matches without weight.

    """
    line_b = (data.first @ np.swapaxes(F, 1, 2))[..., :2]
    line_a = (data.second @ F)[..., :2]
    move = np.concatenate([line_b, line_a], axis=-1) * data.weight[..., None]
    norms = np.stack([np.linalg.norm(line_b, axis=-1), np.linalg.norm(line_a, axis=-1)], axis=-1)
    slopes: np.ndarray = move[..., None, :] / np.maximum(norms, 1e-300)[..., None]
    return slopes


def pair_influence(by_point: np.ndarray, jacobian: np.ndarray) -> PairInfluence:
    """
    Propagate image noise to the parameters of each pair by itself.

    Parameters
    ----------
    by_point : ndarray, shape (n, m, 2, 4)
        From `residual_slopes`.
    jacobian : ndarray, shape (n, m, 2, p)
        Derivative of the same distances by the parameters.

    Returns
    -------
    PairInfluence

    """
    pairs, _, _, size = jacobian.shape
    J = jacobian.reshape(pairs, -1, size)
    hessian = np.swapaxes(J, 1, 2) @ J
    inverse = np.linalg.pinv(hessian, hermitian=True)
    influence = -np.einsum('nij,nmrj,nmrc->nmic', inverse, jacobian, by_point, optimize=True)
    covariance = np.einsum('nmic,nmjc->nij', influence, influence, optimize=True)
    expected = (by_point ** 2).sum(axis=(1, 2, 3)) - np.einsum('nij,nji->n', hessian, covariance)
    return PairInfluence(influence, covariance, expected)


def add_up(identity: np.ndarray, moved: np.ndarray, count: int) -> np.ndarray:
    """
    Add influences of matches that share observations.

    Parameters
    ----------
    identity : ndarray of int, shape (N,)
        Observation of each row; below `count`, rows with a negative one are left out.
    moved : ndarray, shape (N, 2, k)
        Change of k quantities with x and y.
    count : int

    Returns
    -------
    ndarray, shape (count, 2, k)

    """
    used = identity >= 0
    rows = moved[used].reshape(int(used.sum()), -1)
    total = np.stack([np.bincount(identity[used], column, count) for column in rows.T], axis=1)
    return total.reshape(count, *moved.shape[1:])


def spread(influence: np.ndarray) -> np.ndarray:
    """Covariance (k, k) per pixel^2 of noise of quantities with influences (O, 2, k)."""
    rows = influence.reshape(-1, influence.shape[-1])
    covariance: np.ndarray = rows.T @ rows
    return covariance


def null_influence(rows: np.ndarray, by_point: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Propagate noise to the right null vector of equations, as of a tensor by least squares.

    Parameters
    ----------
    rows : ndarray, shape (m, e, k)
        Equations of every point.
    by_point : ndarray, shape (m, e, c)
        Derivative of rows @ vector by the c noisy coordinates of each point. The vector is the
        null vector, of unit norm.

    Returns
    -------
    influence : ndarray, shape (m, c, k)
    expected_square : float
        Mean of |rows @ vector|^2 for coordinates of unit variance, once the fit has absorbed
        its share.

    """
    size = rows.shape[2]
    U, s, Vt = np.linalg.svd(rows.reshape(-1, size), full_matrices=False)
    U, s, Vt = U[:, :-1], s[:-1], Vt[:-1]
    U = U.reshape(*rows.shape[:2], size - 1)
    through = np.einsum('mej,mec->mcj', U, by_point, optimize=True)
    influence = -(through / np.maximum(s, 1e-300)) @ Vt
    expected = float((by_point ** 2).sum() - (through ** 2).sum())
    return influence, expected
