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
"""What an optimum rests on: covariance from the normal equations, influence of observations."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.lapack import dpocon, dpotrf, dpotri
from scipy.sparse import csr_array

from selfcal_ros.geometry.optimise import huber_weights, ReducedSystem

#: Residuals beyond so many sigmas weigh less (95 % efficiency for Gaussian noise).
HUBER_SIGMAS = 2.0
#: Directions with less information than this share of the largest are open: they come out very
#: large, not infinite.
OPEN = 1e-13


@dataclass(frozen=True)
class Evidence:
    """
    What an optimum rests on.

    Attributes
    ----------
    covariance : ndarray, shape (n, n)
        Of the shared and per-view unknowns, for independent noise.
    influence : ndarray, shape (N, 11)
        Share of every observation in the errors of the shared unknowns.
    freedom_share : float
        Degrees of freedom over the number of measured coordinates.
    track_share : float
        The same once the points are accounted for: the influences of a whole track do not
        contain what its point has absorbed.
    system : ReducedSystem, optional
        The normal equations, by which the points follow.

    """

    covariance: np.ndarray
    influence: np.ndarray
    freedom_share: float
    track_share: float
    system: ReducedSystem | None = field(default=None, repr=False)


def inverse_information(matrix: np.ndarray, unknowns: csr_array) -> np.ndarray:
    """
    Invert a normal matrix, directions without information made very large.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    unknowns : csr_array, shape (n, k)
        Of `unknowns_of`.

    Returns
    -------
    ndarray, shape (n, n)
        Zero rows for held parameters.

    """
    E = unknowns
    H = E.T @ (E.T @ matrix).T
    root = np.sqrt(np.maximum(np.diag(H), 1e-300))
    H = H / np.outer(root, root)
    factor, failed = dpotrf(H)
    # the reciprocal condition in the 1-norm bounds that of the eigenvalues from below
    if not failed and dpocon(factor, np.abs(H).sum(axis=0).max())[0] > 10 * OPEN:
        inverse = np.triu(dpotri(factor)[0])
        inverse += np.triu(inverse, 1).T
    else:
        values, vectors = np.linalg.eigh(H)
        inverse = (vectors / np.maximum(values, OPEN * values[-1])) @ vectors.T
    return E @ (E @ (inverse / np.outer(root, root))).T


def huber_factors(distance: np.ndarray, share: float) -> tuple[float, float]:
    """
    Tell what Huber's loss does to the inverse of the weighted normal matrix (Huber 1981, 7.6).

    Parameters
    ----------
    distance : ndarray, shape (N,)
        Lengths of two-dimensional residuals, in sigmas.
    share : float
        Degrees of freedom over the number of coordinates: residuals are smaller than the noise
        by its root.

    Returns
    -------
    factor, pull : float
        Covariance over that inverse; influence over weighted residuals times it.

    """
    psi_square = np.mean(np.minimum(distance, HUBER_SIGMAS)**2) / 2 / share
    # the normal matrix carries the weights, whose mean differs from that of ψ'
    weight = np.mean(huber_weights(distance, HUBER_SIGMAS))
    # beyond the threshold ψ' remains only across the residual's direction
    slope = np.mean(np.where(distance <= HUBER_SIGMAS, 1.0,
                             0.5 * HUBER_SIGMAS / np.maximum(distance, 1e-300)))
    return float(psi_square * weight / slope**2), float(weight / slope)
