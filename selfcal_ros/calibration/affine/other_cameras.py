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
Cameras beside an optimum that explain infinite homographies about as well.

To first order the covariance tells of the optimum alone. Rotations about one axis leave a family
of cameras. Where the known fact hardly holds it, the curvature at the optimum is an accident of
the noise.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.affine.rotation_constraints import (LOG_F, RotationConstraints, SKEW,
                                                                 solve)
from selfcal_ros.calibration.observability import (FOCAL_FRACTION, PRINCIPAL_POINT_FRACTION,
                                                   SKEW_FRACTION)
from selfcal_ros.geometry.camera_facts import CameraFacts

#: The weakest parameter is followed where its sigma is such a share of what makes it unobservable.
_PROFILED, _HOPELESS = 0.02, 1.0
#: Sigmas that it is moved by, how often as far again, and what the misfit rises by at least, in
#: sigmas: below, a valley counts as endless.
_REACH, _MOST_STEPS, _LEAST_RISE = 2.0, 4, 0.05
#: What makes a principal point unobservable, in longer image sides.
_POINT_LIMIT = PRINCIPAL_POINT_FRACTION * 2**0.5
#: Optima that differ by less (log f, log ζ, image sides) are one.
_ONE_OPTIMUM = 1e-3


def skew_cost(theta: np.ndarray, facts: CameraFacts) -> float:
    """Tell what a skew costs where nothing is said of it: of two optima the usual pixels count."""
    if facts.skew is not None:
        return 0.0
    return float((theta[SKEW] * np.exp(-theta[LOG_F]) / SKEW_FRACTION)**2)


def covariance_of_valley(constraints: RotationConstraints, theta: np.ndarray, small: np.ndarray,
                         free: np.ndarray, terms: tuple[np.ndarray, np.ndarray], misfit: float,
                         inflation: float) -> np.ndarray:
    """
    Covariance (5, 5) of theta that the profile likelihood of its weakest entry adds.

    That entry is moved by some of its sigmas, and the rest follows. Where a fact hardly holds the
    family of one axis, the misfit rises far less than the curvature at the optimum says.
    """
    limits = np.array([FOCAL_FRACTION, FOCAL_FRACTION, _POINT_LIMIT, _POINT_LIMIT,
                       SKEW_FRACTION * np.exp(theta[LOG_F])])
    share = np.sqrt(np.diag(small)) / limits
    place = int(np.argmax(share))
    if not _PROFILED < share[place] < _HOPELESS:
        return np.zeros((5, 5))
    per_sigma = small[place] / np.sqrt(small[place, place])
    others = free & (np.arange(5) != place)
    total = -np.outer(per_sigma, per_sigma)
    for side in (-1, 1):
        at, step = theta, side * _REACH * per_sigma
        for _ in range(_MOST_STEPS):
            moved, _, found, _ = solve(constraints, at + step, others, terms)
            sigmas = max(np.sqrt(max(found - misfit, 0.0) / inflation), _LEAST_RISE)
            if sigmas > 0.7 * _REACH:
                break
            at, step = moved, moved - at
        total += np.outer(moved - theta, moved - theta) / (2 * sigmas**2)
    values, vectors = np.linalg.eigh(total / np.outer(limits, limits))
    more: np.ndarray = (vectors * np.maximum(values, 0)) @ vectors.T * np.outer(limits, limits)
    return more


def covariance_of_other_optima(theta: np.ndarray, others: list[np.ndarray], costs: np.ndarray,
                               ) -> np.ndarray:
    """
    Covariance (5, 5) of theta that optima nearly as good add, each with its probability.

    An aspect ratio leaves two cameras where the rotations share an axis. The closer the axis is to
    a diagonal the nearer they are to each other. No curvature at the one tells of the other.
    """
    apart, chances = [np.zeros(5)], [1.0]
    for k in np.argsort(costs):
        away = others[k] - theta
        if min(np.abs(away - known).max() for known in apart) > _ONE_OPTIMUM:
            apart.append(away)
            chances.append(float(np.exp(-0.5 * max(costs[k], 0.0))))
    weight = np.array(chances) / np.sum(chances)
    added: np.ndarray = np.einsum('k,ki,kj->ij', weight, apart, apart)
    return added
