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
The dual image of the absolute conic from infinite homographies (thesis 3.1.6, 4.1.3).

H = K R K^-1 of a fixed camera gives omega* = H omega* H^T with omega* = K K^T (3.7): six linear
equations a view (4.8). Rotations about one axis leave a family with one parameter, of which a
known fact picks the member (4.9).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import calibration_from_iac

#: The second smallest singular value of the stacked constraints counts as zero, and the
#: solutions as a family, below so many times its noise.
FAMILY_SIGMAS = 4.0
#: Exact homographies still carry rounding, and what an adjustment leaves when it stops.
ROUNDING = 1e-6
_UPPER = np.triu_indices(3)


@dataclass(frozen=True)
class InfiniteHomographies:
    """
    Homographies of the plane at infinity from a reference view to n others.

    Attributes
    ----------
    H : ndarray, shape (n, 3, 3)
        Pixels, determinant 1.
    covariance : ndarray, shape (n / m, 9 m, 9 m)
        Of the row-wise entries, for independent groups of m views each; zero where unknown.

    """

    H: np.ndarray
    covariance: np.ndarray


def unit_determinant(M: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """
    Scale matrices to determinant 1.

    Parameters
    ----------
    M : array_like, shape (..., 3, 3)
        Regular.

    Returns
    -------
    H : ndarray, shape (..., 3, 3)
    slope : ndarray, shape (..., 9, 9)
        Derivative of the row-wise entries of H by those of M.

    """
    M = np.asarray(M, float)
    root = np.cbrt(np.linalg.det(M))[..., None, None]
    # dH = (dM - M tr(M^-1 dM) / 3) / root
    trace = np.swapaxes(np.linalg.inv(M), -1, -2).reshape(*M.shape[:-2], 1, 9)
    flat = M.reshape(*M.shape[:-2], 9, 1)
    return M / root, (np.eye(9) - flat @ trace / 3) / root


def constraint_rows(H: np.ndarray) -> np.ndarray:
    """
    Rows of the linear system A c = 0 of omega* = H omega* H^T (4.8).

    Parameters
    ----------
    H : ndarray, shape (n, 3, 3)
        Determinant 1.

    Returns
    -------
    ndarray, shape (n, 6, 6)
        For c = (w11, w12, w13, w22, w23, w33).

    """
    basis = np.zeros((6, 3, 3))
    for k, (i, j) in enumerate(zip(*_UPPER)):
        basis[k, i, j] = basis[k, j, i] = 1
    change = H[:, None] @ basis @ np.swapaxes(H, 1, 2)[:, None] - basis
    return np.moveaxis(change[:, :, _UPPER[0], _UPPER[1]], 1, 2)


def conic_matrix(c: ArrayLike) -> np.ndarray:
    """Symmetric matrix (3, 3) of its six upper entries (6,)."""
    matrix = np.zeros((3, 3))
    matrix[_UPPER] = c
    return matrix + np.triu(matrix, 1).T


def camera_from_dual_conic(conic: ArrayLike) -> np.ndarray | NoEstimate:
    """
    Calibration matrix of omega* = K K^T by Cholesky's method.

    Parameters
    ----------
    conic : array_like, shape (3, 3)
        Symmetric, any non-zero scale.

    Returns
    -------
    ndarray, shape (3, 3), or NoEstimate

    """
    matrix = np.asarray(conic, float)
    if not np.linalg.cond(matrix) < 1e15:
        return NoEstimate('dual_conic_degenerate')
    return calibration_from_iac(np.linalg.inv(matrix))


def linear_conic(H: np.ndarray, noise: float = 0.0, facts: CameraFacts | None = None,
                 ) -> tuple[list[tuple[str, np.ndarray]], bool]:
    """
    Closed form of omega* from homographies in normalised coordinates (4.8, 4.9).

    Parameters
    ----------
    H : ndarray, shape (n, 3, 3)
        Determinant 1, of image coordinates of the order of one.
    noise : float
        Standard deviation of an entry of H.
    facts : CameraFacts, optional
        In the same coordinates; picks the member where the rotations share one axis.

    Returns
    -------
    list of (str, ndarray (3, 3))
        Candidates, the likeliest first: how it was found, and omega*; may be empty.
    family : bool
        Whether the constraints leave a family of solutions.

    """
    facts = CameraFacts() if facts is None else facts
    A = constraint_rows(H).reshape(-1, 6)
    _, singular, Vt = np.linalg.svd(A)
    # an entry's noise enters a row about 2 |c| times
    spread = 2 * max(noise, ROUNDING) * np.sqrt(len(A))
    family = len(H) == 1 or singular[4] < FAMILY_SIGMAS * spread
    if not family:
        return [('linear', conic_matrix(Vt[5]))], False
    first, second = conic_matrix(Vt[5]), conic_matrix(Vt[4])
    found = []
    if facts.aspect_ratio is not None:
        found += [('aspect ratio', conic)
                  for conic in _members_of_aspect(first, second, facts.aspect_ratio)]
    if facts.skew == 0:
        def skewed(a: np.ndarray, b: np.ndarray) -> float:
            return float(a[0, 1] * b[2, 2] - a[0, 2] * b[1, 2])
        found += _members('zero skew', first, second, skewed)
    if facts.principal_point is not None:
        point = np.array(facts.principal_point)
        a, b = (C[:2, 2] - C[2, 2] * point for C in (first, second))
        # omega*'s last column is (u0, v0, 1): two linear equations, least squares
        share = np.linalg.svd(np.column_stack([a, b]))[2][1]
        found.append(('principal point', share[0] * first + share[1] * second))
    return found, True


def _members_of_aspect(first: np.ndarray, second: np.ndarray, aspect_ratio: float,
                       ) -> list[np.ndarray]:
    """
    Members a first + b second of the family with an aspect ratio, the least skew first.

    With the minor m = w22 w33 - w23² exactly m² = ratio² w33 det omega*, for any skew: a quartic.
    Two of its roots are cameras, in general, and noise may take both away.
    """
    a, b = first[2, 2], second[2, 2]
    if not np.hypot(a, b) > 0:
        return []
    # the end of the family is the member with w33 = 0, which is no camera
    middle = (a * first + b * second) / np.hypot(a, b)
    end = (a * second - b * first) / np.hypot(a, b)
    shares = np.linspace(-2, 2, 5)
    members = middle + shares[:, None, None] * end
    minor = members[:, 1, 1] * members[:, 2, 2] - members[:, 1, 2]**2
    above = minor**2 - aspect_ratio**2 * members[:, 2, 2] * np.linalg.det(members)
    # without a real root, where the quartic is least
    roots = np.unique(np.roots(np.polyfit(shares, above, 4)).real)
    found = [middle + root * end for root in roots]
    skew = [np.abs(w[0, 1] * w[2, 2] - w[0, 2] * w[1, 2])
            / max(abs(w[1, 1] * w[2, 2] - w[1, 2]**2), 1e-300) for w in found]
    return [found[k] for k in np.argsort(skew)]


def _members(name: str, first: np.ndarray, second: np.ndarray,
             form: Callable[[np.ndarray, np.ndarray], float]) -> list[tuple[str, np.ndarray]]:
    """Members a first + b second of the family at which a bilinear form of omega* vanishes."""
    quadratic = [form(second, second), form(first, second) + form(second, first),
                 form(first, first)]
    if not np.abs(quadratic).max() > 0:
        return []
    a, b, c = quadratic
    # without a real root, where the form is least; neither end of the family is lost
    q = -(b + np.copysign(np.sqrt(max(b * b - 4 * a * c, 0.0)), b)) / 2
    shares = [(a, q), (q, c)][::-1 if b >= 0 else 1]
    return [(name, x * first + y * second) for x, y in shares if x or y]
