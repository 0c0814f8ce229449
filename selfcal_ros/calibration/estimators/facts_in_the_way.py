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

from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.estimators.stated_facts import ABOUT, CONTRADICTED, PLAUSIBLE
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import CameraFacts, MATRIX_PARAMETERS
from selfcal_ros.geometry.chances import chi2_chance
from selfcal_ros.geometry.estimate import NoEstimate


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
    camera, priors = free.camera, priors_from_facts(facts)
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    rows = dict(zip(MATRIX_PARAMETERS, np.eye(len(MATRIX_PARAMETERS), len(camera.parameters))))
    rows['aspect'] = (rows['fy'] - fy / fx * rows['fx']) / fx
    values = {**dict(zip(MATRIX_PARAMETERS, camera.parameters)), 'aspect': fy / fx}
    found: list[tuple[float, dict]] = []
    for fact, names in ABOUT.items():
        if not set(names) <= set(priors):
            continue
        slope = np.array([rows[name] for name in names])
        covariance = slope @ free.covariance @ slope.T
        sigma = np.sqrt(np.diag(covariance))
        distance = np.array([values[name] - priors[name].value for name in names])
        covariance += np.diag([priors[name].sigma**2 for name in names])
        total = float(distance @ np.linalg.solve(covariance, distance))
        # what is known worse than facts are wrong may have any other cause
        if chi2_chance(total, len(names)) < CONTRADICTED and all(
                one < PLAUSIBLE[name] * (1.0 if name == 'aspect' else fx)
                for name, one in zip(names, sigma)):
            sigmas = float(np.sqrt(total))
            found.append((sigmas, {'fact': fact, 'sigmas': sigmas, 'preferred': [
                {'name': name, 'value': float(values[name]), 'sigma': float(one),
                 'stated': priors[name].value} for name, one in zip(names, sigma)]}))
    if not found:
        return None
    first, *more = (told for _, told in sorted(found, key=lambda one: -one[0]))
    return NoEstimate('fact_contradicted', **first, motion=free.motion, facts=facts, further=[
        Finding('fact_contradicted_too', **one) for one in more])
