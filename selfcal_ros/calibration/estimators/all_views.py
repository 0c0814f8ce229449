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
"""Extend an estimate from some of the views and tracks to all of them, and assess the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.deleted_tracks import without_hidden_errors
from selfcal_ros.calibration.bundle.depths import seen_ahead
from selfcal_ros.calibration.bundle.priors import with_fixed
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, fit_robustly, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_GO_ON
from selfcal_ros.calibration.estimators.acceptance import assess
from selfcal_ros.calibration.estimators.lens_selection import gentle_lens, with_lens
from selfcal_ros.calibration.estimators.model_selection import ModelDecision
from selfcal_ros.calibration.estimators.zoom_selection import contradicted, over_all, settle_zoom
from selfcal_ros.calibration.initialisation.continued_path import continued_path
from selfcal_ros.calibration.initialisation.multi_start import START_TRACKS_PER_VIEW
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate

#: Refusal of a focal length that varies.
NOT_CONSTANT = 'focal_not_constant'


def extend(problem: SelfCalibrationProblem, model: ModelDecision) -> SceneState | NoEstimate:
    """Start for all views and tracks from what was found on a fraction of them."""
    found = model.fit.state
    folded = NoEstimate('distortion_not_invertible', model=model.facts.distortion)
    if len(found.path) == problem.views:
        return with_all_points(found, problem.observations) or folded
    few = problem.observations.longest(START_TRACKS_PER_VIEW)
    # the rows' displacements are found once there is a path
    few = replace(few, shutter=None)
    lens, priors = gentle_lens(model.fit, problem.facts, problem.size)
    bundle = bundle_of(few, problem.motion, priors, 10 * problem.noise_px)
    camera = replace(found, lens=lens).camera()
    # chains of pairs drift in scale, and what was fitted does not
    path = None if problem.pivot is not None else continued_path(
        problem, replace(found, lens=lens), problem.first_fitted, START_TRACKS_PER_VIEW,
        model.exact)
    continued = None if path is None else with_all_points(SceneState(lens, path), few)
    standing = (problem.starts(bundle.blocks, few.xy, camera) if continued is None else
                [continued])
    if model.exact:
        standing = [replace(state, path=state.path.flat()) for state in standing]
    costs = [bundle.cost(state) for state in standing]
    if not np.isfinite(min(costs, default=np.inf)):
        return folded
    state = with_fixed(standing[int(np.argmin(costs))], bundle.priors)
    state = replace(state, path=state.path.aligned(problem.motion))
    state = bundle.optimise(state, iterations=15, tolerance=TO_GO_ON)
    whole = with_all_points(replace(state, line_delay=found.line_delay), problem.observations)
    if whole is None:
        return folded
    return with_lens(whole, problem.observations.xy, problem.facts.distortion)


def settled(problem: SelfCalibrationProblem, model: ModelDecision) -> SelfCalibrationProblem:
    """Return the problem under the models that were chosen on some of its views."""
    # what the window's motion was found to be, and of all views which are parallel
    motion = model.fit.motion
    if motion.parallel:
        motion = problem.motion.with_images_of(motion)
    motion = replace(motion, zoom=over_all(motion.zoom, problem))
    problem = replace(problem, facts=model.facts, motion=motion,
                      first_fitted=problem.first_of_window(len(model.fit.state.path)))
    if model.fit.observations.shutter is not None:
        observations, clock = problem.observations, model.fit.observations.clock
        if clock is not None and observations.clock is not None:
            observations = replace(observations, clock=observations.clock.read_as(clock))
        observations = observations.read_like(model.fit.observations.shutter).surely_timed()
        problem = replace(problem, observations=observations)
    return problem


def fit_all(problem: SelfCalibrationProblem, model: ModelDecision) -> RobustFit | NoEstimate:
    """
    Estimate from all views and tracks under the models that were chosen.

    Parameters
    ----------
    problem : SelfCalibrationProblem
        As `settled` returns it.
    model : ModelDecision

    """
    extended = extend(problem, model)
    if isinstance(extended, NoEstimate):
        return extended.saying(facts=problem.facts)
    fit = fit_robustly(problem.observations, extended, problem.motion, model.fit.bundle.priors,
                       model.fit.bundle.sigma_px)
    if contradicted(fit, problem):
        return NoEstimate(NOT_CONSTANT)
    if fit.motion.zoom is not None:
        fit = settle_zoom(fit, problem.facts, problem.size)
    fit = without_hidden_errors(fit)
    return seen_ahead(fit) if problem.is_weak else fit


def finish(problem: SelfCalibrationProblem, model: ModelDecision, graph: ViewGraph,
           stated: CameraFacts) -> Calibration | NoEstimate:
    """Estimate as `fit_all` does, and judge by the facts as the user stated them."""
    fit = fit_all(problem, model)
    return fit if isinstance(fit, NoEstimate) else assess(fit, model, problem, graph, stated)
