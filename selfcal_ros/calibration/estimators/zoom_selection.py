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
Is the focal length constant, does it grow steadily, or does every view have its own?

The simplest that the images allow: constant unless they contradict at four sigmas, steady growth
(one unknown) unless a random walk is more probable. The walk's size follows from the images.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, fit_robustly, Observations,
                                                       refit, RobustFit, with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.zoom import Zoom, ZoomModel
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.uncertainty.cluster_covariance import robust_covariance_of
from selfcal_ros.calibration.uncertainty.focal_course import (focal_evidence, FocalEvidence,
                                                              gain_of_most, gains_of_tracks,
                                                              shape_gain, SURE)
from selfcal_ros.geometry.camera_facts import CameraFacts

#: While starts are compared: change of log f from view to view.
START_SIGMA = 0.03
#: The same for all views where a stretch of them is constant.
STILL_SIGMA = 3e-4
#: Share of the tracks that a zoom may not rest on: what is left is fitted again.
FEW = 0.05
#: Rounds in which the size of the walk settles, and the change of its log that ends them.
ROUNDS, SETTLED = 3, 0.4


def may_vary(problem: SelfCalibrationProblem) -> bool:
    """Tell whether it is open if the focal length varies, and constant so far."""
    return (problem.facts.focal == 'auto' and problem.motion.zoom is None
            and bool(problem.instants))


def may_zoom(problem: SelfCalibrationProblem) -> bool:
    """Tell whether a focal length that varies is to be tried: of still tracks alone it is not."""
    return may_vary(problem) and not problem.of_still


def contradicted(fit: RobustFit, problem: SelfCalibrationProblem) -> bool:
    """Tell whether the images contradict a constant focal length that is supposed or stated."""
    stated = problem.facts.focal == 'constant' and not problem.facts.trusted
    if not (may_vary(problem) or stated and problem.instants):
        return False
    found = _variation(fit, problem.instants, problem.size)
    if found is None or not problem.of_still and found.sigma == 0:
        return found is not None
    # what moves and is not found, and gross errors, ask for a zoom in single views
    rest = _without_few(fit, problem.instants, found)
    return rest is None or seems_to_vary(rest, problem.instants, problem.size)


def zoomed_fit(fit: RobustFit, instants: tuple[float, ...]) -> RobustFit:
    """Fit the same observations with a focal length that varies from view to view."""
    state = replace(fit.state, zoom=Zoom.constant(len(instants)))
    return refit(fit, replace(fit.motion, zoom=ZoomModel(instants, START_SIGMA)), state)


def _without_few(fit: RobustFit, instants: tuple[float, ...],
                 found: FocalEvidence) -> RobustFit | None:
    """Fit again without the few tracks that say most for a focal length that varies."""
    gain = gains_of_tracks(fit, instants, found)
    most = np.argsort(gain)[len(gain) - int(np.ceil(FEW * len(gain))):]
    rest, points = fit.observations.select(~np.isin(fit.observations.point, most))
    if len(np.unique(rest.view)) < len(fit.state.path):
        return None
    state = replace(fit.state, points=fit.state.points[points])
    return fit_robustly(rest, state, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)


def zooming(problem: SelfCalibrationProblem) -> SelfCalibrationProblem:
    """Let the focal length vary from view to view."""
    zoom = ZoomModel(problem.instants, START_SIGMA)
    return replace(problem, motion=replace(problem.motion, zoom=zoom))


def seems_to_vary(fit: RobustFit, instants: tuple[float, ...], size: tuple[int, int]) -> bool:
    """Test whether the images contradict a constant focal length."""
    return _variation(fit, instants, size) is not None


def _variation(fit: RobustFit, instants: tuple[float, ...],
               size: tuple[int, int]) -> FocalEvidence | None:
    """Return what contradicts a constant focal length; None where nothing does."""
    variance_inflation = robust_covariance_of(fit, size).variance_inflation
    found = focal_evidence(fit, instants, variance_inflation)
    if (found is None or not _is_zoom(found, fit, variance_inflation)
            or gain_of_most(fit, instants, found, variance_inflation) <= SURE):
        return None
    return found


def _is_zoom(found: FocalEvidence, fit: RobustFit, variance_inflation: float) -> bool:
    """Tell whether images differ in scale, and in no other shape as probably."""
    return found.varies and found.gain > shape_gain(fit, variance_inflation)


def near_state(near: RobustFit, observations: Observations) -> SceneState | None:
    """Return the state of a fit as if nothing but the camera had moved; with all points."""
    return with_all_points(undisturbed(near.state), observations)


def undisturbed(state: SceneState) -> SceneState:
    """
    Return a state without what rows and shifts do to single images.

    A fit that has not these unknowns would hold them where they are, as if they were known.
    """
    return replace(state, line_delay=0.0, row_motion=None, shift=None)


def nearer(one: RobustFit, other: RobustFit, observations: Observations) -> RobustFit:
    """Choose the fit that explains all observations better, also those that it has dropped."""
    sigma_px = min(one.bundle.sigma_px, other.bundle.sigma_px)
    costs = []
    for fit in (one, other):
        state = with_all_points(fit.state, observations)
        bundle = bundle_of(observations, fit.motion, fit.bundle.priors, sigma_px)
        costs.append(np.inf if state is None else bundle.cost(bundle.refine_points(state)))
    return one if costs[0] <= costs[1] else other


def settle_zoom(fit: RobustFit, facts: CameraFacts, size: tuple[int, int]) -> RobustFit:
    """
    Choose how the focal length varies, and fit it so.

    Parameters
    ----------
    fit : RobustFit
        With a focal length that varies.
    facts : CameraFacts
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    RobustFit
        Of constant focal length where the images do not contradict that, and no fact does.

    """
    for _ in range(ROUNDS):
        before = fit.motion.zoom
        assert before is not None
        variance_inflation = robust_covariance_of(fit, size).variance_inflation
        found = focal_evidence(fit, before.instants, variance_inflation)
        if found is None:
            break
        if facts.focal == 'auto' and not _is_zoom(found, fit, variance_inflation):
            still = replace(fit.state, zoom=None)
            return refit(fit, replace(fit.motion, zoom=None), still)
        zoom = replace(before, sigma=found.sigma)
        if zoom.sigma == before.sigma:
            break
        state = fit.state
        if zoom.is_steady and state.zoom is not None:
            state = replace(state, zoom=Zoom(zoom.rate_of(state.zoom.log_focal) * zoom.course))
        fit = refit(fit, replace(fit.motion, zoom=zoom), state)
        if zoom.is_steady or not before.is_steady and abs(
                np.log(zoom.sigma / before.sigma)) < SETTLED:
            break
    return fit


def over_all(zoom: ZoomModel | None, problem: SelfCalibrationProblem) -> ZoomModel | None:
    """Let all views vary as some of them do; a little, where those do not and all may."""
    if zoom is None:
        return problem.motion.zoom and replace(problem.motion.zoom, sigma=STILL_SIGMA)
    return replace(zoom, instants=problem.instants)
