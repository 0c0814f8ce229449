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
What the images say and what the facts say.

The covariance C of an estimate from images and facts obeys C = C (I + Λ) C, with I the images'
information and Λ that of the facts. So C Λ C is the part of the variance that the facts' own
sigmas bring in, and of a parameter that has a fact of its own, its share is that of the
information. An exact fact brings in no variance; what rests on it shows when it is taken away.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.information import inverse_information
from selfcal_ros.calibration.bundle.robust_fit import Fit
from selfcal_ros.calibration.bundle.state import ASPECT, CX, CY, parameter_covariance, SKEW
from selfcal_ros.calibration.observability import observability_limits
from selfcal_ros.calibration.result import Identifiability
from selfcal_ros.geometry.camera import PARAMETER_NAMES

#: Facts that may be stated, and the internal parameters that each is about.
FACTS = {'aspect ratio': (ASPECT,), 'skew': (SKEW,), 'principal point': (CX, CY)}
#: Parameters of a direction that weigh less than this share of the heaviest are left out of words.
MINOR = 0.2


def identify(fit: Fit, size: tuple[int, int], estimated: tuple) -> Identifiability:
    """
    Tell images from facts.

    Parameters
    ----------
    fit : Fit
        An optimum.
    size : (int, int)
        Width and height of the image.
    estimated : tuple of str
        The parameters, among `PARAMETER_NAMES`, that are estimated.

    Returns
    -------
    Identifiability

    """
    state, priors = fit.state, fit.bundle.priors
    internal = fit.covariance[:9, :9]
    soft = np.zeros(9)
    for index, prior in priors.items():
        if 0 < prior.sigma < np.inf:
            soft[index] = 1 / prior.sigma**2
    total = np.diag(parameter_covariance(internal, state.intrinsics))
    brought = np.diag(parameter_covariance((internal * soft) @ internal, state.intrinsics))
    place = [PARAMETER_NAMES.index(name) for name in estimated]
    limits = observability_limits(state.camera(*size))
    without = {}
    for fact, covariance in _without_facts(fit).items():
        alone = np.diag(parameter_covariance(covariance, state.intrinsics))
        without[fact] = {
            PARAMETER_NAMES[k]: float(np.sqrt(alone[k] / total[k]))
            if alone[k] < limits[k]**2 else np.inf for k in place}
    scaled = parameter_covariance(internal, state.intrinsics) / np.outer(limits, limits)
    values, vectors = np.linalg.eigh(scaled[np.ix_(place, place)])
    weakest = np.sqrt(max(values[-1], 0)) * vectors[:, -1] * limits[place]
    heavy = np.abs(vectors[:, -1]) > MINOR * np.abs(vectors[:, -1]).max()
    return Identifiability(
        {PARAMETER_NAMES[k]: float(1 - brought[k] / max(total[k], 1e-300)) for k in place},
        without,
        {PARAMETER_NAMES[k]: float(value) for k, value, said in zip(place, weakest, heavy)
         if said},
        float(np.sqrt(max(values[-1], 0))))


def _without_facts(fit: Fit) -> dict[str, np.ndarray]:
    """Covariances (n, n) of the optimum if each stated fact were not stated."""
    priors, state = fit.bundle.priors, fit.state
    stated = {fact: about for fact, about in FACTS.items() if set(about) <= set(priors)}
    if not stated:
        return {}
    # linearised once with all of them free; those that stay add what they know
    open_ones = set().union(*stated.values())
    none = fit.bundle.with_priors({k: p for k, p in priors.items() if k not in open_ones})
    line = none.linearise(state)
    system = none.normal_equations(state, line=line)
    result = {}
    for fact, about in stated.items():
        freed = fit.bundle.with_priors({k: p for k, p in priors.items() if k not in about})
        known = freed.prior_terms(state)[2] - none.prior_terms(state)[2]
        result[fact] = (inverse_information(system.matrix + np.diag(known), freed.unknowns())
                        * freed.loss_factors(line.residual[line.ahead])[0])
    return result
