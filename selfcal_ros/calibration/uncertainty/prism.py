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
Variance for thin-prism distortion, where a lens seems decentred by more than most are.

A thin prism moves the image by s₁ r², s₂ r² (Weng, Cohen and Herniou 1992), nearly as decentring
p₁, p₂ and a step of the principal point do together. No file of ROS has names for it, and images
seldom tell one from the other. So where decentring is found that is certain, and larger than that
of ordinary lenses, as much of it again may be a prism: s has the variance of what is beyond the
ordinary, and the images count as in any estimate. What s would move is added to the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.priors import ORDINARY_DECENTRING
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.uncertainty.suppositions import (added_covariance, joint_information,
                                                              Supposition)
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.distributions import chi2_sf

#: Decentring counts where without it the estimate would be an accident so rarely.
ACCIDENT = 1e-6
_PRISM = 'no prism'


@dataclass(frozen=True)
class PossiblePrism:
    """
    What a prism may do to a calibration.

    Attributes
    ----------
    decentring : float
        Root of p1² + p2², the largest of all cameras.
    covariance : ndarray, shape (k, k)
        To add to that of the unknowns of the lens.

    """

    decentring: float
    covariance: np.ndarray

    def findings(self) -> tuple[Finding, ...]:
        """Tell of it."""
        return (Finding('lens_may_be_prism', decentring=self.decentring),)


def possible_prism(fit: RobustFit, covariance: np.ndarray, variance_inflation: float,
                   ) -> PossiblePrism | None:
    """
    Allow for a prism where a lens is decentred by more than most.

    Parameters
    ----------
    fit : RobustFit
        At its optimum; of one camera or of a rig.
    covariance : ndarray, shape (k, k)
        Of the unknowns of the lens, with all that it allows for.
    variance_inflation : float
        Variance of the estimate over that with independent errors.

    Returns
    -------
    PossiblePrism or None
        None for most lenses.

    """
    columns, sizes, decentring = [], [], 0.0
    for lens, part, rows, free in fit.lenses():
        if {'p1', 'p2'} <= free:
            places = lens.places(('p1', 'p2'))
            size = _beyond_ordinary(lens.values[places],
                                    covariance[part, part][np.ix_(places, places)])
            if size > 0:
                columns.append(_by_prism(fit, lens, rows))
                sizes += [size, size]
                decentring = max(decentring, float(np.sqrt(np.sum(lens.values[places]**2))))
    if not columns:
        return None
    joint = joint_information(
        fit, [Supposition(_PRISM, ('s1', 's2') * len(columns), np.concatenate(columns, axis=2))],
        variance_inflation)
    tested = joint.test(_PRISM)
    return PossiblePrism(decentring, added_covariance(fit, tested, np.array(sizes)))


def _beyond_ordinary(p: np.ndarray, own: np.ndarray) -> float:
    """Return the variance of decentring beyond that of most lenses, zero where none is sure."""
    size = float(np.sum(p**2) - np.trace(own) - 2 * ORDINARY_DECENTRING**2) / 2
    sure = size > 0 and chi2_sf(p @ np.linalg.solve(own, p), 2) <= ACCIDENT
    return size if sure else 0.0


def _by_prism(fit: RobustFit, lens: Lens, rows: np.ndarray) -> np.ndarray:
    """Differentiate the residuals by s1 and s2 of the lens that made some rows, (N, 2, 2)."""
    f, aspect, cx, cy, skew = lens.values[:5]
    # where the distorted image is; what r² differs there is of the order of s times k1
    at = (fit.bundle.xy + fit.linearisation.residual)[rows]
    y = (at[:, 1] - cy) / (f * aspect)
    square = ((at[:, 0] - cx - skew * y) / f)**2 + y**2
    columns = np.zeros((len(rows), 2, 2))
    columns[rows, 0, 0], columns[rows, 0, 1] = f * square, skew * square
    columns[rows, 1, 1] = f * aspect * square
    return columns
