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
Stated facts against the images of an optimum: what contradicts them.

A fact that the score test contradicts beyond chance is released, and the same observations are
fitted again. What becomes of the calibration is in `facts_verdict`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.tolerances import TO_COMPARE
from selfcal_ros.calibration.uncertainty.cluster_covariance import robust_covariance_of
from selfcal_ros.calibration.uncertainty.facts_verdict import (
    ABOUT, CONTRADICTED, Contradiction, DOUBTED, FactsVerdict, HELD_COEFFICIENTS, LENS_MODEL,
    MOVED_FRACTION, PLAUSIBLE, SILENT_SIGMAS, Unchecked)
from selfcal_ros.calibration.uncertainty.group_jackknife import segment_excess, SEGMENTS
from selfcal_ros.calibration.uncertainty.hidden_decentring import HiddenDecentring
from selfcal_ros.calibration.uncertainty.suppositions import (joint_information, Supposition,
                                                              Tested)
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.distributions import chi2_sf, f_sf
from selfcal_ros.geometry.scaled_inverse import squared_distance

#: A contradiction is large where a held parameter is off by more than this share of the focal
#: length.
HELD_FRACTION = 1e-3


def examine_facts(fit: RobustFit, facts: CameraFacts, size: tuple[int, int],
                  variance_inflation: float, hidden: HiddenDecentring | None = None,
                  ) -> FactsVerdict:
    """
    Ask the images of an optimum about every fact that is stated.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    facts : CameraFacts
        As they were stated; a lens that was chosen is no fact.
    size : (int, int)
        Width and height of the image.
    variance_inflation : float
        Variance of the estimate over that with independent errors.
    hidden : HiddenDecentring, optional
        What the lens may do beside its model: no fact is blamed for it.

    Returns
    -------
    FactsVerdict

    """
    found: list[Contradiction] = []
    doubted: list[Contradiction] = []
    unchecked: tuple[Unchecked, ...] = ()
    asked: set[str] = set()
    while True:
        about = {fact: names for fact, names in _stated(fit, facts).items() if fact not in asked}
        tested = sorted(_tested(fit, about, variance_inflation, hidden),
                        key=lambda one: one.p_value)
        if not asked:
            unchecked = tuple(error for one in tested if one.p_value > DOUBTED
                              for error in _unchecked(fit, one))
        for one in tested:
            if one.p_value > DOUBTED:
                return FactsVerdict(tuple(found), tuple(doubted), unchecked, facts.trusted)
            asked.add(one.name)
            freed, p_value, released = _released(fit, one, size)
            if p_value < CONTRADICTED:
                (doubted if fit.observations.moves_by_view else found).append(released)
                fit = freed
                break
            if p_value < DOUBTED:
                doubted.append(released)
            else:
                # the step of the score was a chance; what it lets pass it does not tell either
                unchecked += tuple(_unchecked(fit, one))
        else:
            return FactsVerdict(tuple(found), tuple(doubted), unchecked, facts.trusted)


def _stated(fit: RobustFit, facts: CameraFacts) -> dict[str, tuple[str, ...]]:
    """Name the facts that are stated, and the unknowns of the lens that they are about."""
    stated = {fact: about for fact, about in ABOUT.items()
              if set(about) <= set(fit.bundle.priors)}
    held = tuple(name for name in HELD_COEFFICIENTS.get(facts.distortion, ())
                 if name in fit.state.lens.names)
    return {**stated, LENS_MODEL: held} if held else stated


def _tested(fit: RobustFit, about: dict[str, tuple[str, ...]], variance_inflation: float,
            hidden: HiddenDecentring | None) -> list[Tested]:
    """Test every fact by itself, the others supposed."""
    if not about:
        return []
    bundle, lens = fit.bundle, fit.state.lens
    shared = fit.linearisation.shared
    if LENS_MODEL in about:
        free = bundle.unknowns.free.copy()
        free[bundle.unknowns.lens] = True
        shared = bundle.predict(fit.state).differentiated(
            replace(bundle.unknowns, free=free)).shared
    joint = joint_information(fit, [Supposition(fact, names, shared[:, :, lens.places(names)])
                                    for fact, names in about.items()], variance_inflation,
                              None if hidden is None else hidden.columns,
                              1.0 if hidden is None else hidden.sigma)
    return [joint.test(fact) for fact in about]


def _released(fit: RobustFit, tested: Tested, size: tuple[int, int],
              ) -> tuple[RobustFit, float, Contradiction]:
    """
    Fit without a fact, and judge it by the covariance that this fit gives a calibration.

    Returns
    -------
    RobustFit
    float
        Probability of such a distance from the fact, were it true.
    Contradiction

    """
    priors, lens = fit.bundle.priors, fit.state.lens
    bundle = fit.bundle.with_priors(priors.without(tested.unknowns))
    state = bundle.optimise(fit.state, iterations=40, tolerance=TO_COMPARE)
    freed = replace(fit, bundle=bundle.with_sigma(bundle.noise_rms(state)), state=state)
    places = lens.places(tested.unknowns)
    covariance, ratio = spread_of_unknowns(freed, places, size)
    sigma = np.sqrt(np.diag(covariance))
    stated = np.array([priors[name].value for name in tested.unknowns])
    distance = state.lens.values[places] - stated
    covariance += np.diag([priors[name].sigma**2 for name in tested.unknowns])
    total = squared_distance(distance, covariance)
    # a variance that a few stretches of views tell is known to as few degrees of freedom
    p_value = float(f_sf(total / len(places), len(places), SEGMENTS - 1)
                    if ratio > 1 else chi2_sf(total, len(places)))
    preferred = [{'name': name, 'value': float(value), 'sigma': float(spread),
                  'stated': priors[name].value}
                 for name, value, spread in zip(tested.unknowns, state.lens.values[places], sigma)]
    held = np.array([name in ('cx', 'cy', 'skew') and priors[name].sigma == 0
                     for name in tested.unknowns])
    held_off = held & (np.abs(state.lens.values[places] - stated)
                       > np.maximum(SILENT_SIGMAS * sigma, HELD_FRACTION * lens['f']))
    shift = state.camera().parameters - fit.state.camera().parameters
    moved = np.abs(shift[:len(MATRIX_PARAMETERS)]).max() / lens['f']
    return freed, p_value, Contradiction(tested.name, preferred, float(np.sqrt(total)), shift,
                                         bool(held_off.any() or moved > MOVED_FRACTION),
                                         any(priors[name].sigma > 0 for name in tested.unknowns))


def spread_of_unknowns(fit: RobustFit, places: np.ndarray, size: tuple[int, int],
                       ) -> tuple[np.ndarray, float]:
    """
    Return the covariance of some unknowns of the lens, with errors that tracks and views share.

    Also how much larger that of stretches of views is than chance has it.
    """
    clusters = robust_covariance_of(fit, size)
    ratio, of_segments = segment_excess(fit, clusters.variance_inflation)
    return (clusters.covariance + of_segments)[np.ix_(places, places)], ratio


def _unchecked(fit: RobustFit, tested: Tested) -> list[Unchecked]:
    """Return errors of a fact that would not show, and what each would do to the camera."""
    lens = fit.state.lens
    found = []
    for place, name in enumerate(tested.unknowns):
        if name in PLAUSIBLE:
            plausible = PLAUSIBLE[name] * (lens['f'] if name in ('skew', 'cx', 'cy') else 1.0)
            error = min(plausible, 2 * float(tested.sigma[place]))
            step = error * tested.response[:, place]
            step[lens.places((name,))] += error
            found.append(Unchecked(tested.name, name, error, _parameters_step(lens.values, step),
                                   error == plausible))
    return found


def _parameters_step(values: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Turn a step of the unknowns of the lens to one of the parameters of the camera."""
    shift = step.copy()
    f, aspect = values[:2]
    shift[1] = aspect * step[0] + f * step[1]
    return shift
