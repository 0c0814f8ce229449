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
Inverses and eigenvalues of symmetric matrices whose unknowns differ in unit.

Pixels, radians and coefficients stand side by side in an information or a covariance. Divided by
the roots of its diagonal the matrix has ones there. Then tolerances mean the same for all of them.
Of all diagonal scalings that is nearly the one of least condition (van der Sluis 1969).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf

#: Least root of a diagonal: absolute, and over the largest. Nothing is divided by zero, and
#: products of what nothing measures are still numbers.
LEAST_SCALE, LEAST_SHARE = 1e-150, 1e-50


def unit_diagonal(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Scale a symmetric matrix to ones on its diagonal.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Symmetric, not negative.

    Returns
    -------
    scaled : ndarray, shape (n, n)
        matrix[i, j] / (scale[i] scale[j]). Zero rows stay zero.
    scale : ndarray, shape (n,)
        Roots of the diagonal; very small, but not zero, where that is zero.

    """
    root = np.sqrt(np.maximum(np.diagonal(matrix), 0))
    scale = np.maximum(root, max(LEAST_SCALE, LEAST_SHARE * float(root.max(initial=0))))
    return matrix / np.outer(scale, scale), scale


def scaled_inverse(matrix: np.ndarray) -> np.ndarray:
    """
    Invert a positive matrix (n, n) by way of ones on its diagonal.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where it is singular.

    """
    scaled, scale = unit_diagonal(matrix)
    inverse: np.ndarray = np.linalg.inv(scaled) / np.outer(scale, scale)
    return inverse


def scaled_pseudo_inverse(matrix: np.ndarray, tolerance: float = 1e-15) -> np.ndarray:
    """
    Invert a matrix that may be singular by way of ones on its diagonal.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Symmetric, not negative.
    tolerance : float
        Directions whose scaled eigenvalue is less than this share of the largest come out as zero.

    Returns
    -------
    ndarray, shape (n, n)

    """
    scaled, scale = unit_diagonal(matrix)
    inverse: np.ndarray = np.linalg.pinv(scaled, tolerance, hermitian=True) / np.outer(scale,
                                                                                       scale)
    return inverse


def squared_distance(deviation: np.ndarray, covariance: np.ndarray,
                     tolerance: float = 1e-12) -> float:
    """
    Measure a deviation d by its covariance C: dᵀ C⁻¹ d, which is never negative.

    Parameters
    ----------
    deviation : ndarray, shape (n,)
    covariance : ndarray, shape (n, n)
        It may be singular, and negative by rounding.
    tolerance : float
        Directions whose scaled eigenvalue is no more than this share of the largest tell nothing.

    Returns
    -------
    float

    """
    scaled, scale = unit_diagonal(covariance)
    values, vectors = np.linalg.eigh(scaled)
    told = values > tolerance * values[-1]
    along = vectors[:, told].T @ (deviation / scale)
    return float(np.sum(along**2 / values[told]))


def is_regular(matrix: np.ndarray, tolerance: float) -> bool:
    """
    Whether all eigenvalues of a symmetric matrix (n, n) with ones on its diagonal are larger.

    Less the tolerance it is positive then, and has a Cholesky factor.
    """
    scaled = unit_diagonal(matrix)[0]
    scaled[np.diag_indices(len(scaled))] -= tolerance
    _, failed = dpotrf(scaled)
    return not failed
