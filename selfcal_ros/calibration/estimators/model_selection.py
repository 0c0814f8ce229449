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
"""Decisions on some of the tracks: which distortion, how planar, how dependent the errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import to_parameters
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.plane_of_motion import choose_motion, out_of_plane
from selfcal_ros.calibration.bundle.priors import Priors
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, DEVIATIONS_OF_CHANCE,
                                                       fit_robustly, is_chance, Observations,
                                                       refit, RobustFit, with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_COMPARE
from selfcal_ros.calibration.estimators.lens_selection import (choose_lens, lens_priors,
                                                               LensDecision, REGULARISED,
                                                               with_lens)
from selfcal_ros.calibration.estimators.motion_class import DOUBTFUL_ROTATION_RAD, largest_turn_rad
from selfcal_ros.calibration.initialisation.problem import (SelfCalibrationProblem, start_priors,
                                                            usual_matrix)
from selfcal_ros.calibration.observability import LEAST_NOISE_PX, parameter_status
from selfcal_ros.calibration.uncertainty.cluster_covariance import robust_covariance_of
from selfcal_ros.calibration.uncertainty.group_jackknife import segment_excess
from selfcal_ros.calibration.uncertainty.profile_likelihood import (profile_likelihood_excess,
                                                                    PROFILED_FRACTION)
from selfcal_ros.calibration.uncertainty.second_order import second_order_covariance
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES, LensChoice
from selfcal_ros.geometry.rotation import rotation_vector

#: A motion leaves the plane by far more than supposed: so many times the sigma.
STRAINED = 2.0
#: Fewer views show a plane by four measurements, and as many unknowns of a camera make one of any
#: path. So many standard deviations of chance are enough to doubt it: free motion tells as much.
VIEWS_OF_A_PLANE, DOUBT_OF_FEW = 4, 2.0


@dataclass(frozen=True)
class ModelDecision:
    """
    What was decided on a fraction of the tracks.

    Attributes
    ----------
    fit : RobustFit
    facts : CameraFacts
        The distortion model chosen.
    exact : bool
        Whether the motion is exactly planar.
    jackknife : (float, ndarray of shape (k, k))
        Of `segment_excess`.
    profile_excess : ndarray, shape (k, k)
        Covariance of the internal parameters beyond that from the curvature at the optimum.
    turned : bool
        Whether the images show a rotation.
    fraction : float
        Of all observations that the fit uses.
    delay_excess : ndarray, shape (k, k), or 0
        Covariance that a line delay adds which was not estimated. The errors that the images show
        are in it as they are: no inflation applies.

    """

    fit: RobustFit
    facts: CameraFacts
    exact: bool
    jackknife: tuple[float, np.ndarray]
    profile_excess: np.ndarray
    turned: bool
    fraction: float
    delay_excess: np.ndarray | float = 0.0

    def covariance_of_choices(self, variance_inflation: float) -> np.ndarray:
        """
        Return what all choices add to the covariance (k, k) of the internal parameters.

        Parameters
        ----------
        variance_inflation : float
            Variance of the estimate over that with independent errors.

        Returns
        -------
        ndarray, shape (k, k)

        """
        added: np.ndarray = self.profile_excess * variance_inflation + self.delay_excess
        return added


def first_fit(problem: SelfCalibrationProblem, observations: Observations, state: SceneState,
              ) -> RobustFit:
    """Fit a fraction of the tracks with soft priors, the models still open."""
    state, priors = with_open_lens(problem, observations, state)
    return fit_robustly(observations, state, problem.motion, priors, 1.5 * problem.noise_px)


def with_open_lens(problem: SelfCalibrationProblem, observations: Observations,
                   state: SceneState) -> tuple[SceneState, Priors]:
    """
    Open what a lens may do: all that those of its family do, or what the facts state.

    Parameters
    ----------
    problem : SelfCalibrationProblem
    observations : Observations
    state : SceneState

    Returns
    -------
    SceneState
        With that lens.
    Priors
        What is known of such lenses, and what most cameras have.

    """
    facts = problem.facts
    stated = LENS_CHOICES.get(facts.distortion)
    if stated is None or stated[0] is not state.lens.model:
        family: LensChoice = 'plumb_bob' if state.lens.model.is_perspective else 'equidistant'
        facts = replace(facts, distortion=family)
        state = with_lens(state, observations.xy, family)
    priors = start_priors(problem, state.camera())
    if facts.distortion in REGULARISED:
        known = replace(facts, lens_population=True)
        priors = lens_priors(known, problem.size, state.lens['f']).under(usual_matrix(problem))
    return state, priors


def as_uneven_as_told(fit: RobustFit, tried: Observations) -> RobustFit:
    """
    Widen what a vehicle may leave the plane by, where the images contradict it.

    The usual unevenness of a ground is soft. Where a camera leaves the plane by far more, single
    views or the focal length would pay for it, and be taken for something else.

    Parameters
    ----------
    fit : RobustFit
        Of the usual unevenness.
    tried : Observations
        That the fit began with.

    """
    for _ in range(3):
        motion = fit.motion
        if not motion.keeps_plane or not motion.tilt_sigma_rad:
            break
        tilt, height = out_of_plane(fit)
        if tilt < STRAINED * motion.tilt_sigma_rad and height < STRAINED * motion.height_sigma:
            break
        wider = replace(motion, tilt_sigma_rad=max(tilt, motion.tilt_sigma_rad),
                        height_sigma=max(height, motion.height_sigma))
        start = with_all_points(fit.state, tried)
        if start is None:
            break
        fit = fit_robustly(tried, start, wider, fit.bundle.priors, fit.bundle.sigma_px)
    return fit


def choose_model(problem: SelfCalibrationProblem, fit: RobustFit, fraction: float,
                 ) -> ModelDecision:
    """
    Choose the distortion model, if the facts leave it open, and how planar motion is.

    Parameters
    ----------
    problem : SelfCalibrationProblem
    fit : RobustFit
        Of a fraction of the tracks.
    fraction : float
        That fraction.

    Returns
    -------
    ModelDecision

    """
    lens = _chosen_lens(problem, fit)
    fit, facts = lens.fit, lens.facts
    variance_inflation = robust_covariance_of(fit, problem.size).variance_inflation
    exact = False
    if problem.motion.keeps_plane:
        fit, exact = choose_motion(fit, variance_inflation)
    turned = True
    if largest_turn_rad(fit.state.path, problem.motion.keeps_plane) < DOUBTFUL_ROTATION_RAD:
        every = tuple(range(len(fit.state.path)))
        turned = hold_parallel(fit, every, problem.size)[1] > 0
    # beside a large rotation a short lever leaves a valley, steep wherever the optimum is wrong
    fit, profile_excess = profile_likelihood_excess(
        fit, problem.size, fraction, 0.0 if problem.is_weak else PROFILED_FRACTION)
    curved = second_order_covariance(fit, problem.size, fraction * variance_inflation)
    profile_excess = profile_excess + (curved + lens.excess) / variance_inflation
    shared = segment_excess(fit, variance_inflation)
    return ModelDecision(fit, facts, exact, shared, profile_excess, turned, fraction)


def _chosen_lens(problem: SelfCalibrationProblem, fit: RobustFit) -> LensDecision:
    """Choose the distortion model, if the facts leave it open; see `choose_lens`."""
    variance_inflation = robust_covariance_of(fit, problem.size).variance_inflation

    def variance_inflation_of(trial: RobustFit) -> float:
        return (variance_inflation if trial is fit
                else robust_covariance_of(trial, problem.size).variance_inflation)

    def determined(trial: RobustFit, trial_facts: CameraFacts) -> bool:
        covariance = variance_inflation * to_parameters(trial.covariance, trial.state.lens)
        status = parameter_status(trial.state.camera(*problem.size), covariance, trial_facts,
                                  trial.bundle.sigma_px)
        return 'unobservable' not in status.values()

    return choose_lens(fit, problem.facts, problem.size, variance_inflation_of, determined)


def leaves_plane(model: ModelDecision, tried: Observations, size: tuple[int, int]) -> bool:
    """
    Tell whether the images prefer a motion that leaves the plane freely, beyond chance.

    Where the camera turns little, the usual unevenness of the ground is large beside it. A plane
    that nobody stated then explains the images by many outliers, more noise and another focal
    length.

    Parameters
    ----------
    model : ModelDecision
        Of planar motion.
    tried : Observations
        All that the fit was offered, those that it rejects too.
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    bool

    """
    fit = model.fit
    motion = replace(GENERAL.with_images_of(fit.motion), parallel=fit.motion.parallel)
    if fit.observations.shutter is not None:
        tried = fit.observations
    start = with_all_points(fit.state, tried)
    # what leaves less than any image's noise leaves no doubt
    if start is None or fit.bundle.sigma_px < LEAST_NOISE_PX:
        return False
    free = fit_robustly(tried, start, motion, fit.bundle.priors, fit.bundle.sigma_px)
    # both of the same observations: a threshold that a few of them cross would decide
    start = with_all_points(fit.state, free.observations)
    if start is None:
        return False
    bundle = bundle_of(free.observations, fit.motion, fit.bundle.priors, free.bundle.sigma_px)
    held = bundle.optimise(bundle.refine_points(start), iterations=40, tolerance=TO_COMPARE)
    excess = (2 * (bundle.cost(held) - free.cost)
              / robust_covariance_of(free, size).variance_inflation)
    views = len(fit.state.path)
    # three a view, but for the first, and the plane itself has two
    freedom = 3 * views - 5
    doubt = DOUBT_OF_FEW if views < VIEWS_OF_A_PLANE else DEVIATIONS_OF_CHANCE
    return not is_chance(excess, freedom, doubt)


def hold_parallel(fit: RobustFit, parallel: tuple[int, ...], size: tuple[int, int],
                  ) -> tuple[RobustFit, float]:
    """
    Give views that are stated to be parallel one orientation, unless the images contradict.

    A likelihood ratio test at 4 sigma, as for the plane of motion.

    Returns
    -------
    RobustFit
        As it was where the images contradict.
    float
        Largest angle between such a view and the first of them, radians; zero where the images
        do not contradict.

    """
    motion = replace(fit.motion, parallel=parallel)
    held = refit(fit, motion, replace(fit.state, path=fit.state.path.aligned(motion)))
    freedom = 3 * (len(parallel) - 1)
    excess = 2 * (held.cost - fit.cost) / robust_covariance_of(fit, size).variance_inflation
    if is_chance(excess, freedom):
        return held, 0.0
    R = fit.state.path.rotations()[list(parallel)]
    return fit, float(np.linalg.norm(rotation_vector(R @ R[0].T), axis=1).max())
