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
Covariance of the camera that the pencil of conics gives (thesis 6.4, where it was left open).

omega(mu) = C + mu l l^T moves with the fixed points and with mu, and mu with the fixed points and
the facts. K moves with omega by the derivative of Cholesky's factor. All of it in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from selfcal_ros.calibration.result import FixedPoints
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import calibration_from_iac, cross_matrix

#: Spread given to an exact fact when it must be weighed against another: aspect ratio, skew
#: and principal point, the last two in focal lengths.
EXACT_SIGMAS = {'aspect_ratio': 1e-3, 'skew': 1e-3, 'principal_point': 1e-3}

#: Row and column in K of fx, fy, cx, cy, skew.
K_ENTRIES = np.array([(0, 0), (1, 1), (0, 2), (1, 2), (0, 1)]).T


@dataclass(frozen=True)
class Pencil:
    """
    The pencil of conics omega(mu) = C + mu l l^T (5.3), and the facts that pick a member.

    Attributes
    ----------
    fixed, working : FixedPoints
        In pixels, and in the working frame.
    T : ndarray, shape (3, 3)
        Similarity from pixels to the working frame.
    C, ll : ndarray, shape (3, 3)
        In the working frame, of unit norm; see `conic_pencil.conic_pencil`.
    known : sequence of str
        Facts that are used: 'aspect_ratio', 'principal_point', 'skew'.
    facts : CameraFacts

    """

    fixed: FixedPoints
    working: FixedPoints
    T: np.ndarray
    C: np.ndarray
    ll: np.ndarray
    known: Sequence[str]
    facts: CameraFacts

    def camera(self, mu: float) -> np.ndarray | NoEstimate:
        """Return K (3, 3) of a member, in the working frame; none where it is not definite."""
        return calibration_from_iac(self.C + mu * self.ll)


def calibration_slopes(K: np.ndarray, omega: np.ndarray, change: np.ndarray) -> np.ndarray:
    """
    Derivative of K by omega = s (K K^T)^-1 along given changes of omega.

    Parameters
    ----------
    K : ndarray, shape (3, 3)
        K[2, 2] = 1.
    omega : ndarray, shape (3, 3)
    change : ndarray, shape (n, 3, 3)
        Symmetric.

    Returns
    -------
    ndarray, shape (n, 3, 3)

    """
    # K^T d(omega) K / s = -(X + X^T) + (ds / s) I with dK = K X, X upper triangular, X33 = 0
    scale = (K.T @ omega @ K)[2, 2]
    M = K.T @ change @ K / scale
    M = M - M[:, 2:, 2:] * np.eye(3)
    slopes: np.ndarray = -K @ (np.triu(M, 1) + 0.5 * np.eye(3) * M)
    return slopes


def calibration_covariance(K: np.ndarray, pencil: Pencil, mu: float, covariance: ArrayLike,
                           ) -> np.ndarray:
    """
    Covariance of fx, fy, cx, cy, skew.

    Parameters
    ----------
    K : ndarray, shape (3, 3)
        Pixels.
    pencil : Pencil
        The movement of its frame with the fixed points changes nothing.
    mu : float
        Member of the pencil.
    covariance : array_like, shape (9, 9)
        Of v, Re i and Im i as in the estimate's FixedPoints, pixels.

    Returns
    -------
    ndarray, shape (5, 5)

    """
    T, C, ll, fixed, working = pencil.T, pencil.C, pencil.ll, pencil.fixed, pencil.working
    v, i = working.vanishing_point, working.circular_point
    back = np.linalg.inv(T)
    dv, di = np.zeros((3, 9)), np.zeros((3, 9), complex)
    dv[:, :3] = T
    di[:, 3:6] = T / fixed.circular_point[2]
    di[:, 6:] = 1j * di[:, 3:6]
    side = np.cross(v, i)
    moved = cross_matrix(v) @ di - cross_matrix(i) @ dv
    dC = moved.T[:, :, None] * side.conj() + side[:, None] * moved.T.conj()[:, None, :]
    dC = dC.real / np.linalg.norm(np.outer(side, side.conj()).real)
    line = np.cross(i.real, i.imag)
    dl = cross_matrix(i.real) @ di.imag - cross_matrix(i.imag) @ di.real
    dll = (dl.T[:, :, None] * line + line[:, None] * dl.T[:, None, :]) / (line @ line)
    omega = C + mu * ll
    working_K = T @ K / T[2, 2]
    slopes = calibration_slopes(working_K, omega, np.concatenate([dC + mu * dll, ll[None]]))
    slopes = (back @ slopes)[(slice(None), *K_ENTRIES)].T / back[2, 2]     # (5, 10)
    by_points, by_mu = slopes[:, :9], slopes[:, 9]
    facts_by_K, free = fact_slopes(K, pencil.known, pencil.facts, omega[:2, :2])
    along = facts_by_K @ by_mu
    weight = along / (along @ along)
    total = by_points - np.outer(by_mu, weight @ facts_by_K @ by_points)
    by_facts = np.outer(by_mu, weight @ free)
    spread: np.ndarray = total @ covariance @ total.T + by_facts @ by_facts.T
    return spread


def fact_slopes(K: np.ndarray, known: Sequence[str], facts: CameraFacts, upper: np.ndarray,
                ) -> tuple[np.ndarray, np.ndarray]:
    """
    Derivative of the facts' residuals, in their sigmas, by fx, fy, cx, cy, skew.

    Parameters
    ----------
    K : ndarray, shape (3, 3)
    known : list of str
    facts : CameraFacts
    upper : ndarray, shape (2, 2)
        Of omega: what (5.9) weighs a principal point by, if it is the only fact.

    Returns
    -------
    slopes : ndarray, shape (r, 5)
    free : ndarray, shape (r, r)
        Root of the residuals' covariance: the identity, with zeros where a fact is exact.

    """
    fx, fy = K[0, 0], K[1, 1]
    rows, free = [], []
    for name in known:
        if name == 'aspect_ratio':
            sigma = facts.aspect_ratio_sigma
            block = np.array([[-fy / fx ** 2, 1 / fx, 0, 0, 0]])
        elif name == 'skew':
            sigma = facts.skew_sigma_px
            block = np.array([[0, 0, 0, 0, 1.0]]) / (1 if sigma else fx)
        else:
            sigma = facts.principal_point_sigma_px
            block = np.array([[0, 0, 1.0, 0, 0], [0, 0, 0, 1, 0]]) / (1 if sigma else fx)
        weigh = upper if known == ['principal_point'] else np.eye(len(block))
        rows.append(weigh @ block / (sigma or EXACT_SIGMAS[name]))
        free.append(weigh * (sigma > 0))
    return np.concatenate(rows), block_diag(*free)
