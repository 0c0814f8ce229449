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
"""From a start to the maximum-likelihood estimate: outliers, noise level, how planar."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.centres import centres_from_state, points_from_centres
from selfcal_ros.calibration.bundle.information import Evidence
from selfcal_ros.calibration.bundle.inliers import verified
from selfcal_ros.calibration.bundle.reprojection import Linearisation
from selfcal_ros.calibration.bundle.state import (BundleState, holding, MotionModel, Prior,
                                                  priors_from_facts, rescale)
from selfcal_ros.geometry.camera import CameraFacts
from selfcal_ros.geometry.optimise import PointBlocks
from selfcal_ros.values.tracks import of_longest

#: Residuals beyond so many sigmas (in either coordinate's scale) are outliers: one in 3000 of
#: Gaussian residuals.
OUTLIER_SIGMAS = 4.0
#: Fewer outliers than this share of the observations end the search for them.
FEW = 0.003
#: How far a vehicle may leave the plane, before it is told apart from an exact plane: one
#: degree, and two hundredths of the distance between views.
NEARLY_PLANAR = MotionModel(np.radians(1.0), 0.02)
#: Models that are tried when none is stated, the richest first. Tangential distortion is not
#: among them: it trades against the principal point, which planar motion determines weakly enough.
AUTOMATIC_DISTORTION = ('radial2', 'radial1', 'none')
#: Floor of the out-of-plane sigmas that are estimated from the data.
MINIMUM_TILT_RAD, MINIMUM_HEIGHT = 1e-5, 1e-5


@dataclass(frozen=True)
class Observations:
    """
    Observations by index, sorted by point, then view.

    Attributes
    ----------
    view, point : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
        Pixels.
    track : ndarray of int, shape (P,)
        Track identity of each point.

    """

    view: np.ndarray
    point: np.ndarray
    xy: np.ndarray
    track: np.ndarray

    def select(self, mask: np.ndarray, least: int = 2) -> tuple[Observations, np.ndarray]:
        """
        Keep the observations in mask (N,) of points that keep at least so many.

        Returns
        -------
        Observations
        ndarray of int
            Indices of the points that remain.

        """
        counts = np.bincount(self.point[mask], minlength=len(self.track))
        mask = mask & (counts[self.point] >= least)
        points, index = np.unique(self.point[mask], return_inverse=True)
        return Observations(self.view[mask], index, self.xy[mask], self.track[points]), points

    def longest(self, per_view: int) -> np.ndarray:
        """Mark the observations of the longest tracks, so many in every view, shape (N,)."""
        return of_longest(self.view, self.point, per_view)


@dataclass(frozen=True)
class Fit:
    """An optimum, with the problem that it solves and the observations that it explains."""

    bundle: Bundle
    state: BundleState
    observations: Observations
    outliers: int

    @property
    def cost(self) -> float:
        """Robust cost in units of sigma²."""
        return self.bundle.cost(self.state)

    @cached_property
    def line(self) -> Linearisation:
        """Residuals and their derivatives; computed once."""
        return self.bundle.linearise(self.state)

    @cached_property
    def evidence(self) -> Evidence:
        """Covariance, and the influence of every observation; computed once."""
        return self.bundle.evidence(self.state, self.line)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the shared and per-view unknowns for independent noise, (n, n)."""
        return self.evidence.covariance

    def __getstate__(self):
        """Leave out what is computed once: it is large, and can be computed again."""
        return {one.name: getattr(self, one.name) for one in fields(self)}


def with_all_points(state: BundleState, observations: Observations) -> BundleState | None:
    """Intersect the points of all observations from the views and calibration of a state."""
    blocks = PointBlocks(observations.point, observations.view)
    camera = state.camera()
    rays = camera.normalised(observations.xy)
    if not np.isfinite(rays).all():
        return None
    rays = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    directions = np.einsum('nji,nj->ni', state.rotations()[observations.view],
                           rays @ state.mount)
    points = points_from_centres(blocks, directions, centres_from_state(state))
    return replace(state, points=points)


def bundle_of(observations: Observations, motion: MotionModel, priors: dict[int, Prior],
              sigma_px: float) -> Bundle:
    """Set up the adjustment of observations."""
    return Bundle(observations.view, observations.point, observations.xy, motion=motion,
                  priors=priors, sigma_px=sigma_px)


def fit_robustly(observations: Observations, state: BundleState, motion: MotionModel,
                 priors: dict[int, Prior], sigma_px: float, rounds: int = 5) -> Fit:
    """
    Optimise, estimate the noise, drop outliers, and repeat until nothing changes.

    Parameters
    ----------
    observations : Observations
    state : BundleState
        Its points belong to the observations.
    motion : MotionModel
    priors : dict of int to Prior
    sigma_px : float
        First guess of the noise.
    rounds : int

    Returns
    -------
    Fit

    """
    before = len(observations.view)
    for k in range(rounds):
        bundle = bundle_of(observations, motion, priors, sigma_px)
        if k == 0:
            state = bundle.settle_points(state)
        # no finer than the choice of outliers needs
        state = bundle.optimise(state, *((12, 2e-3 * bundle.cost(state)) if k == 0 else (3, 1.0)))
        estimate = bundle.noise_sigma(state)
        if not np.isfinite(estimate):
            break
        distance = np.linalg.norm(bundle.residuals(state), axis=1)
        keep = distance < OUTLIER_SIGMAS * estimate      # NaN, behind the camera: not kept
        settled = abs(estimate / sigma_px - 1) < 0.02 or len(keep) - keep.sum() < FEW * len(keep)
        sigma_px = estimate
        if keep.all():
            if settled:
                break
            continue
        smaller, points = observations.select(keep & verified(observations.point, keep))
        if not len(smaller.view) or len(np.unique(smaller.view)) < len(state.views):
            break
        # what agrees but goes with the rest of its track is no outlier
        before -= int(np.sum(keep & ~verified(observations.point, keep)))
        observations = smaller
        state = replace(state, points=state.points[points])
        if settled:
            break
    bundle = bundle_of(observations, motion, priors, sigma_px)
    state = bundle.optimise(rescale(state), 30, 0.02)
    return Fit(bundle.with_sigma(bundle.noise_rms(state)), state, observations,
               before - len(observations.view))


def out_of_plane(fit: Fit) -> tuple[float, float]:
    """
    Estimate the standard deviations of tilt (rad) and height (per distance between views).

    Empirical Bayes: the mean of the squared estimates and of their variances.
    """
    variance = np.diag(fit.covariance)[11:].reshape(-1, 6)
    tilt = np.sqrt(np.mean(fit.state.views[:, 3:5]**2 + variance[:, 3:5]))
    height = np.sqrt(np.mean(fit.state.views[1:, 5]**2 + variance[1:, 5]))
    return (max(float(tilt), MINIMUM_TILT_RAD),
            max(float(height) / fit.state.step_length(), MINIMUM_HEIGHT))


def flatten(state: BundleState) -> BundleState:
    """Return the state with tilts and heights zero."""
    views = state.views.copy()
    views[:, 3:] = 0
    return replace(state, views=views)


def refit(fit: Fit, motion: MotionModel, state: BundleState | None = None) -> Fit:
    """Optimise the same observations, at the same noise level, under another motion model."""
    bundle = bundle_of(fit.observations, motion, fit.bundle.priors, fit.bundle.sigma_px)
    state = bundle.optimise(fit.state if state is None else state, 40, 0.05)
    return Fit(bundle, state, fit.observations, fit.outliers)


def choose_motion(relaxed: Fit, dependence: float = 1.0) -> tuple[Fit, bool]:
    """
    Decide whether the plane of motion is exact.

    It is when its cost exceeds that of the relaxed motion by no more than the additional
    freedom explains (a likelihood ratio test at 4 sigma). Otherwise the out-of-plane sigmas are
    estimated from the data.

    Parameters
    ----------
    relaxed : Fit
        Of nearly planar motion.
    dependence : float
        Variance of the estimate over that with independent errors; the excess is divided by it.

    Returns
    -------
    fit : Fit
    exact : bool

    """
    exact = refit(relaxed, MotionModel(), flatten(relaxed.state))
    freedom = 3 * len(relaxed.state.views) - 1
    excess = 2 * (exact.cost - relaxed.cost) / dependence
    if excess <= freedom + 4 * np.sqrt(2 * freedom):
        return exact, True
    fit = relaxed
    for _ in range(3):
        before = fit.bundle.motion
        tilt, height = out_of_plane(fit)
        fit = refit(fit, MotionModel(tilt, height))
        if abs(tilt / before.tilt_sigma_rad - 1) < 0.2:
            break
    return fit, False


def choose_distortion(fit: Fit, facts: CameraFacts,
                      determined: Callable[[Fit, CameraFacts], bool]) -> tuple[Fit, CameraFacts]:
    """
    Choose the richest distortion model with which the images still determine the camera.

    The choice rests on the information in the images, not on the values that come out: a model
    chosen because its coefficients look significant has sigmas that are too small.

    Parameters
    ----------
    fit : Fit
    facts : CameraFacts
        Its distortion is 'auto'.
    determined : callable
        Whether a fit under facts determines the camera.

    Returns
    -------
    Fit, CameraFacts
        The latter with the model chosen; the simplest if none determines the camera.

    """
    for name in AUTOMATIC_DISTORTION:
        facts = replace(facts, distortion=name)
        priors = priors_from_facts(facts)
        bundle = bundle_of(fit.observations, fit.bundle.motion, priors, fit.bundle.sigma_px)
        state = bundle.optimise(holding(fit.state, priors), 25, 0.1)
        trial = Fit(bundle, state, fit.observations, fit.outliers)
        if determined(trial, facts):
            break
    return trial, facts
