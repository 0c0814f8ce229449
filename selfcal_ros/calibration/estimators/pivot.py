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
A camera that turns about a fixed point beside it: a pan-tilt head, a wrist, a turn on the spot.

Beside large rotations a small translation is nearly confounded with focal length and principal
point. Rotations alone then explain the images with a bias, and free translations explain them
also inside out, each with sigmas that are far too small. What the camera did has three unknowns,
the lever from it to that point, and with these the optimum is as well behaved as any.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.centres import all_rays
from selfcal_ros.calibration.bundle.depths import cost_of_all_ahead, seen_ahead
from selfcal_ros.calibration.bundle.motion import GENERAL, PIVOT, ROTATION
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.point_of_rest import resting_near
from selfcal_ros.calibration.bundle.priors import Priors, with_fixed
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, fit_robustly, is_chance,
                                                       Observations, refit, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_CHOOSE, TO_GO_ON
from selfcal_ros.calibration.estimators.image_shift_choice import (are_within_crop,
                                                                   LEFT_AT_LAST,
                                                                   with_image_shifts)
from selfcal_ros.calibration.estimators.lens_selection import with_lens
from selfcal_ros.calibration.estimators.model_selection import (choose_model, first_fit,
                                                                ModelDecision, with_open_lens)
from selfcal_ros.calibration.estimators.motion_problem import of_two_cameras
from selfcal_ros.calibration.estimators.rotation import (middle_stretch, RotationFit,
                                                         STRETCH_TRACKS_PER_VIEW)
from selfcal_ros.calibration.estimators.shutter_choice import choose_shutter, ShutterDecision
from selfcal_ros.calibration.estimators.zoom_selection import (contradicted, may_zoom,
                                                               near_state, settle_zoom,
                                                               zoomed_fit, zooming)
from selfcal_ros.calibration.initialisation.pivot_start import completed_rotations, PivotPath
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.observability import LEAST_NOISE_PX
from selfcal_ros.calibration.uncertainty.cluster_covariance import robust_covariance_of
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.lenses.catalogue import LensChoice
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import unit
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Free translations beside a short lever are not regular unknowns, and lower the cost by up to
#: five times what their number lets expect though the point is fixed.
NEARLY_FIXED = 6.0
#: Where more than this share of the observations contradict, it is the point that moves. A tenth
#: of gross errors, of which pairs of images show but a part, is no such sign.
MOST_LOST = 0.15
#: Where the likeliest turn leaves more than so many times the noise, and so do rotations alone, no
#: model of lens or shutter makes a turn of it.
HOPELESS = 4.0
#: A lever longer than the usual depth of the points is none: the views lie on a piece of a path,
#: which turns of any far point explain. True levers had up to 0.4 of the depth, those 20 to 60.
LONGEST_LEVER = 1.0
#: What is on the way to such a path already, of starts and of a first fit. Levers of drives were
#: 3 and more on the way, and 13 and more in the end; of turns 0.6 at most.
FAR_LEVER = 2.0
#: A turn about a point is taken up to this ratio to the noise of pairs.
MAX_NOISE_OF_PIVOT = 1.5
#: A turn with another focal length than rotations alone, by this in its logarithm, may owe it to a
#: lens of the wrong family. True levers of heads change it by 0.04; bent ones by 0.75 and more.
FOREIGN_FOCAL = 0.2
#: The same turn behind a lens of the other kind may cost so many times as much.
AS_LIKELY = 1.03
#: Starts that leave less than so many times what the best one leaves may be the right ones.
LIKELY = 1.5
#: Tracks a view to find a turn with. Near points show a lever best. They are seen in few views,
#: and are the first to go where fewer tracks are taken; then a few wrong matches make the lever.
TRACKS_PER_VIEW = 400
#: Starts on the longest tracks, of which the fewest are wrong, are tried, too.
FEW_TRACKS_PER_VIEW = 40
#: Focal lengths and levers of starts that come together differ by less than this share of them.
SAME_FOCAL, SAME_LEVER = 0.003, 0.2
#: So many times, before what is left of the starts is known well, is worth a closer look.
PROMISING = 3.0


@dataclass(frozen=True)
class PivotDecision:
    """
    What the images say of a turn about a fixed point.

    Attributes
    ----------
    model : ModelDecision
    rotation_excess, rotation_freedom : float
        Twice the rise of the cost where the camera only turns, and how many unknowns less.
    general_excess, general_freedom : float
        Twice the fall of the cost where it translates freely, and how many unknowns more.
    moved_share : float
        Extent of the camera's path over the usual depth of the points.
    lever_share : float
        Distance of the camera from the point over that depth.

    """

    model: ModelDecision
    rotation_excess: float
    rotation_freedom: float
    general_excess: float
    general_freedom: float
    moved_share: float
    lever_share: float

    @property
    def is_rotation(self) -> bool:
        """Tell whether there may be no lever at all, by a likelihood ratio at 4 sigma."""
        return is_chance(self.rotation_excess, self.rotation_freedom)

    @property
    def holds(self) -> bool:
        """Tell whether the point may be fixed."""
        fit = self.model.fit
        lost = fit.outliers / (fit.outliers + len(fit.observations.view))
        return (lost < MOST_LOST and self.lever_share < LONGEST_LEVER
                and self.general_excess < NEARLY_FIXED * self.general_freedom)


def decide_pivot(problem: SelfCalibrationProblem, graph: ViewGraph, turning: RotationFit,
                 ) -> tuple[SelfCalibrationProblem, PivotDecision] | NoEstimate:
    """
    Explain views by turns about a fixed point.

    Parameters
    ----------
    problem : SelfCalibrationProblem
    graph : ViewGraph
    turning : RotationFit
        The same views by rotations alone.

    Returns
    -------
    SelfCalibrationProblem
        With the path that was found.
    PivotDecision
        No estimate where it does not turn, or nothing to start with is found.

    """
    turned, xy = turning.lens.fit.state, turning.lens.fit.observations.xy
    if turned.lens.model.is_perspective:
        turned = with_lens(turned, xy, 'plumb_bob')
    found = _decided(problem, graph, turning, turned)
    if not found or problem.facts.distortion != 'auto' or not _has_foreign_focal(found, turned):
        return found
    if found[1].model.fit.bundle.sigma_px > MAX_NOISE_OF_PIVOT * found[0].noise_px:
        # a path: lens families differ by a tenth of what heads leave
        return found
    # a short lever looks long behind a lens of another kind
    for family in ('equidistant', 'plumb_bob'):
        other = _with_family(turned, xy, family)
        rival = None if other is None else _decided(
            replace(problem, facts=replace(problem.facts, distortion=family)), graph, turning,
            other)
        if (rival and (rival[1].is_rotation or not _has_foreign_focal(rival, turned))
                and _is_as_likely(rival[1].model.fit, found[1].model.fit)):
            return replace(rival[0], facts=problem.facts), rival[1]
    return found


def _decided(problem: SelfCalibrationProblem, graph: ViewGraph, turning: RotationFit,
             turned: SceneState) -> tuple[SelfCalibrationProblem, PivotDecision] | NoEstimate:
    """Explain views by turns about a fixed point, from the rotations of one camera."""
    rotations = _of_all_views(problem, graph, turning, turned)
    if rotations is None:
        return NoEstimate('no_start', noise_px=problem.noise_px, motion='unknown')
    problem = replace(problem, motion=PIVOT, is_weak=True, pivot=PivotPath(rotations, np.zeros(3)))
    found = _turning_fit(problem, turning, turned)
    if isinstance(found, NoEstimate):
        return found
    problem, medium, shutter = found
    window = problem.window()
    mixed = of_two_cameras(shutter.fit, window, graph)
    if mixed is not None:
        return mixed
    shifted = with_image_shifts(shutter.fit, shutter.fit, medium, window, LEFT_AT_LAST)
    if shifted is not None and are_within_crop(shifted, window.size):
        shutter = replace(shutter, fit=shifted)
    elif contradicted(shutter.fit, window):
        problem, window = zooming(problem), zooming(window)
        shutter = choose_shutter(_zoomed_fit(shutter.fit, window, medium, turned), medium,
                                 window.facts, window.size)
    fit = shutter.fit
    if fit.motion.zoom is not None:
        fit = settle_zoom(fit, window.facts, window.size)
    model = shutter.widened(
        choose_model(window, fit, len(medium.view) / len(problem.observations.view)))
    # points go on to be placed anew: those behind the cameras would be put at infinity
    fit = seen_ahead(model.fit)
    model = replace(model, fit=fit)
    assert problem.pivot is not None
    problem = replace(problem, pivot=replace(problem.pivot,
                                             lever=fit.state.path.translation[0]))
    variance_inflation = robust_covariance_of(fit, problem.size).variance_inflation
    still = refit(fit, ROTATION.with_images_of(fit.motion), _without_lever(fit.state))
    free = refit(fit, GENERAL.with_images_of(fit.motion))
    return problem, PivotDecision(
        model, 2 * (still.cost - fit.cost) / variance_inflation, len(fit.state.points) + 2,
        2 * (fit.cost - free.cost) / variance_inflation,
        free.bundle.unknowns.count - fit.bundle.unknowns.count,
        extent_share(fit.state.path.centres(), fit.state.points), _lever_share(fit.state))


def _turning_fit(problem: SelfCalibrationProblem, turning: RotationFit, turned: SceneState,
                 ) -> tuple[SelfCalibrationProblem, Observations, ShutterDecision] | NoEstimate:
    """Fit the medium tracks by turns about a point; where it must, the focal length varies."""
    window = problem.window()
    moved = NoEstimate('moved_not_rotated', left_px=turning.left_px, noise_px=problem.noise_px)
    is_no_rotation = turning.left_px > HOPELESS * problem.noise_px
    start = best_pivot_start(window, turned, FAR_LEVER if is_no_rotation else np.inf)
    if isinstance(start, NoEstimate):
        return start
    if is_no_rotation and _lever_share(start) > FAR_LEVER:
        return moved
    medium = window.observations.longest(TRACKS_PER_VIEW)
    standing = with_all_points(start, medium)
    if standing is None:
        return NoEstimate('start_distortion_not_invertible')
    fit = first_fit(window, medium, standing)
    if is_no_rotation and _is_hopeless(fit, problem):
        zoomed = _zoomed_fit(fit, zooming(window), medium, turned) if may_zoom(window) else fit
        if _is_hopeless(zoomed, problem):
            return moved.saying(left_px=fit.bundle.sigma_px)
        problem, fit = zooming(problem), zoomed
    return problem, medium, choose_shutter(fit, medium, window.facts, window.size)


def _with_family(state: SceneState, xy: np.ndarray, family: LensChoice) -> SceneState | None:
    """Return a state with the nearest lens of a family; None where none bends so."""
    state = with_lens(state, xy, family)
    try:
        state.camera()
    except ArgumentError:
        return None
    return state


def _has_foreign_focal(found: tuple[SelfCalibrationProblem, PivotDecision],
                       turned: SceneState) -> bool:
    """Tell whether a turn about a point has quite another focal length than rotations have."""
    lens = found[1].model.fit.state.lens
    return bool(abs(np.log(lens['f'] / turned.lens['f'])) > FOREIGN_FOCAL)


def _is_as_likely(rival: RobustFit, fit: RobustFit) -> bool:
    noise_px = min(rival.bundle.sigma_px, fit.bundle.sigma_px)
    return cost_of_all_ahead(rival, noise_px) < AS_LIKELY * cost_of_all_ahead(fit, noise_px)


def _is_hopeless(fit: RobustFit, problem: SelfCalibrationProblem) -> bool:
    """Tell whether what a turn leaves, or its lever, is too much for any model."""
    return (fit.bundle.sigma_px > HOPELESS * problem.noise_px
            or _lever_share(fit.state) > FAR_LEVER)


def _zoomed_fit(fit: RobustFit, problem: SelfCalibrationProblem, medium: Observations,
                turned: SceneState) -> RobustFit:
    """Fit with any focal lengths: what a constant one left is no measure of the noise."""
    near = near_state(zoomed_fit(fit, problem.instants), medium)
    # the lever, too, may be that of a constant focal length
    start = best_pivot_start(problem, turned)
    anew = None if isinstance(start, NoEstimate) else with_all_points(start, medium)
    fits = [first_fit(problem, medium, state) for state in (near, anew) if state is not None]
    return min(fits, key=lambda one: cost_of_all_ahead(one, problem.noise_px)) if fits else fit


def _of_all_views(problem: SelfCalibrationProblem, graph: ViewGraph, turning: RotationFit,
                  state: SceneState) -> np.ndarray | None:
    """Return orientations (V, 3, 3) from the first view; None where some cannot be had."""
    views, known = np.searchsorted(graph.frames, turning.frames), np.isin(turning.frames,
                                                                          graph.frames)
    rotations = np.full((len(graph.frames), 3, 3), np.nan)
    rotations[views[known]] = state.path.cam_from_world()[known, :, :3]
    if np.isnan(rotations).any():
        # homographies, which know no lens, do not reach every view
        seen = problem.observations
        rays = all_rays(state.camera(*problem.size), seen.xy)
        every = (completed_rotations(PointBlocks(seen.point, seen.view), rays, rotations)
                 if np.isfinite(rays).all() else None)
        if every is None:
            return None
        rotations = every
    turned: np.ndarray = rotations @ rotations[0].T
    return turned


def left_by_turns(graph: ViewGraph, camera: Camera) -> float:
    """
    Tell what a camera that only turned would leave of the images, in closed form.

    Of a long recording a stretch in the middle is asked, of many tracks a share.

    Parameters
    ----------
    graph : ViewGraph
    camera : Camera
        With its lens.

    Returns
    -------
    float
        The median misfit over the noise of pairs; infinite where views share too few points.

    """
    frames = middle_stretch(graph.frames)
    tracks = graph.tracks.in_frames(frames).thinned(STRETCH_TRACKS_PER_VIEW)
    seen = Observations.of(tracks, frames)
    blocks, rays = PointBlocks(seen.point, seen.view), all_rays(camera, seen.xy)
    rotations = np.full((len(frames), 3, 3), np.nan)
    rotations[0] = np.eye(3)
    every = (completed_rotations(blocks, rays, rotations) if np.isfinite(rays).all() else None)
    if every is None:
        return np.inf
    turned = np.einsum('nji,nj->ni', every[seen.view], rays)
    mean = unit(blocks.sum_over_points(turned))
    misfit = np.linalg.norm(turned - mean[seen.point], axis=1)
    return float(np.median(misfit) * camera.K[0, 0] / max(graph.noise_px, LEAST_NOISE_PX))


def extent_share(centres: np.ndarray, points: np.ndarray) -> float:
    """Extent of the camera's path (V, 3) over the usual depth of points, homogeneous (P, 4)."""
    return float(np.linalg.norm(np.ptp(centres, axis=0))) * _inverse_depth(centres, points)


def _inverse_depth(centres: np.ndarray, points: np.ndarray) -> float:
    # not from the point that rests: along a common axis of all turns it may be anywhere
    far = np.linalg.norm(points[:, :3] - points[:, 3:] * centres.mean(axis=0), axis=1)
    return float(np.median(np.abs(points[:, 3]) / np.maximum(far, 1e-300)))


def _lever_share(state: SceneState) -> float:
    """Return the length of the lever over the usual depth of points."""
    return float(np.linalg.norm(_lever(state)))


def _lever(state: SceneState) -> np.ndarray:
    """Return the lever (3,) in the camera's frame over the usual depth of points."""
    lever: np.ndarray = state.path.translation[0] * _inverse_depth(state.path.centres(),
                                                                   state.points)
    return lever


def best_pivot_start(problem: SelfCalibrationProblem, turned: SceneState,
                     far_lever: float = np.inf) -> SceneState | NoEstimate:
    """
    Follow levers in several directions on few and on many of the tracks; take the likeliest.

    No estimate where nothing starts, or where all that are likely have a lever beyond
    `far_lever`, in shares of the points' depth.
    """
    many = problem.observations.longest(TRACKS_PER_VIEW)
    # what a lens of fewer terms leaves looks like a lever
    turned, priors = with_open_lens(problem, many, turned)
    begun = _begun(problem, turned, priors)
    near_px = PROMISING * min((noise_px for noise_px, _ in begun), default=np.inf)
    standing = [with_all_points(state, many) for noise_px, state in begun if noise_px < near_px]
    fine = bundle_of(many, problem.motion, priors, 1.5 * problem.noise_px)
    states = [fine.optimise(state, iterations=15, tolerance=TO_CHOOSE)
              for state in standing if state is not None]
    if not states:
        return NoEstimate('no_start', noise_px=problem.noise_px, motion='unknown')
    left_px = [fine.noise_sigma(state) for state in states]
    least_px = min(left_px)
    if all(_lever_share(state) > far_lever for noise_px, state in zip(left_px, states)
           if noise_px < LIKELY * least_px):
        return NoEstimate('moved_not_rotated', left_px=least_px, noise_px=problem.noise_px)
    # what they leave on the way tells little: the right one was the last of eight
    rivals = []
    for k, (noise_px, state) in enumerate(zip(left_px, states)):
        if any(_is_same_turn(state, other) for other in states[:k]):
            continue
        # far along a common axis of all turns it would end in a false optimum
        start = with_all_points(resting_near(state) or state, many)
        if start is not None:
            rivals.append(fit_robustly(many, start, problem.motion, priors, noise_px, rounds=3))
    # the mirror image of a scene explains its images about as well
    return (min(rivals, key=lambda one: cost_of_all_ahead(one, least_px)).state if rivals
            else NoEstimate('no_start', noise_px=problem.noise_px, motion='unknown'))


def _begun(problem: SelfCalibrationProblem, turned: SceneState, priors: Priors,
           ) -> list[tuple[float, SceneState]]:
    """Return what the first steps of every start leave, pixels, and where they lead."""
    assert problem.pivot is not None
    seen, camera = problem.observations, turned.camera(*problem.size)
    begun = []
    for tracks_per_view in (FEW_TRACKS_PER_VIEW, TRACKS_PER_VIEW):
        some = seen.longest(tracks_per_view)
        coarse = bundle_of(some, problem.motion, priors, 5 * problem.noise_px)
        for state in problem.pivot.starts(coarse.blocks, some.xy, camera):
            state = coarse.refine_points(with_fixed(state, priors))
            state = coarse.optimise(state, iterations=15, tolerance=TO_GO_ON)
            noise_px = coarse.noise_sigma(state)
            if np.isfinite(noise_px):
                begun.append((noise_px, state))
    return begun


def _is_same_turn(state: SceneState, other: SceneState) -> bool:
    """Tell whether two states are on the way to one optimum; mirror images need not be."""
    first, second = _lever(state), _lever(other)
    return bool(abs(state.lens['f'] / other.lens['f'] - 1) < SAME_FOCAL
                and np.linalg.norm(first - second) < SAME_LEVER * np.linalg.norm(first))


def _without_lever(state: SceneState) -> SceneState:
    """Return the state of a camera that only turns, the points in their mean directions."""
    path = AxisPath(state.path.mount, state.path.angle, state.path.tilt,
                    np.zeros_like(state.path.translation))
    points = state.points * [1.0, 1.0, 1.0, 0.0]
    return replace(state, path=path,
                   points=points / np.linalg.norm(points, axis=1, keepdims=True))
