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
The prior over real lenses, combined anew with images whose errors are correlated.

The adjustment weighs what is known beforehand as if every observation erred by itself. Where
tracks, regions or stretches of the way share errors, the images know less than that. A lens that
nobody ever built would explain what the images share. Once those errors are known, the images
alone are one measurement of the lens, and what is known beforehand another. Both are put together
anew, each by its covariance:

    P' = D⁻¹ + P,    x' = P'⁻¹ (D⁻¹ d + P m)

d and D are what the images say by themselves, m and P⁻¹ what was known. No adjustment of the
images alone is needed: it need not have an optimum. D⁻¹ and D⁻¹ d follow from the estimate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.priors import Prior
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_COMPARE
from selfcal_ros.geometry.scaled_inverse import unit_diagonal

#: Estimates that move by less than this share of their sigmas stay.
LEAST_SHIFT = 0.02
#: Least variance of what is left of a covariance, of its own, against rounding.
LEAST_VARIANCE = 1e-10
#: Of path and points at most, once the lens has moved.
ITERATIONS = 15


@dataclass(frozen=True)
class LensPosterior:
    """
    An estimate with what is known beforehand weighed anew.

    Attributes
    ----------
    state : SceneState
        Path and points are those that fit the lens best.
    covariance : ndarray, shape (k, k)
        Of the unknowns of the lens block.
    residual : ndarray, shape (N, 2)
        What remains, pixels; NaN behind the camera.

    """

    state: SceneState
    covariance: np.ndarray
    residual: np.ndarray


def lens_posterior(fit: RobustFit, state: SceneState, covariance: np.ndarray,
                   residual: np.ndarray, prior_share: float = 1.0) -> LensPosterior | None:
    """
    Weigh what is known of a lens beforehand by what the images' errors are found to be.

    Parameters
    ----------
    fit : RobustFit
        At its optimum, where errors count as independent.
    state : SceneState
        The estimate: that optimum, or with deviations of the lens allowed for.
    covariance : ndarray, shape (k, k)
        Of the unknowns of the lens block, shared errors included.
    residual : ndarray, shape (N, 2)
        What that estimate leaves, deviations of the lens allowed for, pixels.
    prior_share : float
        How often the covariance holds what is known beforehand: more than once where both were
        weighed down alike.

    Returns
    -------
    LensPosterior or None
        None where nothing is known of such lenses, or nothing changes.

    """
    lens, priors = fit.bundle.unknowns.lens, fit.bundle.priors
    free = np.flatnonzero(fit.bundle.unknowns.free[lens])
    sigma = np.sqrt(np.maximum(np.diag(covariance)[free], 0))
    if priors.population is None or not (np.isfinite(sigma) & (sigma > 0)).all():
        return None
    square, scale = np.ix_(free, free), np.outer(sigma, sigma)
    known, pull = _known_beforehand(fit, state)
    try:
        step, after = _weighed_anew(fit.lens_covariance[square] / scale,
                                    fit.bundle.loss_factors(fit.linearisation)[0],
                                    covariance[square] / scale, prior_share,
                                    known[square] * scale,
                                    pull[free] * sigma)
    except np.linalg.LinAlgError:
        # the images leave something of the camera open, which is told elsewhere
        return None
    if not np.abs(step).max() > LEAST_SHIFT:
        return None
    change, widened = np.zeros(len(state.lens.values)), covariance.copy()
    change[free], widened[square] = step * sigma, after * scale
    found = moved_lens(fit, state, change, residual)
    return found and LensPosterior(found[0], widened, found[1])


def _weighed_anew(independent: np.ndarray, factor: float, covariance: np.ndarray,
                  prior_share: float, P: np.ndarray, pull: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Put the images and what is known beforehand together anew.

    Parameters
    ----------
    independent : ndarray, shape (k, k)
        Covariance of the estimate for independent errors, that of the robust loss times `factor`.
    factor : float
    covariance : ndarray, shape (k, k)
        The same with all errors.
    prior_share : float
        See `lens_posterior`.
    P : ndarray, shape (k, k)
        Information that was known beforehand.
    pull : ndarray, shape (k,)
        P (x - m) at the estimate x.

    Returns
    -------
    step : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)

    """
    # what independent errors would tell; nothing along what the images do not show
    H = _at_least(factor * np.linalg.pinv(independent, hermitian=True) - P, 0.0)
    C = np.linalg.inv(_at_least(H + P, LEAST_VARIANCE))
    # D = H⁻¹ C⁻¹ of_images C⁻¹ H⁻¹, without an inverse of H
    of_images = _at_least(covariance - prior_share * factor * C @ P @ C, LEAST_VARIANCE)
    through = C @ H
    of_told = np.linalg.solve(of_images, through)
    after = np.linalg.inv(through.T @ of_told + P)
    # at the estimate H (d - x) = pull
    return -after @ (pull - of_told.T @ C @ pull), after


def _known_beforehand(fit: RobustFit, state: SceneState) -> tuple[np.ndarray, np.ndarray]:
    """Information (k, k) of what is known of the lens, and its pull (k,) at the estimate."""
    priors, lens = fit.bundle.priors, state.lens
    gradient = np.zeros(len(lens.values))
    for name, prior in priors.soft.items():
        gradient[lens.places((name,))] += (lens[name] - prior.value) / prior.sigma**2
    if priors.population is not None:
        gradient += priors.population.terms(*lens.named)[1]
    return priors.soft_information(), gradient


def moved_lens(fit: RobustFit, state: SceneState, step: np.ndarray, residual: np.ndarray,
               ) -> tuple[SceneState, np.ndarray] | None:
    """
    Move the lens by a step (k,), and path and points to where they fit it best.

    To first order alone they would miss by more than the noise: a principal point and a turn of
    the camera that make up for each other are far larger than their sum.
    """
    bundle, information = fit.bundle, fit.information
    lens, covariance = bundle.unknowns.lens, information.covariance
    free = np.flatnonzero(bundle.unknowns.free[lens])
    own, sigma = unit_diagonal(covariance[lens, lens][np.ix_(free, free)])
    along = np.linalg.lstsq(own, step[free] / sigma, rcond=None)[0]
    every = covariance[:, lens][:, free] @ (along / sigma)
    every[lens] = step
    system = information.system
    moved = bundle.moved(state, every, system.point_steps(every, np.zeros_like(system.half_b)))
    if not moved.lens.is_possible:
        return None
    # what deviations of the lens explain is none of the path's
    beside = np.nan_to_num(residual - bundle.residuals(state))
    seen = replace(fit.observations, xy=fit.observations.xy - beside)
    fixed = {name: Prior(moved.lens[name], 0.0) for name in moved.lens.names}
    held = bundle_of(seen, fit.motion, replace(bundle.priors, of=fixed, population=None),
                     bundle.sigma_px)
    if not np.isfinite(held.cost(moved)):
        return None
    moved = held.optimise(moved, iterations=ITERATIONS, tolerance=TO_COMPARE)
    return moved, held.residuals(moved)


def _at_least(matrix: np.ndarray, least: float) -> np.ndarray:
    """Return the nearest symmetric matrix whose eigenvalues are no less than this."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    nearest: np.ndarray = (vectors * np.maximum(values, least)) @ vectors.T
    return nearest
