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
Motion → K: closed-form starts, one maximum-likelihood estimate, and its evidence.

The thesis's chain (fixed points v, i, j, then the pencil of conics; chapters 5 and 6) proposes one
calibration; a sweep over the focal length proposes others. Each proposal is a start for the same
bundle adjustment on a small fraction of the tracks. The best one is finished on all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from selfcal_ros.calibration.bundle.motion import GENERAL, MotionModel, NEARLY_PLANAR
from selfcal_ros.calibration.bundle.robust_fit import Observations, RobustFit, with_all_points
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.acceptance import assess, EXPLAINED
from selfcal_ros.calibration.estimators.all_views import fit_all, NOT_CONSTANT, settled
from selfcal_ros.calibration.estimators.bent_estimate import may_be_bent, unbent_fit
from selfcal_ros.calibration.estimators.coherent_start import straight_and_bent
from selfcal_ros.calibration.estimators.facts_in_the_way import (
    fact_in_the_way, preferred_by_all, without_facts)
from selfcal_ros.calibration.estimators.model_selection import (as_uneven_as_told,
                                                                choose_model, first_fit,
                                                                hold_parallel, leaves_plane,
                                                                ModelDecision)
from selfcal_ros.calibration.estimators.motion_class import (MAX_TILT_RAD, not_planar,
                                                             out_of_plane_rad,
                                                             widest_turn_rad)
from selfcal_ros.calibration.estimators.motion_problem import (MODEL_TRACKS_PER_VIEW,
                                                               of_two_cameras, problem_of)
from selfcal_ros.calibration.estimators.other_starts import likeliest_start
from selfcal_ros.calibration.estimators.parted_tracks import (
    calibrate_coherent_tracks, calibrate_sorted, calibrate_still_tracks, MANY_REJECTED)
from selfcal_ros.calibration.estimators.shutter_choice import (choose_shutter, may_be_rolling,
                                                               ShutterDecision)
from selfcal_ros.calibration.estimators.torn_path import mended, torn_findings
from selfcal_ros.calibration.estimators.turning_stretch import turned_about
from selfcal_ros.calibration.estimators.turning_views import saying_what_moves
from selfcal_ros.calibration.estimators.zoom_selection import (contradicted, may_zoom, near_state,
                                                               nearer, settle_zoom, zoomed_fit,
                                                               zooming)
from selfcal_ros.calibration.initialisation.multi_start import best_start
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate

#: Kinds of motion to try, by name.
MOTION_MODELS = {
    'planar': (NEARLY_PLANAR,),
    'general': (GENERAL,),
    'auto': (NEARLY_PLANAR, GENERAL),
}
#: Views that are said to be parallel and turn by less than this, but measurably, are those of a
#: robot that does not repeat its orientation exactly.
MAX_TURN_RAD = np.radians(1.0)
#: A plane that nobody stated is tried against free motion where the camera turns by less than
#: this; from a new start, too, where it rejects too many.
LITTLE_TURN_RAD = np.radians(35.0)
#: Refusals that a focal length that varies may be the reason of.
UNEXPLAINED = ('no_start', 'tracks_unexplained', 'too_many_outliers')
#: Refusals that things that move may be the reason of.
MAY_BE_MOVING = (*UNEXPLAINED, 'parameters_undetermined', 'circle_undetermined')
#: Noise of still tracks over that of pairs of images, which what moves only adds to. Drives and
#: orbits on which nothing moves leave up to 1.15.
PARTED_NOISE = 1.3
#: Refusals of cameras that the images leave open, and how much less they leave to be believed.
OPEN, CLEARLY_LESS = ('parameters_undetermined', 'circle_undetermined'), 0.9
#: What a refused estimate leaves, over what pairs do: a motion that is too simple may be why.
POORLY_EXPLAINED = 1.5
#: Things that move bend the focal length, too: factors of the ones to part them from.
BESIDE_BENT = (1.0, 0.9, 1.1)


def calibrate_from_motion(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts,
                          proposals: list[Camera], motions: tuple[MotionModel, ...],
                          flat: bool = False, at_once: bool = False,
                          is_weak: bool = False) -> Calibration | NoEstimate:
    """
    Calibrate from planar or general motion.

    Parameters
    ----------
    graph : ViewGraph
    size : (int, int)
        Width and height of the image, pixels.
    facts : CameraFacts
    proposals : list of Camera
        Calibrations to start from; the sweep over the focal length follows.
    motions : tuple of MotionModel
        Kinds of motion to try, the most constrained first; the first that explains the images
        is taken.
    flat : bool
        Suppose that the scene is one plane, where without it the images would be refused for
        want of parallax.
    at_once : bool
        The views are of one instant, as objects in one image are: nothing varies over time.
    is_weak : bool
        Suppose that the translations are small beside the rotations.

    Returns
    -------
    Calibration or NoEstimate

    """
    problem = problem_of(graph, size, facts, flat, at_once)
    if isinstance(problem, NoEstimate):
        return problem
    problem = replace(problem, is_weak=is_weak, supposes_plane=GENERAL in motions)
    result, motion = _simplest_motion(problem, graph, proposals, motions)
    ill_parted = _is_ill_parted(result, problem)
    if result and not ill_parted:
        result = likeliest_start(result, replace(problem, motion=motion), graph,
                                 _attempt_any_focal, _first_focal_px)
    if (result and motion is not motions[-1] and _rejected(result, graph) > MANY_REJECTED
            and widest_turn_rad(result.reconstructed.cam_from_world[:, :, :3]) < LITTLE_TURN_RAD):
        # the descent that began in a plane may have ended far from the optimum of free motion
        free = _attempt_any_focal(replace(problem, motion=motions[-1]), graph, proposals)
        if free and _rejected(free, graph) < _rejected(result, graph) / 2:
            result = free
    if not result and result.kind in UNEXPLAINED:
        # a fact that is far off leaves no start that explains the images
        in_the_way = _of_wrong_fact(replace(problem, motion=motions[-1]), graph, proposals)
        if in_the_way is not None:
            return in_the_way
    if (not result and result.kind in MAY_BE_MOVING) or ill_parted:
        # the longest tracks start the estimate, and those ahead of a vehicle may all be moving
        unexplained = not result and result.kind in UNEXPLAINED
        for motion in motions:
            found = calibrate_coherent_tracks(replace(problem, motion=motion), graph,
                                              straight_and_bent(problem), _attempt_any_focal,
                                              may_stand=unexplained)
            if found or (found is not None and _is_less_open(found, result)):
                return found
    if result and ill_parted:
        result = likeliest_start(result, replace(problem, motion=motion), graph,
                                 _attempt_any_focal, _first_focal_px)
    if result and result.focal is not None and motion is not motions[0]:
        # a focal length that was held constant may have hidden the plane
        planar = _Attempt(zooming(replace(problem, motion=motions[0])), graph, proposals,
                          None).result()
        result = planar if planar and planar.focal is not None else result
    return result


def _simplest_motion(problem: SelfCalibrationProblem, graph: ViewGraph, proposals: list[Camera],
                     motions: tuple[MotionModel, ...],
                     ) -> tuple[Calibration | NoEstimate, MotionModel]:
    """Calibrate with the first kind of motion that explains the views; it comes second."""
    refused: list[tuple[NoEstimate, MotionModel]] = []
    for motion in motions:
        result = _attempt_any_focal(replace(problem, motion=motion), graph, proposals)
        if isinstance(result, Calibration):
            return result, motion
        refused.append((result, motion))
        if not _may_be_freer(result, problem):
            break
    # a refusal that more freedom does not mend, and that explains more, stays
    return next((one for one in refused[:-1]
                 if _is_final(one[0]) and _left_px(one[0]) <= _left_px(refused[-1][0])),
                refused[-1])


def _is_final(refusal: NoEstimate) -> bool:
    """Tell whether a freer kind of motion would not mend a refusal."""
    return refusal.values.get('motion') != 'general'


def _left_px(refusal: NoEstimate) -> float:
    """Return the residual noise of the refused estimate, pixels; infinite if it is not told."""
    return float(refusal.values.get('left_px', np.inf))


def _is_less_open(refusal: NoEstimate, result: Calibration | NoEstimate) -> bool:
    """Tell whether an underdetermined camera has clearly smaller residuals than a result."""
    left_px = result.noise_sigma_px if result else _left_px(result)
    return refusal.kind in OPEN and _left_px(refusal) < CLEARLY_LESS * left_px


def _may_be_freer(refusal: NoEstimate, problem: SelfCalibrationProblem) -> bool:
    """Tell whether a freer motion may mend a refusal: its residuals exceed the pairs' noise."""
    return (not _is_final(refusal)
            or np.inf > _left_px(refusal) > POORLY_EXPLAINED * problem.noise_px)


def _of_wrong_fact(problem: SelfCalibrationProblem, graph: ViewGraph, proposals: list[Camera],
                   ) -> NoEstimate | None:
    """Name a fact without which nearly all inliers of the pairs are explained, if there is one."""
    facts = without_facts(problem.facts)
    if facts is None:
        return None
    # it must explain them alone: nothing is parted, and nothing zooms
    free = _Attempt(replace(problem, facts=replace(facts, focal='constant')),
                    replace(graph, given=None), proposals, None).result()
    if not free or _rejected(free, graph) > MANY_REJECTED:
        return None
    return fact_in_the_way(problem.facts, free)


def _is_ill_parted(result: Calibration | NoEstimate, problem: SelfCalibrationProblem) -> bool:
    """Tell whether the residuals of still tracks exceed the noise that pairs of images show."""
    return (isinstance(result, Calibration)
            and result.noise_sigma_px > PARTED_NOISE * problem.noise_px)


def _rejected(result: Calibration, graph: ViewGraph) -> float:
    """Share of outliers among the observations that agree with the epipolar geometry."""
    rejected = result.outlier_count - graph.rejected
    return rejected / max(rejected + result.observation_count, 1)


def _attempt_any_focal(problem: SelfCalibrationProblem, graph: ViewGraph,
                       proposals: list[Camera], near: RobustFit | None = None,
                       ) -> Calibration | NoEstimate:
    """Calibrate with a focal length that is constant if that is possible, else with any."""
    if problem.facts.focal == 'varying' and problem.instants:
        return _Attempt(zooming(problem), graph, proposals, None).result()
    result = _Attempt(problem, graph, proposals, near).result()
    if may_zoom(problem) and not result and result.kind in UNEXPLAINED:
        zoomed = _Attempt(zooming(problem), graph, proposals, None).result()
        result = zoomed if zoomed or zoomed.kind == 'two_cameras' else result
    return result


def _first_focal_px(problem: SelfCalibrationProblem, graph: ViewGraph, start: Camera) -> float:
    """Return the focal length of the first fit from a start; NaN where there is none."""
    return _Attempt(problem, graph, [start], None).first_focal_px()


@dataclass(frozen=True)
class _Attempt:
    """
    One kind of motion, from the starts to the tests that a result must pass.

    Attributes
    ----------
    problem : SelfCalibrationProblem
    graph : ViewGraph
    proposals : list of Camera
        Calibrations to start from.
    near : RobustFit or None
        A fit to start from, too.

    """

    problem: SelfCalibrationProblem
    graph: ViewGraph
    proposals: list[Camera]
    near: RobustFit | None

    @cached_property
    def window(self) -> SelfCalibrationProblem:
        """The views of the starts, which do not suppose what the images may contradict."""
        window = self.problem.window()
        return replace(window, motion=replace(window.motion, parallel=()))

    @cached_property
    def medium(self) -> Observations:
        """The tracks on which models are chosen."""
        observations = self.window.observations
        return observations.select(observations.longest(MODEL_TRACKS_PER_VIEW))[0]

    def result(self) -> Calibration | NoEstimate:
        """Return the calibration, or why there is none."""
        start = self._start()
        if isinstance(start, NoEstimate):
            return start
        state, left = start
        first = self._first_fit(state)
        if isinstance(first, NoEstimate):
            return first
        shutter = choose_shutter(first, self.medium, self.window.facts, self.window.size)
        if self.window.views == self.problem.views:
            # before what moves is taken for a zoom; rows read in turn move tracks, too
            still = calibrate_still_tracks(shutter.fit, self.medium, self.problem, self.graph,
                                           _attempt_any_focal)
            if still is not None:
                return still
        return self._from(first, shutter, left)

    def first_focal_px(self) -> float:
        """Return the focal length of the first fit, pixels; NaN where there is none."""
        start = self._start()
        first = start if isinstance(start, NoEstimate) else self._first_fit(start[0])
        return np.nan if isinstance(first, NoEstimate) else float(first.state.lens['f'])

    def _start(self) -> tuple[SceneState, NoEstimate | None] | NoEstimate:
        """Return a start, and what it leaves unexplained if that may be rows read in turn."""
        problem = self.problem
        started = best_start(self.window, self.proposals)
        if isinstance(started, NoEstimate):
            return started
        start, noise_px = started
        if self.near is not None and not noise_px < EXPLAINED * problem.noise_px:
            start, noise_px = self.near.state, self.near.bundle.sigma_px
        as_far_as_told = 'general' if problem.motion.keeps_plane else 'unknown'
        if start is None or not np.isfinite(noise_px):
            return NoEstimate('no_start', noise_px=problem.noise_px, motion=as_far_as_told)
        if noise_px < EXPLAINED * problem.noise_px:
            return start, None
        left = NoEstimate('tracks_unexplained', left_px=float(noise_px),
                          noise_px=problem.noise_px, motion=as_far_as_told)
        return (start, left) if may_be_rolling(self.window, noise_px) else left

    def _first_fit(self, start: SceneState) -> RobustFit | NoEstimate:
        """Fit the medium tracks, and mend what starts have wrong."""
        problem, window, medium, near = self.problem, self.window, self.medium, self.near
        # far out of the plane, against a prior that pulls there: no need to go on
        if self._is_out_of_plane(start, 2 * MAX_TILT_RAD):
            return not_planar(out_of_plane_rad(start.path))
        state = with_all_points(start, medium)
        if state is None:
            return NoEstimate('start_distortion_not_invertible')
        fit = first_fit(window, medium, state)
        if near is not None:
            fit = nearer(fit, first_fit(window, medium, near_state(near, medium) or state),
                         medium)
        fit = mended(turned_about(fit, medium, window), medium, window)
        if problem.motion.keeps_plane:
            # before what the plane forbids is taken for something else
            fit = as_uneven_as_told(fit, medium)
        if self._is_out_of_plane(fit.state) or (
                self._turns_little(fit.state)
                and fit.motion.is_more_uneven_than(window.motion)):
            return not_planar(out_of_plane_rad(fit.state.path))
        return fit

    def _from(self, first: RobustFit, shutter: ShutterDecision,
              left: NoEstimate | None) -> Calibration | NoEstimate:
        """Go on from a first fit and its shutter: two cameras, zoom, model, all views, tests."""
        window = self.window
        fit = shutter.fit
        if left is not None and fit.observations.shutter is None:
            return left
        if self._is_out_of_plane(fit.state):
            return not_planar(out_of_plane_rad(fit.state.path))
        mixed = of_two_cameras(fit, window, self.graph)
        if mixed is not None:
            return mixed
        if contradicted(fit, window):
            return (_parted_or_zooming(self.problem, self.graph, self.proposals, first, fit)
                    if may_zoom(self.problem) else NoEstimate(NOT_CONSTANT))
        if fit.motion.zoom is not None:
            fit = settle_zoom(fit, window.facts, window.size)
        held = self._held_parallel(fit)
        if isinstance(held, NoEstimate):
            return held
        fit, turned = held
        model = shutter.widened(choose_model(
            window, fit, len(self.medium.view) / len(self.problem.observations.view)))
        if (self._turns_little(model.fit.state)
                and leaves_plane(model, self.medium, self.problem.size)):
            return not_planar(out_of_plane_rad(model.fit.state.path))
        return self._assessed(model, first, (*shutter.findings, *turned))

    def _held_parallel(self, fit: RobustFit,
                       ) -> tuple[RobustFit, tuple[Finding, ...]] | NoEstimate:
        """Hold views parallel that are said to be, unless they measurably are not."""
        parallel = self.problem.window().motion.parallel
        if len(parallel) < 2:
            return fit, ()
        fit, turned_rad = hold_parallel(fit, parallel, self.window.size)
        if not turned_rad:
            return fit, ()
        turned_deg = float(np.degrees(turned_rad))
        if turned_rad > MAX_TURN_RAD:
            return NoEstimate('frames_turned', turned_deg=turned_deg, motion='general')
        return fit, (Finding('frames_turned_estimated', turned_deg=turned_deg),)

    def _assessed(self, model: ModelDecision, first: RobustFit, findings: tuple[Finding, ...],
                  ) -> Calibration | NoEstimate:
        """Fit all views by a model, and test the result."""
        stated, graph, frames = self.problem, self.graph, np.array(self.graph.frames)
        problem = settled(stated, model)
        whole = fit_all(problem, model)
        result = (whole if isinstance(whole, NoEstimate)
                  else assess(whole, model, problem, graph, stated.facts))
        if not result and result.kind == NOT_CONSTANT and may_zoom(problem):
            # a lens that was chosen is no fact
            return _parted_or_zooming(replace(problem, facts=stated.facts), graph,
                                      self.proposals, first, model.fit)
        if isinstance(whole, NoEstimate):
            return result
        if isinstance(result, NoEstimate):
            if result.kind == 'fact_contradicted':
                result = preferred_by_all(result, whole, problem.observations, stated.size)
            return saying_what_moves(result, whole, frames)
        torn = torn_findings(problem.observations, whole.observations, frames)
        return _unbent(whole, replace(result, findings=(*findings, *torn, *result.findings)),
                       problem, graph)

    def _is_out_of_plane(self, state: SceneState, limit_rad: float = MAX_TILT_RAD) -> bool:
        """Tell whether views tilt by too much for a plane, if one is supposed."""
        return (self.problem.motion.keeps_plane
                and out_of_plane_rad(state.path) > limit_rad)

    def _turns_little(self, state: SceneState) -> bool:
        """Tell whether a plane that nobody stated is to be held against free motion."""
        return (self.problem.motion.keeps_plane and self.problem.supposes_plane
                and widest_turn_rad(state.path.rotations()) < LITTLE_TURN_RAD)


def _unbent(fit: RobustFit, result: Calibration, problem: SelfCalibrationProblem,
            graph: ViewGraph) -> Calibration:
    """Calibrate without few tracks that bend the estimate, if there are such; else as it is."""
    if graph.given is None or not problem.instants or not may_be_bent(result):
        return result
    rest = unbent_fit(fit, problem, result.sigma, MODEL_TRACKS_PER_VIEW)
    still = rest and calibrate_sorted(rest, problem, graph, _attempt_any_focal, least=0.0)
    return still or result


def _parted_or_zooming(problem: SelfCalibrationProblem, graph: ViewGraph,
                       proposals: list[Camera], first: RobustFit, near: RobustFit,
                       ) -> Calibration | NoEstimate:
    """Part what moves, which bends the path until a zoom seems to mend it; else let it zoom."""
    rival = zoomed_fit(first, problem.window().instants)
    bent = first.state.camera(*problem.size)
    parted = calibrate_coherent_tracks(problem, graph, [
        bent.magnified(factor) for factor in BESIDE_BENT], _attempt_any_focal, rival)
    if parted:
        return parted
    zoomed = _Attempt(zooming(problem), graph, proposals, near).result()
    return parted if parted is not None and _is_less_open(parted, zoomed) else zoomed
