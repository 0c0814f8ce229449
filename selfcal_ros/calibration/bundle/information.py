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
from scipy.linalg.lapack import dlange, dpocon, dpotrf, dpotri
from scipy.sparse import csr_array
from scipy.special import chdtr, chdtrc

from selfcal_ros.geometry.chain_factor import ChainFactor, largest_eigenvalue, NotPositive
from selfcal_ros.geometry.chain_inverse import ChainInverse
from selfcal_ros.geometry.chain_matrix import ChainMatrix
from selfcal_ros.geometry.levenberg_marquardt import places_of, restricted
from selfcal_ros.geometry.reduced_system import ReducedSystem
from selfcal_ros.geometry.robust_loss import huber_weights

#: Residuals beyond so many sigmas weigh less (95 % efficiency for Gaussian noise).
HUBER_SIGMAS = 2.0
#: Directions with less information than this fraction of the largest count as undetermined:
#: they come out very large, not infinite.
RANK_TOLERANCE = 1e-13
#: Rows of a triangle that are copied to the other at a time.
_MIRRORED = 512


@dataclass(frozen=True)
class Information:
    """
    What an optimum rests on.

    Attributes
    ----------
    covariance : ndarray or ChainInverse, shape (n, n)
        Of what remains once a block is eliminated, for independent noise; see `Unknowns`.
    influence : ndarray, shape (N, g)
        Part of every observation in the errors of the unknowns that all views share.
    freedom_fraction : float
        Degrees of freedom over the number of measured coordinates.
    track_fraction : float
        The same once the points are accounted for: the influences of a whole track do not
        contain what its point has absorbed.
    system : ReducedSystem
        The normal equations, by which the eliminated block follows; without their matrix.
    lens : slice
        Where the unknowns of the lens stand.
    factor : float
        The covariance over the inverse of the normal matrix.

    """

    covariance: np.ndarray | ChainInverse
    influence: np.ndarray
    freedom_fraction: float
    track_fraction: float
    system: ReducedSystem = field(repr=False)
    lens: slice
    factor: float

    @property
    def lens_covariance(self) -> np.ndarray:
        """Covariance of the unknowns of the lens, shape (k, k)."""
        return self.covariance[self.lens, self.lens]

    @property
    def lens_influence(self) -> np.ndarray:
        """Part of every observation in the errors of the lens, shape (N, k)."""
        return self.influence[:, self.lens]


def inverse_information(matrix: np.ndarray | ChainMatrix, selection: csr_array,
                        diagonal: np.ndarray | None = None, overwrite: bool = False,
                        ) -> np.ndarray | ChainInverse:
    """
    Invert a normal matrix, directions without information made very large.

    Parameters
    ----------
    matrix : ndarray or ChainMatrix, shape (n, n)
    selection : csr_array, shape (n, k)
        Of `Unknowns.selection`.
    diagonal : ndarray, shape (n,), optional
        Of the matrix before a block was eliminated: what that leaves of an unknown may be
        nothing but rounding.
    overwrite : bool
        Whether the inverse may take the memory of the matrix, which is lost then: of thousands of
        views it is hundreds of megabytes.

    Returns
    -------
    ndarray or ChainInverse, shape (n, n)
        Zero rows for fixed parameters.

    """
    if isinstance(matrix, ChainMatrix):
        return _inverse_of_chain(matrix, selection, diagonal)
    places = places_of(selection)
    if places is None:
        inverse = _restricted_inverse(matrix, selection, diagonal, overwrite)
        spread: np.ndarray = selection @ (selection @ inverse).T
        return spread
    held = np.ones(len(matrix), bool)
    held[places] = False
    apart = matrix if overwrite else np.array(matrix)
    apart[held], apart[:, held] = 0.0, 0.0
    apart[held, held] = 1.0
    inverse = _inverse(apart, None if diagonal is None else diagonal * ~held)
    inverse[held, held] = 0.0
    return inverse


def eliminated(matrix: np.ndarray | ChainMatrix, selection: csr_array, right: np.ndarray,
               diagonal: np.ndarray | None = None, overwrite: bool = False) -> np.ndarray:
    """
    Multiply columns (n, m) by the inverse of `inverse_information`, which is not written out.

    The other parameters are those of that.

    Returns
    -------
    ndarray, shape (n, m)

    """
    if isinstance(matrix, ChainMatrix):
        product: np.ndarray = _inverse_of_chain(matrix, selection, diagonal) @ right
        return product
    inverse = _restricted_inverse(matrix, selection, diagonal, overwrite)
    solved = inverse @ (selection.T @ right)
    spread: np.ndarray = selection @ solved
    return spread


def _restricted_inverse(matrix: np.ndarray, selection: csr_array, diagonal: np.ndarray | None,
                        overwrite: bool) -> np.ndarray:
    """Invert the matrix of the independent unknowns of a selection (n, k), shape (k, k)."""
    scale = None if diagonal is None else abs(selection).T @ diagonal
    return _inverse(restricted(matrix, selection, overwrite), scale)


def _inverse(H: np.ndarray, diagonal: np.ndarray | None) -> np.ndarray:
    """
    Invert a symmetric matrix in its own place.

    Parameters
    ----------
    H : ndarray, shape (k, k)
        Written over.
    diagonal : ndarray, shape (k,), optional
        See `inverse_information`.

    Returns
    -------
    ndarray, shape (k, k)

    """
    # what nothing measures has a very large variance, of which products are still numbers
    scale = np.maximum(np.diag(H), max(1e-300, 1e-100 * float(np.diag(H).max(initial=0))))
    if diagonal is not None:
        scale = np.maximum(scale, RANK_TOLERANCE * diagonal)
    root = np.sqrt(scale)
    H /= root[:, None]
    H /= root
    # of a symmetric matrix rows are columns, which saves a copy
    norm, own = dlange('1', H.T), np.diag(H).copy()
    factor, failed = dpotrf(H.T, clean=0, overwrite_a=1)
    # the reciprocal condition in the 1-norm bounds that of the eigenvalues from below
    inverse: np.ndarray
    if not failed and dpocon(factor, norm)[0] > 10 * RANK_TOLERANCE:
        inverse = _mirrored(dpotri(factor, overwrite_c=1)[0].T)
    else:
        # the other triangle is still that of the matrix
        H = _mirrored(factor)
        np.fill_diagonal(H, own)
        values, vectors = np.linalg.eigh(H)
        inverse = (vectors / np.maximum(values, RANK_TOLERANCE * values[-1])) @ vectors.T
    inverse /= root[:, None]
    inverse /= root
    return inverse


def _mirrored(matrix: np.ndarray) -> np.ndarray:
    """Copy the triangle below the diagonal to that above, in place."""
    for begin in range(0, len(matrix), _MIRRORED):
        own = slice(begin, begin + _MIRRORED)
        matrix[:begin, own] = matrix[own, :begin].T
        part = matrix[own, own]
        part[:] = np.tril(part) + np.tril(part, -1).T
    return matrix


def _inverse_of_chain(matrix: ChainMatrix, selection: csr_array, diagonal: np.ndarray | None,
                      ) -> ChainInverse:
    """Invert a chain of views, directions without information made very large."""
    scale = np.maximum(matrix.folded_diagonal(selection), 1e-300)
    if diagonal is not None:
        scale = np.maximum(scale, RANK_TOLERANCE * (abs(selection).T @ diagonal))
    root = np.sqrt(scale)
    least = RANK_TOLERANCE * largest_eigenvalue(matrix, selection, root)
    damping = 0.0
    # rounding of a large matrix may be more than the least
    while damping < least / RANK_TOLERANCE:
        try:
            factor = ChainFactor(matrix, selection, root, damping)
            if damping or factor.least_eigenvalue() > least:
                return ChainInverse(factor, selection, root)
        except NotPositive:
            pass
        damping = 10 * damping or least
    raise np.linalg.LinAlgError('The normal matrix is not positive.')


def huber_factors(distance: np.ndarray, fraction: float, dimension: int = 2,
                  ) -> tuple[float, float]:
    """
    Tell what Huber's loss does to the inverse of the weighted normal matrix (Huber 1981, 7.6).

    Parameters
    ----------
    distance : ndarray, shape (N,)
        Lengths of residuals, in sigmas.
    fraction : float
        Degrees of freedom over the number of coordinates: residuals are smaller than the noise
        by its root.
    dimension : int
        m, coordinates of a residual.

    Returns
    -------
    factor, pull : float
        Covariance over that inverse; influence over weighted residuals times it.

    """
    psi_square = np.mean(np.minimum(distance, HUBER_SIGMAS)**2) / dimension / fraction
    # the normal matrix carries the weights, whose mean differs from that of ψ'
    weight = np.mean(huber_weights(distance, HUBER_SIGMAS))
    # beyond the threshold ψ' remains only across the residual's direction
    across = (dimension - 1) / dimension
    slope = np.mean(np.where(distance <= HUBER_SIGMAS, 1.0,
                             across * HUBER_SIGMAS / np.maximum(distance, 1e-300)))
    return float(psi_square * weight / slope**2), float(weight / slope)


def winsorised_square(dimension: int) -> float:
    """E[min(|z|, c)²] of a Gaussian z of m dimensions and unit variance, c = `HUBER_SIGMAS`."""
    square = HUBER_SIGMAS**2
    return float(dimension * chdtr(dimension + 2, square) + square * chdtrc(dimension, square))
