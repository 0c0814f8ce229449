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
Stated facts against the images: what contradicts them, and what becomes of the calibration.

A fact that the score test contradicts beyond chance is released, and the same observations are
fitted again. Where the camera then moves by more than its sigmas hold, the calibration is
refused, unless the facts were declared exact (`CameraFacts.trusted`); else the sigmas take up
the difference. Either way the value that the images prefer is told.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.tolerances import TO_COMPARE
from selfcal_ros.calibration.uncertainty.cluster_covariance import robust_covariance_of
from selfcal_ros.calibration.uncertainty.group_jackknife import segment_excess, SEGMENTS
from selfcal_ros.calibration.uncertainty.hidden_decentring import HiddenDecentring
from selfcal_ros.calibration.uncertainty.suppositions import (joint_information, Supposition,
                                                              Tested)
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.distributions import chi2_sf, f_sf
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.scaled_inverse import squared_distance

#: A fact is contradicted where what the images say would be an accident so rarely; what is an
#: accident less often than the second is allowed for in the sigmas.
CONTRADICTED, DOUBTED = 1e-4, 0.03
#: A camera that would move by more than so many of its sigmas is refused.
SILENT_SIGMAS = 4.0
#: What moves by less than this share of the focal length the sigmas can hold, however many.
HELD_SHARE = 2e-3
#: A contradiction is large where a held parameter is off by more than the first share of the focal
#: length, or any parameter of K moves by more than the second, whatever its sigma: the misfit has
#: widened that.
HELD_FRACTION, MOVED_FRACTION = 1e-3, 5e-3
#: Errors of facts that are not unusual: of skew and principal point as shares of the focal length.
PLAUSIBLE = {'aspect': 0.05, 'skew': 0.004, 'cx': 0.02, 'cy': 0.02, 'p1': 1e-3, 'p2': 1e-3}
#: Coefficients that a stated lens holds at zero, and that the images are asked about.
HELD_COEFFICIENTS = {'none': ('k1', 'k2', 'p1', 'p2'), 'radial1': ('k2', 'p1', 'p2'),
                     'radial2': ('k3', 'p1', 'p2'), 'radial3': ('p1', 'p2'), 'radtan': ('k3',)}
#: The fact that a stated lens is.
LENS_MODEL = 'lens model'
#: Unknowns of the lens that each fact is about.
ABOUT = {'aspect ratio': ('aspect',), 'skew': ('skew',), 'principal point': ('cx', 'cy')}


@dataclass(frozen=True)
class Contradiction:
    """
    A fact, and what the images prefer to it.

    Attributes
    ----------
    fact : str
    preferred : list of dict
        Of each unknown that the fact is about: name, value, sigma, stated.
    sigmas : float
        How surely the images prefer it.
    shift : ndarray, shape (k,)
        How the parameters of the camera move where the fact is released.
    is_large : bool
        Whether a parameter of the calibration matrix would be off by much.
    has_sigma : bool
        Whether the fact was stated with a sigma.

    """

    fact: str
    preferred: list[dict[str, Any]]
    sigmas: float
    shift: np.ndarray
    is_large: bool
    has_sigma: bool = False

    @property
    def values(self) -> dict[str, Any]:
        """What findings say of it."""
        return {'fact': self.fact, 'preferred': self.preferred, 'sigmas': self.sigmas}


class Unchecked(NamedTuple):
    """
    An error of a fact that the images would let pass.

    Attributes
    ----------
    fact, unknown : str
        The fact, and an unknown of the lens that it is about.
    error : float
    shift : ndarray, shape (k,)
        What it would do to the parameters of the camera.
    is_whole : bool
        Whether that is all of an error that is not unusual; else the images limit it.

    """

    fact: str
    unknown: str
    error: float
    shift: np.ndarray
    is_whole: bool


@dataclass(frozen=True)
class FactsVerdict:
    """
    What the images say of the stated facts.

    Attributes
    ----------
    contradicted : tuple of Contradiction
        Beyond chance.
    doubted : tuple of Contradiction
        What may be an accident; and all, where rows that views move by while they are read may be
        what the images contradict a fact by.
    unchecked : tuple of Unchecked
        What the images let pass.
    trusted : bool
        Whether the facts were declared exact.

    """

    contradicted: tuple[Contradiction, ...]
    doubted: tuple[Contradiction, ...]
    unchecked: tuple[Unchecked, ...]
    trusted: bool

    def refusal(self, covariance: np.ndarray, focal_px: float) -> NoEstimate | None:
        """
        Refuse a camera that rests on a wrong fact by more than its sigmas hold.

        Parameters
        ----------
        covariance : ndarray, shape (k, k)
            Of the parameters of the camera, under the facts.
        focal_px : float

        """
        if not self.contradicted or self.trusted:
            return None
        shift = np.sum([one.shift for one in self.contradicted], axis=0)
        moved = np.abs(shift[:len(MATRIX_PARAMETERS)]).max() / focal_px
        if ((_in_sigmas(shift, covariance).max() <= SILENT_SIGMAS or moved < HELD_SHARE)
                and not any(one.is_large for one in self.contradicted)):
            return None
        return self.cause

    def without(self, fact: str) -> FactsVerdict:
        """Return the verdict without what concerns one fact."""
        return replace(self, contradicted=tuple(o for o in self.contradicted if o.fact != fact),
                       doubted=tuple(o for o in self.doubted if o.fact != fact))

    def blaming(self, further: Contradiction | None) -> FactsVerdict:
        """Return the verdict with one more contradiction before all others, if there is one."""
        return self if further is None else replace(self, contradicted=(further,
                                                                        *self.contradicted))

    def concerns(self, fact: str) -> bool:
        """Tell whether the images prefer something else to a fact, surely or perhaps."""
        return fact in [one.fact for one in (*self.contradicted, *self.doubted)]

    @property
    def is_kept(self) -> bool:
        """Tell whether a fact counts that the images contradict."""
        return self.trusted and bool(self.contradicted)

    @property
    def cause(self) -> NoEstimate | None:
        """Why a calibration fails, as far as the facts are to blame."""
        if not self.contradicted or self.trusted:
            return None
        first, *more = self.contradicted
        return NoEstimate('fact_contradicted', **first.values, further=[
            Finding('fact_contradicted_too', **one.values) for one in more])

    def widened(self, covariance: np.ndarray, names: tuple[str, ...],
                ) -> tuple[np.ndarray, tuple[Finding, ...]]:
        """
        Let a covariance hold what the facts may be off by, and tell.

        Parameters
        ----------
        covariance : ndarray, shape (k, k)
        names : tuple of str
            Of the parameters.

        Returns
        -------
        ndarray, shape (k, k)
        tuple of Finding

        """
        found, wider = [], covariance
        estimated = np.diag(covariance) > 0
        for kind, one in (*(('fact_doubtful', one) for one in self.contradicted),
                          *(('fact_unsure', one) for one in self.doubted)):
            if self.trusted:
                found.append(Finding('fact_trusted', **one.values))
                continue
            # what is no more than doubtful, the sigma that was stated holds already
            if kind == 'fact_doubtful' or not one.has_sigma:
                shift = one.shift * estimated
                wider = wider + np.outer(shift, shift)
            found.append(Finding(kind, **one.values))
        told: dict[str, Finding] = {}
        left_open: dict[str, Finding] = {}
        for fact, unknown, error, shift, is_whole in self.unchecked:
            # a parameter that is held has no sigma that could hold the whole of such an error
            if is_whole and unknown in MATRIX_PARAMETERS and not estimated[names.index(unknown)]:
                left_open[fact] = Finding('fact_open', fact=fact, unknown=unknown, error=error)
            ratio = _in_sigmas(shift, wider)
            place = int(np.argmax(ratio))
            beyond = float(ratio[place])
            if beyond > max(SILENT_SIGMAS, told[fact].values['sigmas'] if fact in told else 0):
                told[fact] = Finding('fact_unchecked', fact=fact, unknown=unknown, error=error,
                                     name=names[place], change=float(abs(shift[place])),
                                     sigmas=beyond, moves=[names[one] for one in np.flatnonzero(
                                         ratio > SILENT_SIGMAS)])
        if not self.trusted:
            found += told.values()
            found += (one for fact, one in left_open.items() if fact not in told)
        return wider, tuple(found)


def _in_sigmas(shift: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Shifts (5,) of the parameters of K over their sigmas; held ones do not count."""
    count = len(MATRIX_PARAMETERS)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0))[:count]
    ratio: np.ndarray = np.where(
        sigma > 0, np.abs(shift[:count]) / np.maximum(sigma, 1e-300), 0.0)
    return ratio


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
