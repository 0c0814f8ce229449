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
Calibrate from what stands still, where a part of the tracks moves by itself or jumps.

What stands still is told by a fit: of all tracks, or of the half that is most coherent where most
of what the starts look at may move. Then the path is calibrated anew, from the still tracks alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import Observations, RobustFit
from selfcal_ros.calibration.estimators.coherent_start import coherent_fit
from selfcal_ros.calibration.estimators.model_selection import first_fit
from selfcal_ros.calibration.estimators.motion_problem import (MODEL_TRACKS_PER_VIEW,
                                                               of_two_cameras)
from selfcal_ros.calibration.estimators.shutter_choice import timed
from selfcal_ros.calibration.estimators.zoom_selection import (contradicted, may_zoom,
                                                               near_state, zoomed_fit)
from selfcal_ros.calibration.initialisation.multi_start import GOOD_ENOUGH
from selfcal_ros.calibration.initialisation.problem import observations_of, SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.moving.crowded_views import crowd_in_few_views
from selfcal_ros.calibration.moving.jumped_tracks import jumps_stand_out
from selfcal_ros.calibration.moving.sorting import (explained_share, explains_all, FEW,
                                                    hides_body, moving_findings, observed_like,
                                                    sort_tracks, SortedTracks, stands_out,
                                                    tested_as_still)
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.track_labels import MOVING
from selfcal_ros.values.tracks import Tracks

#: Where less than this share of what a view shows stands still, it may as well be the rest.
LEAST_STILL = 0.5
#: A zoom that makes more than this share of what moves stand still may be the cause.
ZOOM_EXPLAINS = 0.25
#: Of what pairs agree on, a motion that rejects more than this share explains too little.
MANY_REJECTED = 0.05

#: Calibrates from some views' tracks: problem, graph, cameras to start from, a fit to start from.
CalibratePath: TypeAlias = Callable[
    [SelfCalibrationProblem, ViewGraph, list[Camera], RobustFit | None], Calibration | NoEstimate]


def calibrate_still_tracks(fit: RobustFit, tried: Observations, problem: SelfCalibrationProblem,
                           graph: ViewGraph, calibrate_path: CalibratePath) -> Calibration | None:
    """Calibrate from what stands still, where something that moves or jumps is found."""
    frames = np.array(problem.instants, dtype=int)[:len(fit.state.path)]
    if graph.given is None or not problem.instants or fit.motion.zoom is not None:
        return None
    given = graph.given.in_frames(frames)
    observations = observed_like(fit, given, given.frames)
    test = tested_as_still(fit, observations)
    if stands_out(fit, tried, graph.tracks.in_frames(frames), given, test):
        return calibrate_sorted(fit, problem, graph, calibrate_path) or None
    if test is None:
        return None
    if jumps_stand_out(fit, observations, test):
        return calibrate_sorted(fit, problem, graph, calibrate_path, alone='tracks_jump') or None
    if (crowd_in_few_views(test, observations)
            or hides_body(fit, observations, test, problem.size)):
        return calibrate_sorted(fit, problem, graph, calibrate_path, alone='tracks_moving') or None
    return None


def calibrate_sorted(fit: RobustFit, problem: SelfCalibrationProblem, graph: ViewGraph,
                     calibrate_path: CalibratePath, rival: RobustFit | None = None,
                     least: float = FEW, alone: str = '',
                     ) -> Calibration | NoEstimate | None:
    """
    Calibrate from what stands still by a fit, unless its rival explains that as well.

    Where still tracks may fail as wholes, too, one kind of finding alone tells something. What
    stands still may leave the camera open: that refusal says how little it leaves.
    """
    frames = np.array(problem.instants, dtype=int)[:len(fit.state.path)]
    if graph.given is None:
        return None
    given = graph.given.in_frames(frames)
    found = sort_tracks(fit, graph.given, frames, problem.size, np.random.default_rng(0))
    findings = moving_findings(found[0].labels, found[0].length, least) if found else ()
    if not found or not findings or (
            alone and alone not in [one.kind for one in findings]):
        return None
    sorted_tracks, still = found
    if rival is None:
        # two cameras, or one that zooms, part the tracks as well: those are asked for next
        if sorted_tracks.still_share < LEAST_STILL and _is_zoom_or_two(
                fit, sorted_tracks, problem, graph, given):
            return None
        if may_zoom(problem) and contradicted(fit, problem):
            rival = zoomed_fit(fit, problem.instants)
    # what stands still without a zoom stands still with it, too, if there is one
    if rival is not None and explains_all(
            rival, still.bundle.sigma_px, given, sorted_tracks.labels):
        return None
    # what is explained is no outlier, and has no vote any more
    rest = replace(graph, tracks=sorted_tracks.static, given=None,
                   rejected=sorted_tracks.contradicting)
    observations = timed(observations_of(rest.tracks, rest.frames), rest.tracks, rest.frames,
                         problem.size, problem.facts)
    # a zoom moves tracks, too: where the still ones ask for it, all of them are to tell
    result = calibrate_path(replace(problem, observations=observations, of_still=True), rest,
                            [still.state.camera(*problem.size)], still)
    if isinstance(result, NoEstimate):
        return result
    if result.focal is not None:
        return None
    return replace(result, labels=sorted_tracks.labels, findings=(*findings, *result.findings))


def calibrate_coherent_tracks(problem: SelfCalibrationProblem, graph: ViewGraph,
                              proposals: Iterable[Camera], calibrate_path: CalibratePath,
                              rival: RobustFit | None = None, may_stand: bool = False,
                              ) -> Calibration | NoEstimate | None:
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
    parted = calibrate_sorted(half, problem, graph, calibrate_path, rival)
    if parted or not may_stand:
        return parted
    # where nothing moves it was the starts that failed: this one began with fewer tracks
    medium = problem.observations.longest(MODEL_TRACKS_PER_VIEW)
    state = near_state(half, medium)
    if state is None or first_fit(problem, medium, state).outliers > (
            MANY_REJECTED * len(medium.view)):
        return parted
    return calibrate_path(problem, graph, [half.state.camera(*problem.size)], half) or parted


def _is_zoom_or_two(fit: RobustFit, found: SortedTracks, problem: SelfCalibrationProblem,
                    graph: ViewGraph, given: Tracks) -> bool:
    """Tell whether another focal length of views explains what was taken for things that move."""
    if not may_zoom(problem) or of_two_cameras(fit, problem, graph) is not None:
        return True
    moving = found.labels.track[found.labels.label >= MOVING]
    return explained_share(zoomed_fit(fit, problem.instants), given, moving) > ZOOM_EXPLAINS
