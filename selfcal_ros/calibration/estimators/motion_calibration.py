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

The thesis's chain (fixed points v, i, j, then the pencil of conics; chapters 5 and 6) proposes
one calibration; a sweep over the focal length proposes others. Each proposal is a start for the
same bundle adjustment on a small fraction of the tracks, the best one is finished on all of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.motion import GENERAL, MotionModel, NEARLY_PLANAR, PLANAR
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, Observations, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.estimators.acceptance import assess, EXPLAINED, unchecked
from selfcal_ros.calibration.estimators.all_views import fit_all, NOT_CONSTANT, settled
from selfcal_ros.calibration.estimators.bent_estimate import may_be_bent, unbent_fit
from selfcal_ros.calibration.estimators.coherent_start import coherent_fit, straight_and_bent
from selfcal_ros.calibration.estimators.facts_in_the_way import (
    fact_in_the_way, preferred_by_all, without_facts)
from selfcal_ros.calibration.estimators.model_selection import (as_uneven_as_told,
                                                                choose_model, first_fit,
                                                                hold_parallel, leaves_plane)
from selfcal_ros.calibration.estimators.motion_class import (MAX_TILT_RAD, not_planar,
                                                             out_of_plane_rad,
                                                             widest_turn_rad)
from selfcal_ros.calibration.estimators.shutter_choice import (choose_shutter, may_be_rolling,
                                                               timed)
from selfcal_ros.calibration.estimators.torn_path import mended, torn_findings
from selfcal_ros.calibration.estimators.turning_stretch import turned_about
from selfcal_ros.calibration.estimators.turning_views import saying_what_moves
from selfcal_ros.calibration.estimators.zoom_selection import (contradicted, may_zoom, near_state,
                                                               nearer, settle_zoom, zoomed_fit,
                                                               zooming)
from selfcal_ros.calibration.initialisation.multi_start import best_start, GOOD_ENOUGH
from selfcal_ros.calibration.initialisation.planar_scene import FlatScene
from selfcal_ros.calibration.initialisation.problem import observations_of, SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.moving.crowded_views import crowd_in_few_views
from selfcal_ros.calibration.moving.sorting import (explained_share, explains_all, FEW,
                                                    hides_body, moving_findings, sort_tracks,
                                                    SortedTracks, stands_out, tested_as_still)
from selfcal_ros.calibration.observability import held_facts, LEAST_NOISE_PX
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.uncertainty.cluster_covariance import robust_covariance_of
from selfcal_ros.calibration.uncertainty.two_cameras import two_cameras, two_focal_lengths
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera, CameraFacts, MATRIX_PARAMETERS
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.two_view_tests import PARALLAX_RATIO
from selfcal_ros.values.track_labels import MOVING
from selfcal_ros.values.tracks import Tracks

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
#: this; from a new start, too, where it rejects more than this share of what pairs agree on.
LITTLE_TURN_RAD, MANY_REJECTED = np.radians(35.0), 0.05
#: Refusals that a focal length that varies may be the reason of.
UNEXPLAINED = ('no_start', 'tracks_unexplained', 'too_many_outliers')
#: Refusals that things that move may be the reason of.
MAY_BE_MOVING = (*UNEXPLAINED, 'parameters_undetermined', 'circle_undetermined')
#: Noise of still tracks over that of pairs of images, which what moves only adds to.
PARTED_NOISE = 1.3
#: Things that move bend the focal length, too: factors of the ones to part them from.
BESIDE_BENT = (1.0, 0.9, 1.1)
#: Where less than this share of what a view shows stands still, it may as well be the rest.
LEAST_STILL = 0.5
#: A zoom that makes more than this share of what moves stand still may be the cause.
ZOOM_EXPLAINS = 0.25
#: Tracks per view on which the distortion model and the planarity are decided.
MODEL_TRACKS_PER_VIEW = 100


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
    for motion in motions:
        result = _attempt_any_focal(replace(problem, motion=motion), graph, proposals)
        if result or result.values.get('motion') != 'general':
            break
    if (result and motion is not motions[-1] and _rejected(result, graph) > MANY_REJECTED
            and widest_turn_rad(result.reconstructed.cam_from_world[:, :, :3]) < LITTLE_TURN_RAD):
        # a plane far from the truth, from where no way leads to what free motion explains
        free = _attempt_any_focal(replace(problem, motion=motions[-1]), graph, proposals)
        if free and _rejected(free, graph) < _rejected(result, graph) / 2:
            result = free
    if not result and result.kind in UNEXPLAINED:
        # a fact that is far off leaves no start that explains the images
        in_the_way = _of_wrong_fact(replace(problem, motion=motions[-1]), graph, proposals)
        if in_the_way is not None:
            return in_the_way
    if (not result and result.kind in MAY_BE_MOVING) or _is_ill_parted(result, problem):
        # most of what the starts look at may move, as long tracks ahead of a vehicle do
        unexplained = not result and result.kind in UNEXPLAINED
        for motion in motions:
            found = _of_coherent_tracks(replace(problem, motion=motion), graph,
                                        straight_and_bent(problem), may_stand=unexplained)
            if found:
                return found
    if result and result.focal is not None and motion is not motions[0]:
        # a focal length that was held constant may have hidden the plane
        planar = _attempt(zooming(replace(problem, motion=motions[0])), graph, proposals)
        result = planar if planar and planar.focal is not None else result
    return result


def _of_wrong_fact(problem: SelfCalibrationProblem, graph: ViewGraph, proposals: list[Camera],
                   ) -> NoEstimate | None:
    """Name a fact without which nearly all that pairs agree on is explained, if there is one."""
    facts = without_facts(problem.facts)
    if facts is None:
        return None
    # it must explain them alone: nothing is parted, and nothing zooms
    free = _attempt(replace(problem, facts=replace(facts, focal='constant')),
                    replace(graph, given=None), proposals)
    if not free or _rejected(free, graph) > MANY_REJECTED:
        return None
    return fact_in_the_way(problem.facts, free)


def _is_ill_parted(result: Calibration | NoEstimate, problem: SelfCalibrationProblem) -> bool:
    """Tell whether what was left as still leaves more than pairs of images, of all tracks, do."""
    return (isinstance(result, Calibration) and result.labels is not None
            and result.noise_sigma_px > PARTED_NOISE * problem.noise_px)


def _rejected(result: Calibration, graph: ViewGraph) -> float:
    """Share of the observations that contradict, though they do not contradict pairs."""
    rejected = result.outlier_count - graph.rejected
    return rejected / max(rejected + result.observation_count, 1)


def problem_of(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts, flat: bool = False,
               at_once: bool = False, turns: bool = False) -> SelfCalibrationProblem | NoEstimate:
    """Set up what is to be explained; see `calibrate_from_motion`. Turns need no parallax."""
    observations = timed(observations_of(graph.tracks, graph.frames), graph.tracks,
                         graph.frames, size, facts)
    if len(graph.frames) < 3:
        held = held_facts(facts)
        return NoEstimate('too_few_images', images=len(graph.frames), status={
            name: 'held' if name in held else 'unobservable' for name in MATRIX_PARAMETERS})
    plane = FlatScene.of(graph.tracks, graph.frames) if flat else None
    problem = SelfCalibrationProblem(observations, graph.pairs, size, facts,
                                     max(graph.noise_px, LEAST_NOISE_PX), flat=plane,
                                     bend=graph.bend,
                                     instants=() if at_once else tuple(
                                         float(frame) for frame in graph.frames))
    refusal = unchecked(bundle_of(observations, PLANAR, priors_from_facts(facts), 1.0))
    # of few points a homography explains as much as any motion does
    if refusal is None and graph.parallax < PARALLAX_RATIO and plane is None and not turns:
        return NoEstimate('no_parallax', parallax_ratio=float(graph.parallax), motion='rotation')
    return problem if refusal is None else refusal


def _attempt_any_focal(problem: SelfCalibrationProblem, graph: ViewGraph,
                       proposals: list[Camera], near: RobustFit | None = None,
                       ) -> Calibration | NoEstimate:
    """Calibrate with a focal length that is constant if that is possible, else with any."""
    if problem.facts.focal == 'varying' and problem.instants:
        return _attempt(zooming(problem), graph, proposals)
    result = _attempt(problem, graph, proposals, near)
    if may_zoom(problem) and not result and result.kind in UNEXPLAINED:
        zoomed = _attempt(zooming(problem), graph, proposals)
        result = zoomed if zoomed or zoomed.kind == 'two_cameras' else result
    return result


def _attempt(problem: SelfCalibrationProblem, graph: ViewGraph, proposals: list[Camera],
             near: RobustFit | None = None) -> Calibration | NoEstimate:
    """Calibrate under one kind of motion; `near` is a fit to start from, too."""
    window = problem.window()
    # the starts do not suppose what the images may contradict
    parallel = window.motion.parallel
    window = replace(window, motion=replace(window.motion, parallel=()))
    started = best_start(window, proposals)
    if isinstance(started, NoEstimate):
        return started
    start, noise_px = started
    if near is not None and not noise_px < EXPLAINED * problem.noise_px:
        start, noise_px = near.state, near.bundle.sigma_px
    as_far_as_told = 'general' if problem.motion.keeps_plane else 'unknown'
    if start is None or not np.isfinite(noise_px):
        return NoEstimate('no_start', noise_px=problem.noise_px, motion=as_far_as_told)
    unexplained = NoEstimate('tracks_unexplained', left_px=float(noise_px),
                             noise_px=problem.noise_px, motion=as_far_as_told)
    # rows that are read in turn leave more, until their delay is estimated
    is_explained = noise_px < EXPLAINED * problem.noise_px
    if not (is_explained or may_be_rolling(window, noise_px)):
        return unexplained
    # far out of the plane, against a prior that pulls there: no need to go on
    if problem.motion.keeps_plane and out_of_plane_rad(start.path) > 2 * MAX_TILT_RAD:
        return not_planar(out_of_plane_rad(start.path))
    medium, _ = window.observations.select(window.observations.longest(MODEL_TRACKS_PER_VIEW))
    state = with_all_points(start, medium)
    if state is None:
        return NoEstimate('start_distortion_not_invertible')
    fit = first_fit(window, medium, state)
    if near is not None:
        fit = nearer(fit, first_fit(window, medium, near_state(near, medium) or state), medium)
    fit = mended(turned_about(fit, medium, window), medium, window)
    if problem.motion.keeps_plane:
        # before what the plane forbids is taken for something else
        fit = as_uneven_as_told(fit, medium)
        if out_of_plane_rad(fit.state.path) > MAX_TILT_RAD or (
                problem.supposes_plane and fit.motion.is_more_uneven_than(window.motion)
                and widest_turn_rad(fit.state.path.rotations()) < LITTLE_TURN_RAD):
            return not_planar(out_of_plane_rad(fit.state.path))
    if window.views == problem.views:
        # before what moves is taken for a shutter or a zoom
        again = _of_still_tracks(fit, medium, problem, graph)
        if again is not None:
            return again
    first, shutter = fit, choose_shutter(fit, medium, window.facts, window.size)
    fit, findings = shutter.fit, shutter.findings
    if not (is_explained or fit.observations.shutter is not None):
        return unexplained
    if problem.motion.keeps_plane and out_of_plane_rad(fit.state.path) > MAX_TILT_RAD:
        return not_planar(out_of_plane_rad(fit.state.path))
    mixed = of_two_cameras(fit, window, graph)
    if mixed is not None:
        return mixed
    if contradicted(fit, window):
        return (_parted_or_zooming(problem, graph, proposals, first, fit) if may_zoom(problem)
                else NoEstimate(NOT_CONSTANT))
    if fit.motion.zoom is not None:
        fit = settle_zoom(fit, window.facts, window.size)
    if len(parallel) > 1:
        fit, turned = hold_parallel(fit, parallel, window.size)
        if turned > MAX_TURN_RAD:
            return NoEstimate('frames_turned', turned_deg=float(np.degrees(turned)),
                              motion='general')
        if turned:
            findings += (Finding('frames_turned_estimated',
                                 turned_deg=float(np.degrees(turned))),)
    model = shutter.widened(
        choose_model(window, fit, len(medium.view) / len(problem.observations.view)))
    if (problem.supposes_plane and problem.motion.keeps_plane
            and widest_turn_rad(model.fit.state.path.rotations()) < LITTLE_TURN_RAD
            and leaves_plane(model, medium, problem.size)):
        return not_planar(out_of_plane_rad(model.fit.state.path))
    known = settled(problem, model)
    whole = fit_all(known, model)
    result = (whole if isinstance(whole, NoEstimate)
              else assess(whole, model, known, graph, problem.facts))
    if not result and result.kind == NOT_CONSTANT and may_zoom(known):
        # a lens that was chosen is no fact
        stated = replace(known, facts=problem.facts)
        return _parted_or_zooming(stated, graph, proposals, first, model.fit)
    if isinstance(whole, NoEstimate):
        return result
    if isinstance(result, NoEstimate):
        if result.kind == 'fact_contradicted':
            result = preferred_by_all(result, whole, known.observations, problem.size)
        return saying_what_moves(result, whole, np.array(graph.frames))
    findings += torn_findings(known.observations, whole.observations, np.array(graph.frames))
    return _unbent(whole, replace(result, findings=(*findings, *result.findings)), known, graph)


def _unbent(fit: RobustFit, result: Calibration, problem: SelfCalibrationProblem,
            graph: ViewGraph) -> Calibration:
    """Calibrate without few tracks that bend the estimate, if there are such; else as it is."""
    if graph.given is None or not problem.instants or not may_be_bent(result):
        return result
    rest = unbent_fit(fit, problem, result.sigma, MODEL_TRACKS_PER_VIEW)
    return (rest and _of_sorted(rest, problem, graph, least=0.0)) or result


def _parted_or_zooming(problem: SelfCalibrationProblem, graph: ViewGraph,
                       proposals: list[Camera], first: RobustFit, near: RobustFit,
                       ) -> Calibration | NoEstimate:
    """Part what moves, which bends the path until a zoom seems to mend it; else let it zoom."""
    rival = zoomed_fit(first, problem.window().instants)
    bent = first.state.camera(*problem.size)
    parted = _of_coherent_tracks(problem, graph, [
        bent.magnified(factor) for factor in BESIDE_BENT], rival)
    return parted or _attempt(zooming(problem), graph, proposals, near)


def of_two_cameras(fit: RobustFit, window: SelfCalibrationProblem, graph: ViewGraph,
                   ) -> NoEstimate | None:
    """Refuse images of two cameras, and tell which they are."""
    if fit.state.zoom is not None:
        second = two_focal_lengths(fit.state.zoom.log_focal)
    else:
        second = two_cameras(fit, robust_covariance_of(fit, window.size).variance_inflation)
    if second is None:
        return None
    frames = np.array(window.instants, dtype=int)
    return NoEstimate('two_cameras', first=frames[~second].tolist(),
                      second=frames[second].tolist(), all_views=len(second) == len(graph.frames))


def _of_still_tracks(fit: RobustFit, tried: Observations, problem: SelfCalibrationProblem,
                     graph: ViewGraph) -> Calibration | None:
    """Calibrate from what stands still, where something that moves or jumps is found."""
    frames = np.array(problem.instants, dtype=int)[:len(fit.state.path)]
    if (graph.given is None or not problem.instants or fit.motion.zoom is not None
            or fit.observations.shutter is not None):
        return None
    given = graph.given.in_frames(frames)
    observations = Observations.of(given, given.frames)
    test = tested_as_still(fit, observations)
    if stands_out(fit, tried, graph.tracks.in_frames(frames), given, test):
        return _of_sorted(fit, problem, graph)
    if test is None or not (crowd_in_few_views(test, observations)
                            or hides_body(fit, observations, test, problem.size)):
        return None
    return _of_sorted(fit, problem, graph, bodies_alone=True)


def _of_sorted(fit: RobustFit, problem: SelfCalibrationProblem, graph: ViewGraph,
               rival: RobustFit | None = None, least: float = FEW,
               bodies_alone: bool = False) -> Calibration | None:
    """
    Calibrate from what stands still by a fit, unless its rival explains that as well.

    Of bodies alone where still tracks may fail as wholes, too: then all else tells nothing.
    """
    frames = np.array(problem.instants, dtype=int)[:len(fit.state.path)]
    if graph.given is None:
        return None
    given = graph.given.in_frames(frames)
    found = sort_tracks(fit, graph.given, frames, problem.size, np.random.default_rng(0))
    findings = moving_findings(found[0].labels, found[0].length, least) if found else ()
    if not found or not findings or (
            bodies_alone and 'tracks_moving' not in [one.kind for one in findings]):
        return None
    sorted_tracks, still = found
    # what stands still without a zoom stands still with it, too, if there is one
    if rival is not None and explains_all(rival, still, given, sorted_tracks.labels):
        return None
    # two cameras, or one that zooms, part the tracks as well: those are asked for next
    if rival is None and sorted_tracks.still_share < LEAST_STILL and _is_zoom_or_two(
            fit, sorted_tracks, problem, graph, given):
        return None
    # what is explained is no outlier, and has no vote any more
    rest = replace(graph, tracks=sorted_tracks.static, given=None,
                   rejected=sorted_tracks.contradicting)
    observations = replace(observations_of(rest.tracks, rest.frames),
                           clock=problem.observations.clock)
    # a zoom moves tracks, too: where the still ones ask for it, all of them are to tell
    result = _attempt_any_focal(replace(problem, observations=observations, of_still=True), rest,
                                [still.state.camera(*problem.size)], still)
    if not result or result.focal is not None:
        return None
    return replace(result, labels=sorted_tracks.labels, findings=(*findings, *result.findings))


def _of_coherent_tracks(problem: SelfCalibrationProblem, graph: ViewGraph,
                        proposals: Iterable[Camera], rival: RobustFit | None = None,
                        may_stand: bool = False) -> Calibration | None:
    """
    Calibrate from what the most coherent half of the tracks says that stands still.

    Where all of it may stand, it is calibrated from all, with the half as a start.
    """
    # what is of one instant stands still; tracks are not parted while their rows are read in turn
    if (graph.given is None or not problem.instants or problem.observations.shutter is not None
            or problem.window().views < problem.views):
        return None
    half = coherent_fit(problem, MODEL_TRACKS_PER_VIEW, proposals,
                        enough=GOOD_ENOUGH if rival is None else 0.0)
    if half is None:
        return None
    parted = _of_sorted(half, problem, graph, rival)
    if parted is not None or not may_stand:
        return parted
    # where nothing moves it was the starts that failed: this one began with fewer tracks
    medium, _ = problem.observations.select(problem.observations.longest(MODEL_TRACKS_PER_VIEW))
    state = near_state(half, medium)
    if state is None or first_fit(problem, medium, state).outliers > (
            MANY_REJECTED * len(medium.view)):
        return None
    whole = _attempt_any_focal(problem, graph, [half.state.camera(*problem.size)], half)
    return whole or None


def _is_zoom_or_two(fit: RobustFit, found: SortedTracks, problem: SelfCalibrationProblem,
                    graph: ViewGraph, given: Tracks) -> bool:
    """Tell whether another focal length of views explains what was taken for things that move."""
    if not may_zoom(problem) or of_two_cameras(fit, problem, graph) is not None:
        return True
    moving = found.labels.track[found.labels.label >= MOVING]
    return explained_share(zoomed_fit(fit, problem.instants), given, moving) > ZOOM_EXPLAINS
