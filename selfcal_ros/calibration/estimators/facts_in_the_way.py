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
Facts that are so wrong that no start explains the images.

The score test asks at an optimum. Where a fact is off by a tenth, none is found. So the same
images are calibrated without the facts, and what they then prefer is held against the facts.
"""

from __future__ import annotations

from dataclasses import replace
import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import (fit_robustly, Observations, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.estimators.stated_facts import spread_of_unknowns
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.uncertainty.facts_verdict import FactsVerdict
from selfcal_ros.calibration.uncertainty.free_of_facts import contradictions
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.scaled_inverse import squared_distance


def without_facts(facts: CameraFacts) -> CameraFacts | None:
    """Return facts that say nothing of the calibration matrix; None if these say nothing."""
    if facts.trusted or (facts.aspect_ratio is None and facts.skew is None
                         and facts.principal_point is None):
        return None
    return replace(facts, aspect_ratio=None, skew=None, principal_point=None)


def fact_in_the_way(facts: CameraFacts, free: Calibration) -> NoEstimate | None:
    """
    Name the facts that a calibration without them contradicts.

    Parameters
    ----------
    facts : CameraFacts
        As they were stated.
    free : Calibration
        From the same images, without them.

    Returns
    -------
    NoEstimate or None
        None where the images do not know better than chance, or not well.

    """
    cause = FactsVerdict(tuple(contradictions(facts, free)), (), (), facts.trusted).cause
    return None if cause is None else cause.saying(motion=free.motion, facts=facts)


def preferred_by_all(refusal: NoEstimate, fit: RobustFit, offered: Observations,
                     size: tuple[int, int]) -> NoEstimate:
    """
    Return a refusal for facts with what all observations prefer.

    What contradicts a wrong fact most was left out under it as a gross error. So what remains
    prefers values between the stated and the true ones.

    Parameters
    ----------
    refusal : NoEstimate
        Of the kind 'fact_contradicted'.
    fit : RobustFit
        That was refused.
    offered : Observations
        All that were offered to it.
    size : (int, int)
        Width and height of the image.

    """
    further = refusal.values['further']
    blamed = [dict(refusal.values), *(dict(one.values) for one in further)]
    names = [entry['name'] for one in blamed for entry in one['preferred']]
    state = None if fit.observations.shutter is not None else with_all_points(fit.state, offered)
    # what is preferred to the stated lens may be another model's
    if state is None or not set(names) <= set(state.lens.names):
        return refusal
    freed = fit_robustly(offered, state, fit.motion, fit.bundle.priors.without(names),
                         fit.bundle.sigma_px)
    if not (freed.bundle.sigma_px < fit.bundle.sigma_px
            or len(freed.observations.view) > len(fit.observations.view)):
        return refusal
    for one in blamed:
        about = [entry['name'] for entry in one['preferred']]
        places = freed.state.lens.places(about)
        covariance, _ = spread_of_unknowns(freed, places, size)
        values = freed.state.lens.values[places]
        distance = values - [entry['stated'] for entry in one['preferred']]
        one['sigmas'] = float(np.sqrt(squared_distance(distance, covariance)))
        one['preferred'] = [
            {**entry, 'value': float(value), 'sigma': float(sigma)} for entry, value, sigma in zip(
                one['preferred'], values, np.sqrt(np.diag(covariance)))]
    first, *others = blamed
    return refusal.saying(**{**first, 'further': [
        Finding(was.kind, **one) for was, one in zip(further, others)]})
