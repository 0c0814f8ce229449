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
"""Decisions on a share of the tracks: which distortion, how planar, how dependent the errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import to_parameters
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, choose_distortion, choose_motion,
                                                       Fit, fit_robustly, Observations, refit)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.motion_class import DOUBTFUL_ROTATION_RAD, largest_turn_rad
from selfcal_ros.calibration.initialisation.problem import Problem, start_priors
from selfcal_ros.calibration.observability import parameter_status
from selfcal_ros.calibration.uncertainty.cluster_covariance import (assess_dependence, Dependence,
                                                                    stretch_excess)
from selfcal_ros.calibration.uncertainty.group_jackknife import leave_out_stretches
from selfcal_ros.calibration.uncertainty.profile_likelihood import follow_valley
from selfcal_ros.calibration.uncertainty.second_order import bend_excess
from selfcal_ros.geometry.camera import CameraFacts
from selfcal_ros.geometry.rotation import rotation_vector


@dataclass(frozen=True)
class Model:
    """
    What was decided on a share of the tracks.

    Attributes
    ----------
    fit : Fit
    facts : CameraFacts
        The distortion model chosen.
    exact : bool
        Whether the motion is exactly planar.
    stretches : (float, ndarray of shape (k, k))
        Of `stretch_excess`.
    valley : ndarray, shape (k, k)
        Covariance of the internal parameters beyond that from the curvature at the optimum.
    turned : bool
        Whether the images show a rotation.
    share : float
        Of all observations that the fit uses.

    """

    fit: Fit
    facts: CameraFacts
    exact: bool
    stretches: tuple[float, np.ndarray]
    valley: np.ndarray
    turned: bool
    share: float


def first_fit(problem: Problem, observations: Observations, state: SceneState) -> Fit:
    """Fit a share of the tracks with soft priors, the models still open."""
    return fit_robustly(observations, state, problem.motion, start_priors(problem),
                        1.5 * problem.noise_px)


def choose_model(problem: Problem, fit: Fit, share: float) -> Model:
    """
    Choose the distortion model, if the facts leave it open, and how planar motion is.

    Parameters
    ----------
    problem : Problem
    fit : Fit
        Of a share of the tracks.
    share : float
        That share.

    Returns
    -------
    Model

    """
    facts = problem.facts
    if facts.distortion == 'auto':
        dependence = dependence_of(fit, problem.size).inflation**2

        def determined(trial: Fit, trial_facts: CameraFacts) -> bool:
            covariance = dependence * to_parameters(trial.covariance, trial.state.lens)
            status = parameter_status(trial.state.camera(*problem.size), covariance, trial_facts)
            return 'unobservable' not in status.values()

        fit, facts = choose_distortion(fit, facts, determined)
    else:
        fit = replace(fit, bundle=bundle_of(fit.observations, fit.motion,
                                            priors_from_facts(facts), fit.bundle.sigma_px))
        fit = refit(fit, fit.motion)
    known = dependence_of(fit, problem.size).inflation**2
    exact = False
    if problem.motion.keeps_plane:
        fit, exact = choose_motion(fit, known)
    turned = True
    if largest_turn_rad(fit.state.path, problem.motion.keeps_plane) < DOUBTFUL_ROTATION_RAD:
        every = tuple(range(len(fit.state.path)))
        turned = hold_parallel(fit, every, problem.size)[1] > 0
    fit, valley = follow_valley(fit, problem.size, share)
    valley = valley + bend_excess(fit, problem.size, share * known) / known
    shared = stretch_excess(*leave_out_stretches(fit), fit.lens_covariance, known)
    return Model(fit, facts, exact, shared, valley, turned, share)


def hold_parallel(fit: Fit, parallel: tuple[int, ...], size: tuple[int, int]) -> tuple[Fit, float]:
    """
    Give views that are stated to be parallel one orientation, unless the images contradict.

    A likelihood ratio test at 4 sigma, as for the plane of motion.

    Returns
    -------
    Fit
        As it was where the images contradict.
    float
        Largest angle between such a view and the first of them, radians; zero where the images
        do not contradict.

    """
    motion = replace(fit.motion, parallel=parallel)
    held = refit(fit, motion, replace(fit.state, path=fit.state.path.aligned(motion)))
    freedom = 3 * (len(parallel) - 1)
    excess = 2 * (held.cost - fit.cost) / dependence_of(fit, size).inflation**2
    if excess <= freedom + 4 * np.sqrt(2 * freedom):
        return held, 0.0
    R = fit.state.path.rotations()[list(parallel)]
    return fit, float(np.linalg.norm(rotation_vector(R @ R[0].T), axis=1).max())


def dependence_of(fit: Fit, size: tuple[int, int]) -> Dependence:
    """Assess how far the residuals of a fit are from independent."""
    return assess_dependence(fit.information, fit.observations.point, fit.observations.xy, size)
