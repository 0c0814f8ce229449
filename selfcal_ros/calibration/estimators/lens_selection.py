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
Which lens: the family, and how much of it the images have to tell.

The richest member of a family is fitted, with what real lenses are like as one more measurement
(`geometry.lenses.population`). What the images do not determine then stays where lenses usually
are, with the sigma of lenses: nothing that a lens may do is left out in silence. Families are
compared by their evidence (Laplace's approximation; MacKay 2003, chapter 28).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, MATRIX_NAMES
from selfcal_ros.calibration.bundle.priors import (ORDINARY_DECENTRING, population_of, Prior,
                                                   Priors, priors_from_facts, with_fixed)
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_COMPARE
from selfcal_ros.calibration.initialisation.supposed_lens import WIDEST_PERSPECTIVE
from selfcal_ros.calibration.uncertainty.hidden_decentring import (decentred_lens, DecentredLens,
                                                                   DECENTRING, likely_decentring)
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES, LensChoice
from selfcal_ros.geometry.lenses.model import fitted_coefficients

#: Members that are tried when the richest of a family leaves the camera open.
POORER: dict[LensChoice, tuple[LensChoice, ...]] = {
    'plumb_bob': ('radial2', 'radial1', 'none'), 'equidistant': (), 'rational': ()}
#: Lenses whose coefficients are weighed with those of real lenses.
REGULARISED = ('plumb_bob', 'rational', 'equidistant')
#: A barrel that moves the image's corner by less than this fraction of its distance is no
#: fisheye's, and the other family is not tried.
BARREL = 0.12
#: Higher terms that move it by more than this fraction may stand for another model.
BENT = 0.1
#: Where the corner lies further from the axis, in focal lengths, a polynomial is hardly the whole
#: lens even without a barrel. A fisheye usually has one; not every measured lens has.
WIDE_CORNER = 1.0
#: Terms of the simplest rational lens.
SIMPLE_RATIONAL = ('k1', 'k2', 'k3', 'k4')
#: Log of the odds beyond which a family is certain: 400 to 1.
CERTAIN = 6.0
#: Log of the odds, a million to 1, from which a fisheye is chosen for its decentring. Its model
#: has no terms for that: else a rival that has them gives the better image.
BEYOND_DOUBT = 13.8
#: Log of the odds of a family before any image is seen, over those of the others: four fifths of
#: 9810 measured lenses are narrower than 100 degrees, where a polynomial is the usual model.
PRIOR_LOG_ODDS = {'plumb_bob': 1.4}
#: Where a family lowers the cost to less than this share, the lens of the start was wrong, and
#: what it left is no measure of the noise.
WRONG_START = 0.7


@dataclass(frozen=True)
class LensDecision:
    """
    The lens that was chosen.

    Attributes
    ----------
    fit : RobustFit
    facts : CameraFacts
        The lens stated.
    excess : ndarray, shape (k, k)
        Covariance of the lens to be added, since another family explains the images alike.

    """

    fit: RobustFit
    facts: CameraFacts
    excess: np.ndarray


def lens_priors(facts: CameraFacts, size: tuple[int, int], f: float,
                decentring: float | None = None) -> Priors:
    """
    Translate facts to priors, with what such lenses are like.

    Parameters
    ----------
    facts : CameraFacts
        With a lens that is stated.
    size : (int, int)
        Width and height of the image.
    f : float
        About the focal length, pixels.
    decentring : float, optional
        Sigma of p1 and p2 among lenses.

    Returns
    -------
    Priors

    """
    priors = priors_from_facts(facts)
    if not facts.lens_population or facts.distortion not in REGULARISED:
        return priors
    return replace(priors, population=population_of(
        facts.distortion, priors.lens, float(np.hypot(*size)) / 2 / f, decentring))


def choose_lens(fit: RobustFit, facts: CameraFacts, size: tuple[int, int],
                variance_inflation_of: Callable[[RobustFit], float],
                determined: Callable[[RobustFit, CameraFacts], bool],
                decentring: float | None = None) -> LensDecision:
    """
    Choose family and member of the lens on some of the tracks.

    Parameters
    ----------
    fit : RobustFit
        With any lens.
    facts : CameraFacts
        Where it states a lens, that one is fitted.
    size : (int, int)
        Width and height of the image.
    variance_inflation_of : callable
        Variance of the estimate over that with independent errors, of a fit.
    determined : callable
        Whether a fit under facts determines the camera.
    decentring : float, optional
        Sigma of p1 and p2 among lenses; as large as the images suggest by default.

    Returns
    -------
    LensDecision

    """
    variance_inflation = variance_inflation_of(fit)
    if facts.distortion != 'auto':
        found = _fitted(fit, facts, size, variance_inflation, decentring)
        return LensDecision(found, facts, _nothing(found))
    names = _families(fit, size)
    trials = _trials(fit, names, facts, size, variance_inflation, decentring)
    least = min(trials.values(), key=lambda trial: trial.cost)
    if least.cost < WRONG_START * fit.cost:
        fit = replace(least, bundle=least.bundle.with_sigma(least.bundle.noise_sigma(least.state)))
        variance_inflation = variance_inflation_of(fit)
        trials = _trials(fit, names, facts, size, variance_inflation, decentring)
    plain = {name: _evidence(trial, variance_inflation) + PRIOR_LOG_ODDS.get(name, 0.0)
             for name, trial in trials.items()}
    decentred = {name: decentred_lens(trial, variance_inflation) if len(trials) > 1
                 else DecentredLens.none(trial) for name, trial in trials.items()}
    log_odds = {name: plain[name] + decentred[name].gain for name in trials}
    best = max(trials, key=lambda name: max(plain[name], log_odds[name] - BEYOND_DOUBT))
    found, stated, excess = trials[best], replace(facts, distortion=best), None
    if len(trials) > 1:
        excess = _between(found, [(log_odds[best] - log_odds[name], trial, decentred[name])
                                  for name, trial in trials.items() if name != best],
                          variance_inflation)
    for poorer in (None, *POORER[stated.distortion]):
        if poorer is not None:
            stated = replace(stated, distortion=poorer)
            found = _fitted(fit, stated, size, variance_inflation, decentring)
            excess = variance_inflation * of_decentring(found)
        if determined(found, stated):
            break
    return LensDecision(found, stated, _nothing(found) if excess is None else excess)


def _trials(fit: RobustFit, names: tuple[LensChoice, ...], facts: CameraFacts,
            size: tuple[int, int], variance_inflation: float, decentring: float | None,
            ) -> dict[LensChoice, RobustFit]:
    """Fit every family that may have made the images."""
    def fitted(name: LensChoice, start: RobustFit) -> RobustFit:
        return _fitted(start, replace(facts, distortion=name), size, variance_inflation,
                       decentring)

    trials = {name: fitted(name, fit) for name in names}
    if 'rational' in trials:
        # from a polynomial none but polynomials are found: its denominator begins at one
        least = _evidence(trials['rational'], variance_inflation)
        starts = [_with_simple_rational(min(trials.values(), key=lambda trial: trial.cost))]
        if _evidence(trials['equidistant'], variance_inflation) > least:
            starts.append(trials['equidistant'])
        others = [trials['rational'], *(fitted('rational', start) for start in starts)]
        trials['rational'] = max(others, key=lambda trial: _evidence(trial, variance_inflation))
    return trials


def _with_simple_rational(fit: RobustFit) -> RobustFit:
    """Start a rational lens from its simplest denominator: eight terms have several optima."""
    state = with_lens(fit.state, fit.observations.xy, 'rational', SIMPLE_RATIONAL)
    return replace(fit, state=state)


def _nothing(fit: RobustFit) -> np.ndarray:
    return np.zeros((len(fit.state.lens),) * 2)


def _families(fit: RobustFit, size: tuple[int, int]) -> tuple[LensChoice, ...]:
    """Name the families that may have made the images, that of the fit first."""
    lens = fit.state.lens
    if not lens.model.is_perspective:
        return 'equidistant', 'plumb_bob', 'rational'
    if _is_barrel(lens, size) or _corner(lens, size) > WIDE_CORNER or _is_bent(lens, size):
        return 'plumb_bob', 'equidistant', 'rational'
    return ('plumb_bob',)


def _corner(lens: Lens, size: tuple[int, int]) -> float:
    """Distance of the corner of the image from its middle, in focal lengths."""
    return float(np.hypot(*size)) / 2 / float(lens['f'])


def _is_barrel(lens: Lens, size: tuple[int, int]) -> bool:
    return bool(-lens['k1'] * _corner(lens, size)**2 > BARREL)


def _is_bent(lens: Lens, size: tuple[int, int]) -> bool:
    """Tell whether the higher terms of a polynomial move the corner by much."""
    return any(abs(lens[name]) * _corner(lens, size)**power > BENT
               for name, power in (('k2', 4), ('k3', 6)) if name in lens.names)


def gentle_lens(fit: RobustFit, facts: CameraFacts, size: tuple[int, int],
                ) -> tuple[Lens, Priors]:
    """
    Return a lens to begin a path with, and what is known of it.

    At first points lie far outside the image, where the polynomial of a strong barrel throws
    them away and no descent finds back. The nearest equidistant lens does not.
    """
    lens = fit.state.lens
    if not (lens.model.is_perspective and 'k1' in lens.names and _is_barrel(lens, size)):
        return lens, fit.bundle.priors
    found = with_lens(fit.state, fit.observations.xy, 'equidistant').lens
    facts = replace(facts, distortion='equidistant', lens_population=True)
    return found, lens_priors(facts, size, found['f'])


def _fitted(fit: RobustFit, facts: CameraFacts, size: tuple[int, int], variance_inflation: float,
            decentring: float | None) -> RobustFit:
    """Fit a lens to the same observations, decentring as large as the images suggest."""
    state = with_lens(fit.state, fit.observations.xy, facts.distortion)
    priors = lens_priors(facts, size, state.lens['f'], decentring or DECENTRING[-1])
    found = _refitted(fit, state, priors)
    decentred = facts.distortion in ('plumb_bob', 'rational')
    if decentred and priors.population is not None and decentring is None:
        places = found.state.lens.places(('p1', 'p2'))
        variance = variance_inflation * found.lens_covariance[np.ix_(places, places)]
        decentring = likely_decentring(found.state.lens.values[places], variance)
        priors = lens_priors(facts, size, found.state.lens['f'], decentring)
        found = _refitted(fit, found.state, priors)
    return found


def _refitted(fit: RobustFit, state: SceneState, priors: Priors) -> RobustFit:
    bundle = bundle_of(fit.observations, fit.motion, priors, fit.bundle.sigma_px)
    state = bundle.optimise(with_fixed(state, priors), iterations=40, tolerance=TO_COMPARE)
    return replace(fit, bundle=bundle, state=state)


def with_lens(state: SceneState, xy: np.ndarray, name: LensChoice,
              terms: tuple[str, ...] = ()) -> SceneState:
    """
    Return a state with the lens of another model that is nearest to its own at pixels xy.

    With `terms` the others are zero, and a lens of the same model is fitted anew, too.
    """
    model, names = LENS_CHOICES[name]
    lens = state.lens
    if lens.model is model and not terms:
        return state
    camera = lens.camera()
    rays = camera.rays(xy)
    seen = np.isfinite(rays).all(axis=1)
    if model.is_perspective:
        seen &= rays[:, 2] > np.cos(WIDEST_PERSPECTIVE)
    image = camera.pinhole.normalised(xy[seen])
    values = fitted_coefficients(model, terms or names, rays[seen], image)
    return replace(state, lens=Lens(np.r_[lens.values[:len(MATRIX_NAMES)], values], model))


def of_decentring(fit: RobustFit, sigma: float = ORDINARY_DECENTRING) -> np.ndarray:
    """
    Return what decentring that a lens may have, but that is not estimated, adds to a covariance.

    Parameters
    ----------
    fit : RobustFit
        With p1 and p2 held.
    sigma : float
        Of either among lenses.

    Returns
    -------
    ndarray, shape (k, k)
        Zero for what is held.

    """
    loose = fit.bundle.priors.updated({name: Prior(0.0, sigma) for name in ('p1', 'p2')})
    bundle = fit.bundle.with_priors(loose)
    lens, free = bundle.unknowns.lens, fit.bundle.unknowns.free[bundle.unknowns.lens]
    wider = bundle.covariance(fit.state)[lens, lens] - fit.lens_covariance
    values, vectors = np.linalg.eigh(wider * np.outer(free, free))
    excess: np.ndarray = (vectors * np.maximum(values, 0)) @ vectors.T
    return excess * np.outer(free, free)


def _evidence(fit: RobustFit, variance_inflation: float) -> float:
    """Log of the probability of the images under a lens, up to what all lenses share."""
    population = fit.bundle.priors.population
    cost = fit.cost / variance_inflation
    if not np.isfinite(cost):
        return -np.inf
    if population is None:
        return -cost
    places = fit.state.lens.places(population.names)
    after = variance_inflation * fit.lens_covariance[np.ix_(places, places)]
    scale = np.sqrt(np.diag(after))
    log_after = np.linalg.slogdet(after / np.outer(scale, scale))[1] + 2 * np.log(scale).sum()
    return float(-cost + 0.5 * (log_after + np.linalg.slogdet(population.information)[1]))


def _between(fit: RobustFit, others: list[tuple[float, RobustFit, DecentredLens]],
             variance_inflation: float) -> np.ndarray | None:
    """
    Covariance between families that explain the images about alike, and of what only they leave.

    That of the mixture, less that of the fit. The others come with the log of the odds against
    them, and with the decentring that these odds count. None if they are certainly worse.
    """
    rivals = [(np.exp(-log_odds), other, decentred) for log_odds, other, decentred in others
              if log_odds <= CERTAIN]
    if not rivals:
        return None
    total = 1 + sum(odds for odds, *_ in rivals)
    matrix = slice(len(MATRIX_NAMES))
    own = fit.lens_covariance[matrix, matrix]
    excess, wider = _nothing(fit), np.zeros_like(own)
    for odds, other, decentred in rivals:
        apart = ((other.state.lens.values + decentred.shift)[matrix]
                 - fit.state.lens.values[matrix])
        excess[matrix, matrix] += odds / total * np.outer(apart, apart)
        wider += odds / total * (
            variance_inflation * (other.lens_covariance[matrix, matrix] - own)
            + decentred.covariance[matrix, matrix])
    # a rival that determines more does not make this one surer
    values, vectors = np.linalg.eigh(wider)
    excess[matrix, matrix] += (vectors * np.maximum(values, 0)) @ vectors.T
    free = fit.bundle.unknowns.free[:len(excess)]
    return excess * np.outer(free, free)
