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
Stated facts against a calibration of the same images without them.

The score test asks at an optimum under the facts. Where none stands, or another path than that to
it would be taken without them, the images are calibrated twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.priors import Priors, priors_from_facts
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.uncertainty.facts_verdict import (
    ABOUT, CONTRADICTED, Contradiction, FactsVerdict, HELD_COEFFICIENTS, LENS_MODEL,
    MOVED_FRACTION, PLAUSIBLE)
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.distributions import chi2_sf
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.scaled_inverse import squared_distance


def contradictions(facts: CameraFacts, free: Calibration) -> list[Contradiction]:
    """
    List what a calibration without the facts contradicts, the surest first.

    Parameters
    ----------
    facts : CameraFacts
        As they were stated.
    free : Calibration
        From the same images, without them.

    Returns
    -------
    list of Contradiction
        Without what they do to the camera. Empty where the images do not know better than
        chance, or not well.

    """
    camera, priors = free.camera, priors_from_facts(facts)
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    names = camera.parameter_names
    rows = dict(zip(names, np.eye(len(names))))
    rows['aspect'] = (rows['fy'] - fy / fx * rows['fx']) / fx
    values = {**dict(zip(names, camera.parameters)), 'aspect': fy / fx}
    found = []
    known = tuple(name for name in names if free.sigma[name] > 0)
    for fact, about in {**ABOUT, LENS_MODEL: _held_by_lens(facts, known)}.items():
        if not about or not (fact == LENS_MODEL or set(about) <= set(priors)):
            continue
        stated, spread = _as_stated(priors, about)
        slope = np.array([rows[name] for name in about])
        covariance = slope @ free.covariance @ slope.T
        sigma = np.sqrt(np.diag(covariance))
        distance = np.array([values[name] for name in about]) - stated
        total = squared_distance(distance, covariance + np.diag(spread**2))
        # what is known worse than facts are wrong may have any other cause
        if chi2_sf(total, len(about)) < CONTRADICTED and all(
                one < PLAUSIBLE.get(name, np.inf) * (fx if name in ('skew', 'cx', 'cy') else 1.0)
                for name, one in zip(about, sigma)):
            found.append(Contradiction(fact, [
                {'name': name, 'value': float(values[name]), 'sigma': float(one),
                 'stated': float(was)} for name, one, was in zip(about, sigma, stated)],
                float(np.sqrt(total)), has_sigma=bool(spread.any())))
    return sorted(found, key=lambda one: -one.sigmas)


def _held_by_lens(facts: CameraFacts, names: tuple[str, ...]) -> tuple[str, ...]:
    """Name coefficients that a stated lens holds at zero, among those of another."""
    return tuple(name for name in HELD_COEFFICIENTS.get(facts.distortion, ()) if name in names)


def _as_stated(priors: Priors, about: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return what is stated of some unknowns, and its sigmas; of a lens that is zero."""
    known = [priors.get(name) for name in about]
    return (np.array([0.0 if one is None else one.value for one in known]),
            np.array([0.0 if one is None else one.sigma for one in known]))


def with_tested_facts(calibrated: Callable[[CameraFacts], Calibration | NoEstimate],
                      facts: CameraFacts) -> Calibration | NoEstimate:
    """
    Calibrate under facts of calibration matrix and lens, and hold these against the images.

    Parameters
    ----------
    calibrated : callable
        Makes a calibration from the same images under some facts.
    facts : CameraFacts
        As they were stated.

    Returns
    -------
    Calibration or NoEstimate

    """
    held = calibrated(facts)
    # of a lens that is richer than those that are found out, nothing is held
    released = replace(facts, aspect_ratio=None, skew=None, principal_point=None,
                       distortion='auto' if facts.distortion in HELD_COEFFICIENTS
                       else facts.distortion)
    free = held if released == facts else calibrated(released)
    if not free or (held and free.noise_sigma_px > held.noise_sigma_px):
        return held
    return held_against(held, free, contradictions(facts, free), facts.trusted)


def held_against(held: Calibration | NoEstimate, free: Calibration,
                 found: list[Contradiction], trusted: bool) -> Calibration | NoEstimate:
    """
    Refuse a calibration that rests on contradicted facts, or let its sigmas hold the difference.

    Parameters
    ----------
    held : Calibration or NoEstimate
        Under the facts.
    free : Calibration
        From the same images, without them.
    found : list of Contradiction
        What that contradicts, without what it does to the camera.
    trusted : bool
        Whether the facts were declared exact.

    Returns
    -------
    Calibration or NoEstimate

    """
    if not found:
        return held
    count, focal_px = len(MATRIX_PARAMETERS), float(free.camera.K[0, 0])
    shift = np.zeros(len(held.camera.parameters) if held else count)
    if held:
        shift[:count] = (free.camera.parameters - held.camera.parameters)[:count]
    is_large = bool(np.abs(shift).max() > MOVED_FRACTION * focal_px)
    # all facts were released at once: the whole way is the first one's
    verdict = FactsVerdict(tuple(
        replace(one, shift=shift if k == 0 else 0 * shift, is_large=is_large)
        for k, one in enumerate(found)), (), (), trusted)
    if not held:
        return held if verdict.cause is None else verdict.cause
    refusal = verdict.refusal(held.covariance, focal_px)
    if refusal is not None:
        return refusal
    covariance, findings = verdict.widened(held.covariance, held.camera.parameter_names)
    return replace(held, covariance=covariance, findings=(*findings, *held.findings))
