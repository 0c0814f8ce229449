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
One kind of motion → K: starts, one maximum-likelihood estimate, and the tests it must pass.

The thesis's chain (fixed points v, i, j, then the pencil of conics; chapters 5 and 6) proposes one
calibration; a sweep over the focal length proposes others. Each proposal is a start for the same
bundle adjustment on a small fraction of the tracks. The best one is finished on all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import (fit_robustly, Observations, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.acceptance import assess, EXPLAINED
from selfcal_ros.calibration.estimators.all_views import fit_all, NOT_CONSTANT, settled
from selfcal_ros.calibration.estimators.bent_estimate import may_be_bent, unbent_fit
from selfcal_ros.calibration.estimators.facts_in_the_way import preferred_by_all
from selfcal_ros.calibration.estimators.image_shift_choice import (are_within_crop,
                                                                   LEFT_AT_FIRST,
                                                                   LEFT_AT_LAST,
                                                                   LEFT_BESIDE_ROWS,
                                                                   with_image_shifts)
from selfcal_ros.calibration.estimators.model_selection import (as_uneven_as_told,
                                                                choose_model, first_fit,
                                                                hold_parallel, leaves_plane,
                                                                ModelDecision,
                                                                VIEWS_OF_A_PLANE)
from selfcal_ros.calibration.estimators.motion_class import (MAX_TILT_RAD, not_planar,
                                                             out_of_plane_rad,
                                                             widest_turn_rad)
from selfcal_ros.calibration.estimators.motion_problem import (MODEL_TRACKS_PER_VIEW,
                                                               of_two_cameras)
from selfcal_ros.calibration.estimators.parted_tracks import (
    calibrate_coherent_tracks, calibrate_sorted, calibrate_still_tracks)
from selfcal_ros.calibration.estimators.own_rows_choice import with_own_rows
from selfcal_ros.calibration.estimators.shutter_choice import (choose_shutter, may_be_rolling,
                                                               ShutterDecision)
from selfcal_ros.calibration.estimators.torn_path import continued, mended, torn_findings
from selfcal_ros.calibration.estimators.turning_stretch import turned_about
from selfcal_ros.calibration.estimators.turning_views import saying_what_moves
from selfcal_ros.calibration.estimators.zoom_selection import (contradicted, may_zoom, near_state,
                                                               nearer, settle_zoom,
                                                               undisturbed, zoomed_fit, zooming)
from selfcal_ros.calibration.initialisation.multi_start import best_start
from selfcal_ros.calibration.initialisation.problem import (ROUND_WINDOWS,
                                                            SelfCalibrationProblem,
                                                            WINDOW_VIEWS)
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.moving.sorting import explains_all
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.track_labels import MOVING

#: Views that are said to be parallel and turn by less than this, but measurably, are those of a
#: robot that does not repeat its orientation exactly.
MAX_TURN_RAD = np.radians(1.0)
#: A plane that nobody stated is tried against free motion where the camera turns by less than
#: this; from a new start, too, where it rejects too many.
LITTLE_TURN_RAD = np.radians(35.0)
#: Refusals that a focal length that varies may be the reason of.
UNEXPLAINED = ('no_start', 'tracks_unexplained', 'too_many_outliers')
#: Refusals of cameras that the images leave open, and how much less they leave to be believed.
OPEN, CLEARLY_LESS = ('parameters_undetermined', 'circle_undetermined'), 0.9
#: Things that move bend the focal length, too: factors of the ones to part them from.
BESIDE_BENT = (1.0, 0.9, 1.1)
#: A lens that zooms by more than they can bend is none that images shift by, as by a stabiliser,
#: unless shifts leave less than the second share of its noise. Stabilised images with things that
#: move left 0.87 to 0.91 of it, and seemed to zoom by 4 to 6 %.
BENDS_MOST, SHIFTED_LEAVES = max(BESIDE_BENT) / min(BESIDE_BENT), 0.8
#: Motions of single views have six times the unknowns of a zoom, and shifts of them twice as many:
#: a zoom that leaves no more than so much times what they leave explains better.
AS_ROWS, AS_SHIFTS = 1.04, 1.01


def with_any_focal(problem: SelfCalibrationProblem, graph: ViewGraph, proposals: list[Camera],
                   near: RobustFit | None = None) -> Calibration | NoEstimate:
    """Calibrate with a focal length that is constant if that is possible, else with any."""
    return OneMotion(problem, graph, proposals, near).with_any_focal()


@dataclass(frozen=True)
class OneMotion:
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
    window_views : int
        Views that the search begins with, at most.

    """

    problem: SelfCalibrationProblem
    graph: ViewGraph
    proposals: list[Camera]
    near: RobustFit | None
    window_views: int = WINDOW_VIEWS

    @cached_property
    def window(self) -> SelfCalibrationProblem:
        """The views of the starts, which do not suppose what the images may contradict."""
        window = self.problem.window(self.window_views)
        return replace(window, motion=replace(window.motion, parallel=()))

    @cached_property
    def medium(self) -> Observations:
        """The tracks on which models are chosen."""
        return self.window.observations.longest(MODEL_TRACKS_PER_VIEW)

    @property
    def _near_window(self) -> RobustFit | None:
        """The fit to start from, too, unless it is of all views and the window is not."""
        near = self.near
        return None if near is None or len(near.state.path) != self.window.views else near

    def _may_zoom(self, problem: SelfCalibrationProblem) -> bool:
        """Tell whether the focal length may vary; not in a search that begins on few views."""
        return may_zoom(problem) and self.window_views == WINDOW_VIEWS

    def with_any_focal(self) -> Calibration | NoEstimate:
        """Calibrate with a focal length that is constant if that is possible, else with any."""
        if self.problem.facts.focal == 'varying' and self.problem.instants:
            return self._zooming(None).result()
        result = self.result()
        if not result and result.kind in UNEXPLAINED and self.window.turns_round():
            few = replace(self, window_views=ROUND_WINDOWS[0]).result()
            result = few or result
        if (self._may_zoom(self.problem) and not result and result.kind in UNEXPLAINED
                and not result.values.get('zooms', False)):
            zoomed = self._zooming(None).result()
            result = zoomed if zoomed or zoomed.kind == 'two_cameras' else result
        return result

    def _zooming(self, near: RobustFit | None) -> OneMotion:
        """Return the same search with a focal length that varies, near a fit if there is one."""
        return OneMotion(zooming(self.problem), self.graph, self.proposals, near)

    def result(self) -> Calibration | NoEstimate:
        """Return the calibration, or why there is none."""
        if isinstance(self._first, NoEstimate):
            return self._first
        first, left = self._first
        shutter = self._shutter(first)
        if shutter.fit.observations.shutter is not None:
            # shifts shake the path by which rows are read in turn; motions of each view, which
            # have thrice as many unknowns, must leave less to be preferred
            most = 1.0 if shutter.fit.observations.moves_by_view else LEFT_BESIDE_ROWS
            shifted = self._by_shifts(first, shutter.fit, most, told_by=first)
            if shifted is not None:
                return shifted
        if self.window.views == self.problem.views:
            # before what moves is taken for a zoom; rows read in turn move tracks, too
            still = calibrate_still_tracks(shutter.fit, self.medium, self.problem, self.graph,
                                           with_any_focal)
            if still is None and shutter.fit.observations.moves_by_view:
                still = (self._zooming_without_rows(first, shutter.fit)
                         or self._parted_from_rows(first, shutter.fit))
            elif still is not None:
                still = self._zooming_with_all(first, still) or still
            if still is not None:
                return self._by_shifts(first, shutter.fit) or still
        return self._from(first, shutter, left)

    def _shutter(self, first: RobustFit) -> ShutterDecision:
        """Tell how the rows are read."""
        shutter = choose_shutter(first, self.medium, self.window.facts, self.window.size)
        return with_own_rows(shutter, self.medium, self.window.size)

    def _zooming_without_rows(self, first: RobustFit, rows: RobustFit) -> Calibration | None:
        """Calibrate a lens that zooms, if that leaves as little as motions of single views."""
        zoomed = self._zoomed_from(first)
        if zoomed is None or zoomed.bundle.sigma_px > AS_ROWS * rows.bundle.sigma_px:
            return None
        return self._zooming(zoomed).result() or None

    def _zooming_with_all(self, first: RobustFit, still: Calibration) -> Calibration | None:
        """Calibrate a lens that zooms, if that explains what was taken for things that move."""
        labels, given = still.labels, self.graph.given
        if labels is None or given is None or not np.any(labels.label >= MOVING):
            return None
        zoomed = self._zoomed_from(first)
        frames = np.array(self.window.instants, dtype=int)
        if zoomed is None or not explains_all(zoomed, still.noise_sigma_px,
                                              given.in_frames(frames), labels):
            return None
        return self._zooming(zoomed).result() or None

    def _zoomed_from(self, first: RobustFit) -> RobustFit | None:
        """Fit a lens that zooms to all that a fit was to explain; None if it may not zoom."""
        if not self._may_zoom(self.problem) or first.motion.zoom is not None:
            return None
        zoomed = zoomed_fit(first, self.window.instants)
        state = with_all_points(zoomed.state, self.medium)
        return None if state is None else fit_robustly(
            self.medium, state, zoomed.motion, zoomed.bundle.priors, zoomed.bundle.sigma_px)

    def _parted_from_rows(self, first: RobustFit, rows: RobustFit) -> Calibration | None:
        """Calibrate without what moves, if that and no motion of single views explains it."""
        bent = first.state.camera(*self.problem.size)
        return calibrate_coherent_tracks(self.problem, self.graph, [bent], with_any_focal,
                                         rows) or None

    def _by_shifts(self, first: RobustFit, fit: RobustFit, most: float = LEFT_AT_FIRST,
                   told_by: RobustFit | None = None) -> Calibration | None:
        """Calibrate images that are shifted, each by itself, if that leaves so much less."""
        shifted = with_image_shifts(first, told_by or fit, self.medium, self.window, most)
        if shifted is None:
            return None
        shutter = choose_shutter(shifted, self.medium, self.window.facts, self.window.size)
        if (shutter.fit.bundle.sigma_px > most * fit.bundle.sigma_px
                or not are_within_crop(shutter.fit, self.window.size)):
            return None
        zoomed = self._zoomed_from(first)
        if zoomed is not None and zoomed.bundle.sigma_px < AS_SHIFTS * shutter.fit.bundle.sigma_px:
            return None
        return self._from(shifted, shutter, None) or None

    def first_focal_px(self) -> float:
        """Return the focal length of the first fit, pixels; NaN where there is none."""
        first = self._first
        return np.nan if isinstance(first, NoEstimate) else float(first[0].state.lens['f'])

    @cached_property
    def _first(self) -> tuple[RobustFit, NoEstimate | None] | NoEstimate:
        """The first fit, and what its start leaves unexplained."""
        start = self._start()
        if isinstance(start, NoEstimate):
            return start
        fit = self._first_fit(start[0])
        return fit if isinstance(fit, NoEstimate) else (fit, start[1])

    def _start(self) -> tuple[SceneState, NoEstimate | None] | NoEstimate:
        """Return a start, and what it leaves unexplained if that may be rows read in turn."""
        problem = self.problem
        started = best_start(self.window, [*self._of_few_views(), *self.proposals])
        if isinstance(started, NoEstimate):
            return started
        start, noise_px = started
        near = self._near_window
        if near is not None and not noise_px < EXPLAINED * problem.noise_px:
            start, noise_px = undisturbed(near.state), near.bundle.sigma_px
        as_far_as_told = 'general' if problem.motion.keeps_plane else 'unknown'
        if start is None or not np.isfinite(noise_px):
            return NoEstimate('no_start', noise_px=problem.noise_px, motion=as_far_as_told)
        if noise_px < EXPLAINED * problem.noise_px:
            return start, None
        left = NoEstimate('tracks_unexplained', left_px=float(noise_px),
                          noise_px=problem.noise_px, motion=as_far_as_told)
        return (start, left) if may_be_rolling(self.window, noise_px) else left

    def _of_few_views(self) -> list[Camera]:
        """
        Propose a camera by fewer views, then by more, where the path may close a loop.

        The turns between the views of a loop contradict each other by any other focal length.
        """
        found: list[Camera] = []
        for most in ROUND_WINDOWS if self.window.turns_round() else ():
            few = self.window.window(most)
            started = best_start(few, [*found, *self.proposals])
            if not isinstance(started, NoEstimate) and started[0] is not None:
                found = [started[0].camera(*few.size)]
        return found

    def _first_fit(self, start: SceneState) -> RobustFit | NoEstimate:
        """Fit the medium tracks, and mend what starts have wrong."""
        problem, window, medium = self.problem, self.window, self.medium
        near = self._near_window
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
        # a torn path seems to turn on the spot
        fit = turned_about(continued(fit, medium, window), medium, window)
        fit = mended(fit, medium, window)
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
            return self._by_shifts(first, fit) or left
        if self._is_out_of_plane(fit.state):
            return not_planar(out_of_plane_rad(fit.state.path))
        mixed = of_two_cameras(fit, window, self.graph)
        if mixed is not None:
            return mixed
        if contradicted(fit, window):
            # it was held against a zoom
            shifted = self._by_shifts(first, fit, LEFT_AT_LAST)
            if shifted is not None:
                return shifted
            return (parted_or_zooming(self.problem, self.graph, self.proposals, first, fit)
                    if self._may_zoom(self.problem) else NoEstimate(NOT_CONSTANT))
        if fit.motion.zoom is not None:
            fit = settle_zoom(fit, window.facts, window.size)
        held = self._held_parallel(fit)
        if isinstance(held, NoEstimate):
            return held
        fit, turned = held
        model = shutter.widened(choose_model(
            window, fit, len(self.medium.view) / len(self.problem.observations.view)))
        if (self._plane_is_open(model.fit.state)
                and leaves_plane(model, self.medium, self.problem.size)):
            return not_planar(out_of_plane_rad(model.fit.state.path))
        # before all views are fitted: what a good lens and a good path still leave
        shifted = self._by_shifts(first, model.fit, LEFT_BESIDE_ROWS
                                  if model.fit.observations.shutter else LEFT_AT_LAST)
        if shifted is not None:
            return shifted
        return self._assessed(model, first, (*shutter.findings, *turned))

    def _held_parallel(self, fit: RobustFit,
                       ) -> tuple[RobustFit, tuple[Finding, ...]] | NoEstimate:
        """Hold views parallel that are said to be, unless they measurably are not."""
        parallel = self.problem.window(self.window_views).motion.parallel
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
        if not result and result.kind == NOT_CONSTANT and self._may_zoom(problem):
            # a lens that was chosen is no fact
            return parted_or_zooming(replace(problem, facts=stated.facts), graph,
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

    def _plane_is_open(self, state: SceneState) -> bool:
        """Tell whether a plane that nobody stated is to be held against free motion."""
        return self._turns_little(state) or (self._supposes_plane
                                             and self.problem.views < VIEWS_OF_A_PLANE)

    def _turns_little(self, state: SceneState) -> bool:
        """Tell whether turns are small beside the unevenness that a supposed plane may have."""
        return (self._supposes_plane
                and widest_turn_rad(state.path.rotations()) < LITTLE_TURN_RAD)

    @property
    def _supposes_plane(self) -> bool:
        return self.problem.motion.keeps_plane and self.problem.supposes_plane


def _unbent(fit: RobustFit, result: Calibration, problem: SelfCalibrationProblem,
            graph: ViewGraph) -> Calibration:
    """Calibrate without few tracks that bend the estimate, if there are such; else as it is."""
    if graph.given is None or not problem.instants or not may_be_bent(result):
        return result
    rest = unbent_fit(fit, problem, result.sigma, MODEL_TRACKS_PER_VIEW)
    still = rest and calibrate_sorted(rest, problem, graph, with_any_focal, least=0.0)
    return still or result


def parted_or_zooming(problem: SelfCalibrationProblem, graph: ViewGraph,
                      proposals: list[Camera], first: RobustFit, near: RobustFit,
                      ) -> Calibration | NoEstimate:
    """Part what moves, which bends the path until a zoom seems to mend it; else let it zoom."""
    # rows that are read in turn move tracks, too: a zoom without them explains less than it would
    told = first if near.observations.shutter is None else near
    rival = zoomed_fit(told, problem.window().instants)
    bent = first.state.camera(*problem.size)
    parted = calibrate_coherent_tracks(problem, graph, [
        bent.magnified(factor) for factor in BESIDE_BENT], with_any_focal, rival)
    if parted and not any(one.kind == 'images_shifted' for one in parted.findings):
        return parted
    zoomed = OneMotion(zooming(problem), graph, proposals, near).result()
    if parted:
        return zoomed if zoomed and _zooms_far(zoomed, parted) else parted
    return parted if parted is not None and is_less_open(parted, zoomed) else zoomed


def _zooms_far(zoomed: Calibration, shifted: Calibration) -> bool:
    """Tell whether a lens zooms by more than things that move feign, or shifts explain."""
    return (zoomed.focal is not None
            and zoomed.focal.fx.max() > BENDS_MOST * zoomed.focal.fx.min()
            and shifted.noise_sigma_px > SHIFTED_LEAVES * zoomed.noise_sigma_px)


def left_by(refusal: NoEstimate) -> float:
    """Return the residual noise of the refused estimate, pixels; infinite if it is not told."""
    return float(refusal.values.get('left_px', np.inf))


def is_less_open(refusal: NoEstimate, result: Calibration | NoEstimate) -> bool:
    """Tell whether an underdetermined camera has clearly smaller residuals than a result."""
    left_px = result.noise_sigma_px if result else left_by(result)
    return refusal.kind in OPEN and left_by(refusal) < CLEARLY_LESS * left_px
