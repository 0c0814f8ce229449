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
Which share of what is known of each parameter comes from the images, and which from facts.

The covariance C of an estimate from images and facts obeys C = C (I + Λ) C, with I the images'
information and Λ that of the facts. So C Λ C is the part of the variance that the facts' own
sigmas bring in. Of a parameter that has a fact of its own, its share is that of the information.
An exact fact brings in no variance; what rests on it shows when it is taken away.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import to_parameters
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.observability import observability_limits
from selfcal_ros.calibration.result import Identifiability

#: Facts that may be stated, and the unknowns of the lens that each is about.
FACTS = {'aspect ratio': ('aspect',), 'skew': ('skew',), 'principal point': ('cx', 'cy')}
#: Parameters of a direction that weigh less than this fraction of the heaviest are not named.
MINOR = 0.2


def identify(fit: RobustFit, size: tuple[int, int], estimated: tuple[str, ...]) -> Identifiability:
    """
    Tell images from facts.

    Parameters
    ----------
    fit : RobustFit
        An optimum.
    size : (int, int)
        Width and height of the image.
    estimated : tuple of str
        The parameters of the camera that are estimated.

    Returns
    -------
    Identifiability

    """
    state, internal = fit.state, fit.lens_covariance
    soft, camera = fit.bundle.priors.soft_information(), state.camera(*size)
    names = camera.parameter_names
    # what facts bring is no part of the scatter that Huber's loss speaks of
    factor = fit.information.factor
    total = np.diag(to_parameters(internal, state.lens))
    brought = np.diag(to_parameters(internal @ soft @ internal, state.lens))
    place = [names.index(name) for name in estimated]
    limits = observability_limits(camera)
    without = {}
    for fact, covariance in _without_facts(fit).items():
        alone = np.diag(to_parameters(covariance, state.lens))
        without[fact] = {
            names[k]: float(np.sqrt(alone[k] / total[k]))
            if alone[k] < limits[k]**2 else np.inf for k in place}
    scaled = to_parameters(internal, state.lens) / np.outer(limits, limits)
    values, vectors = np.linalg.eigh(scaled[np.ix_(place, place)])
    weakest = np.sqrt(max(values[-1], 0)) * vectors[:, -1] * limits[place]
    heavy = np.abs(vectors[:, -1]) > MINOR * np.abs(vectors[:, -1]).max()
    return Identifiability(
        {names[k]: float(1 - brought[k] / max(factor * total[k], 1e-300)) for k in place},
        without,
        {names[k]: float(value) for k, value, said in zip(place, weakest, heavy)
         if said},
        float(np.sqrt(max(values[-1], 0))))


def _without_facts(fit: RobustFit) -> dict[str, np.ndarray]:
    """Covariances (k, k) of the lens if each stated fact were not stated."""
    priors, state = fit.bundle.priors, fit.state
    stated = {fact: about for fact, about in FACTS.items() if set(about) <= set(priors)}
    if not stated:
        return {}
    # linearised once with all of them free; those that stay add what they know
    open_ones = set().union(*stated.values())
    none = fit.bundle.with_priors(priors.without(open_ones))
    linearisation = none.linearise(state)
    system = none.normal_equations(state, linearisation=linearisation)
    result = {}
    for fact, about in stated.items():
        freed = fit.bundle.with_priors(priors.without(about))
        known = freed.prior_terms(state)[2] - none.prior_terms(state)[2]
        system_with = replace(system, matrix=system.matrix.copy())
        system_with.add_diagonal(np.arange(len(known)), known)
        lens = freed.unknowns.lens
        result[fact] = (freed.inverse(system_with)[lens, lens]
                        * freed.loss_factors(linearisation)[0])
    return result
