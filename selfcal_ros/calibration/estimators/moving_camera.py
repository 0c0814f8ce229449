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
How did the camera move? It turned, turned about a point beside it, moved in a plane, or freely.

Small translations beside large rotations look like rotations, and the other way round. So the
simpler motions are tried where little parallax lets them pass, and the path through the scene is
held against what they leave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.estimators.all_views import finish, NOT_CONSTANT, settled
from selfcal_ros.calibration.estimators.motion_calibration import (calibrate_from_motion,
                                                                   MOTION_MODELS, UNEXPLAINED)
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.estimators.pivot import (decide_pivot, left_by_turns,
                                                      MAX_NOISE_OF_PIVOT)
from selfcal_ros.calibration.estimators.rotation import (calibrate_rotating, fit_rotations,
                                                         judge_rotations, RotationFit)
from selfcal_ros.calibration.estimators.sliding_images import LONG
from selfcal_ros.calibration.estimators.turning_cameras import of_two_turning
from selfcal_ros.calibration.initialisation.one_plane import on_one_plane
from selfcal_ros.calibration.initialisation.supposed_lens import is_strong
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.two_view_tests import PARALLAX_RATIO

# Parallax: the misfit of homographies over that of epipolar geometry, in pairs of views.

#: With fewer views a small translation hides in the noise, yet moves the calibration by several
#: sigmas: that the camera only rotates must then be said.
MIN_VIEWS_OF_ROTATION = 5
#: Rotation alone is tried below this parallax of the best pairs. Lens distortion raises it, too.
MAX_PARALLAX_OF_BEST = 10.0
#: And below this parallax of the pair in the middle. A lens that bends lines leaves up to 20 where
#: large turns show it: a head was taken for a free hand at 12.
MAX_PARALLAX_OF_MIDDLE = 25.0

# Noise: what a motion leaves, over what pairs of views leave or over what another motion does.

#: The search for rotations ends where its first start leaves this many times the noise.
MAX_NOISE_OF_START = 20.0
#: A turn about a point is tried where rotations leave less than this many times the noise.
MAX_NOISE_NEAR_TURN = 16.0
#: Rotations are taken up to this ratio to a free path: depths that rest on so little would lead
#: the calibration astray.
MAX_NOISE_OF_ROTATION = 1.2
#: The same where rotations need a long lens: over a plane that is nearly parallel to the image a
#: path leaves the focal length open, and a turn behind such a lens looks much the same.
MAX_NOISE_BEHIND_LONG_LENS = 1.02
#: The same where no pair shows parallax: the noise of pairs is known to some 3 %, and a drive with
#: the smallest of steps is no turn.
MAX_NOISE_OF_HIDDEN_PIVOT = 1.1
#: A turn that leaves more than this ratio to the noise of pairs is held against a free path.
MAX_NOISE_OF_SURE_PIVOT = 1.04
#: A free path is preferred to a turn where it leaves less than this share of what that leaves.
CLEARLY_LESS_NOISE = 0.97
#: A free path is weak where rotations leave less than this many times the noise in the middle.
#: Heads with a lever of 8 cm leave 1 to 8, drives and hands 24 and more.
MAX_NOISE_OF_WEAK_PATH = 10.0

#: A free path that knows the focal length to no more than this share of it is weak, too: behind a
#: fisheye pairs of a head's views show what looks like parallax.
WEAK_FOCAL = 0.03
#: One that knows it to no more than this share is held against rotations alone: a head behind a
#: fisheye was taken for a hand, 140 % off and 1.9 % sure.
COARSE_FOCAL = 0.01

#: A path is short when its extent is less than this share of the points' depth. A longer one
#: shows in the images, and needs no model of its own.
SHORT_PATH = 0.3
#: Where rotations leave less than this many times the noise, what moved was too little to change
#: the logarithm of the focal length by more: heads with a lever changed it by up to 0.04.
MAX_NOISE_OF_LIKE_TURN, MAX_FOCAL_CHANGE = 2.0, 0.1

#: Refusals of circular motion, which name the fact that is missing.
OF_CIRCLES = ('flat_turntable', 'circle_undetermined')
#: Refusals of paths that explain the images, whatever the focal length is.
OF_OPEN_PATH = ('parameters_undetermined', 'unlike_rotations', *OF_CIRCLES)


@dataclass(frozen=True)
class Turn:
    """
    A camera that only turns, about its centre or a point beside it.

    Attributes
    ----------
    result : Calibration or NoEstimate
        The refusal of facts or lens that do not go with the turn, perhaps.
    noise_px : float
        What the turn leaves.

    """

    result: Calibration | NoEstimate
    noise_px: float

    @property
    def leaves_open(self) -> bool:
        """Tell whether parameters of the camera stay open, as they may not by a path."""
        return (isinstance(self.result, NoEstimate)
                and self.result.kind == 'parameters_undetermined')

    def is_sure(self, pairs_noise_px: float) -> bool:
        """Tell whether no path needs to be tried, by the noise that pairs of views leave."""
        if self.result:
            return self.noise_px <= MAX_NOISE_OF_SURE_PIVOT * pairs_noise_px
        # a path that only looks like a turn contradicts facts and lens, too
        return (self.result.kind not in ('fact_contradicted', 'smooth_misfit')
                and not self.leaves_open)


@dataclass(frozen=True)
class MovingCamera:
    """
    Views of a camera that moved in a way that has to be found.

    Attributes
    ----------
    graph : ViewGraph
    size : (int, int)
        Width and height, pixels.
    facts : CameraFacts
    motion : {'auto', 'planar', 'general'}
        Which paths are allowed.
    proposals : list of Camera
        Tried first.

    """

    graph: ViewGraph
    size: tuple[int, int]
    facts: CameraFacts
    motion: str
    proposals: list[Camera]

    @property
    def has_enough_views(self) -> bool:
        """Tell whether rotations could be told from small translations."""
        return len(self.graph.frames) >= MIN_VIEWS_OF_ROTATION

    @property
    def has_little_parallax(self) -> bool:
        """Tell whether hardly any pair of views shows parallax."""
        return self.has_enough_views and self.graph.parallax < MAX_PARALLAX_OF_BEST

    @property
    def may_turn(self) -> bool:
        """Tell whether most pairs show so little parallax that the camera may only have turned."""
        return self.has_little_parallax or (
            self.has_enough_views and self.graph.usual_parallax < MAX_PARALLAX_OF_MIDDLE)

    def rotations(self) -> RotationFit | NoEstimate:
        """Fit rotations alone."""
        graph = self.graph
        # what a strong lens leaves of a rotation says nothing before the lens is fitted
        any_noise = self.has_little_parallax and (
            graph.parallax < PARALLAX_RATIO or is_strong(graph.bend))
        return fit_rotations(graph.tracks, self.size, self.facts,
                             np.inf if any_noise else MAX_NOISE_OF_START * graph.noise_px)

    def path(self, rotations: RotationFit | NoEstimate | None, is_weak: bool,
             ) -> Calibration | NoEstimate:
        """Calibrate from a translating camera; refused where rotations alone fit as well."""
        return self.unless_like_turns(calibrate_from_motion(
            self.graph, self.size, self.facts, self.proposals, MOTION_MODELS[self.motion],
            is_weak=is_weak), rotations)

    def over_a_plane(self, graph: ViewGraph) -> Calibration | NoEstimate:
        """Calibrate from a path over points in one plane."""
        return calibrate_from_motion(graph, self.size, self.facts, [],
                                     MOTION_MODELS[self.motion], flat=True)

    def about_a_point(self, rotations: RotationFit) -> Turn | None:
        """Try whether the camera only turns, about its centre or a point beside it."""
        graph = self.graph
        hidden = graph.parallax < PARALLAX_RATIO
        if hidden and rotations.left_px < MAX_NOISE_OF_ROTATION * graph.noise_px:
            return None
        problem = problem_of(graph, self.size, self.facts, turns=True)
        if isinstance(problem, NoEstimate):
            return None
        decided = decide_pivot(problem, graph, rotations)
        if isinstance(decided, NoEstimate):
            return None
        problem, decision = decided
        noise_px = decision.model.fit.bundle.sigma_px
        if decision.is_rotation and self.motion == 'auto':
            rotating = judge_rotations(rotations, may_zoom=False, may_miss=True)
            if rotating:
                return Turn(rotating, noise_px)
        # a lever that no pair shows has to explain all that rotations leave
        explained = noise_px < problem.noise_px * (
            MAX_NOISE_OF_HIDDEN_PIVOT if hidden else MAX_NOISE_OF_PIVOT)
        if not (decision.holds and explained and decision.moved_share < SHORT_PATH):
            return None
        result = self.unless_like_turns(finish(
            settled(problem, decision.model), decision.model, graph, self.facts), rotations)
        # a focal length that varies is for the free motions
        if not result and result.kind in (NOT_CONSTANT, *UNEXPLAINED):
            return None
        return Turn(result, noise_px)

    def rotation_or(self, path: Calibration | NoEstimate,
                    rotations: RotationFit | NoEstimate | None) -> Calibration | NoEstimate:
        """Choose between rotations, a path, and one over a plane, with little parallax."""
        if rotations is None:
            rotating = calibrate_rotating(self.graph.tracks, self.size, self.facts, not path,
                                          may_miss=True)
        else:
            rotating = (judge_rotations(rotations, may_miss=True)
                        if isinstance(rotations, RotationFit) else rotations)
        hidden = not path and self.graph.parallax < PARALLAX_RATIO
        if hidden and (not rotating or self._leaves_much(rotating)):
            # what no pair shows in its noise, many views may
            plane = self.over_a_plane(self.graph)
            # a plane that turns in itself is not for want of parallax
            path = plane if _settles(plane) else path
        if rotating:
            simpler = not _hides_path(rotating, path) and (
                not path
                or rotating.noise_sigma_px <= MAX_NOISE_OF_ROTATION * path.noise_sigma_px)
            if simpler and not path and rotating.focal and self._leaves_much(rotating):
                # a zoom of every view, or a step ahead: the images do not tell
                return NoEstimate('moved_not_rotated', left_px=rotating.noise_sigma_px,
                                  noise_px=self.graph.noise_px, facts=rotating.facts)
            return rotating if self.motion == 'auto' and simpler else path
        return path

    def _leaves_much(self, rotating: Calibration) -> bool:
        """Tell whether rotations leave more than pairs of views do."""
        return rotating.noise_sigma_px > MAX_NOISE_OF_ROTATION * self.graph.noise_px

    def unless_like_turns(self, result: Calibration | NoEstimate,
                          rotations: RotationFit | NoEstimate | None,
                          ) -> Calibration | NoEstimate:
        """Refuse a path if rotations fit as well, with a quite different focal length."""
        if (not isinstance(rotations, RotationFit) or isinstance(result, NoEstimate)
                or rotations.left_px > MAX_NOISE_OF_LIKE_TURN * self.graph.noise_px):
            return result
        turned_px, focal_px = rotations.lens.fit.state.lens['f'], float(result.camera.K[0, 0])
        if abs(np.log(focal_px / turned_px)) < MAX_FOCAL_CHANGE:
            return result
        return NoEstimate('unlike_rotations', focal_px=focal_px, turned_px=float(turned_px),
                          left_px=result.noise_sigma_px, motion=result.motion,
                          facts=result.facts, status=result.status)


def calibrate_moving(case: MovingCamera) -> Calibration | NoEstimate:
    """
    Calibrate from the simplest motion that explains the views.

    Parameters
    ----------
    case : MovingCamera

    Returns
    -------
    Calibration or NoEstimate

    """
    graph, may_vary = case.graph, case.facts.focal == 'varying'
    rotations = case.rotations() if case.may_turn and not may_vary else None
    path: Calibration | NoEstimate | None = None
    turn, plane, near_turn = None, None, False
    if isinstance(rotations, RotationFit):
        mixed = of_two_turning(rotations, graph, case.size, case.facts)
        if mixed is not None:
            return mixed
        near_turn = rotations.left_px < MAX_NOISE_NEAR_TURN * max(rotations.noise_px,
                                                                  graph.noise_px)
    if near_turn and isinstance(rotations, RotationFit):
        if rotations.left_px > MAX_NOISE_OF_WEAK_PATH * graph.noise_px:
            # no head leaves so much unless it zooms, and a path is found sooner than a turn
            path = case.path(rotations, is_weak=True)
            if path and path.focal is None and not _may_be_weak(path, graph):
                return path
        turn = case.about_a_point(rotations)
        if turn is not None and turn.is_sure(graph.noise_px):
            return turn.result
    elif case.may_turn:
        in_plane = on_one_plane(graph)
        plane = None if in_plane is None else case.over_a_plane(in_plane)
        if plane is not None and _settles(plane):
            return plane
    path = case.path(rotations, is_weak=near_turn) if path is None else path
    if plane is not None and _leaves_open_as_well(plane, path):
        return plane
    if not path and path.kind in UNEXPLAINED and case.may_turn and plane is None:
        # fundamental matrices of nearly a plane start nothing
        plane = case.over_a_plane(graph)
        path = plane if plane else path
    if case.has_enough_views and rotations is None and not may_vary and _may_be_weak(path, graph):
        # what pairs show beside a homography was no parallax
        nearly = fit_rotations(graph.tracks, case.size, case.facts,
                               MAX_NOISE_OF_START * graph.noise_px)
        if isinstance(nearly, RotationFit):
            turn = case.about_a_point(nearly)
            if turn is not None and turn.result and turn.is_sure(graph.noise_px):
                return turn.result
        if path and _is_nearly_turn(path, graph):
            path = case.path(nearly, is_weak=True)
    if turn is not None:
        return _of_turn_and_path(turn, path)
    if not case.has_little_parallax or (path and rotations is not None):
        return path
    return case.rotation_or(path, rotations)


def _is_nearly_turn(path: Calibration, graph: ViewGraph) -> bool:
    """Tell whether turns alone would leave little, behind the camera of a path."""
    return left_by_turns(graph, path.camera) < MAX_NOISE_OF_WEAK_PATH


def _may_be_weak(path: Calibration | NoEstimate, graph: ViewGraph) -> bool:
    """Tell whether a path may owe its translations to the lens."""
    if isinstance(path, NoEstimate):
        return path.kind in OF_OPEN_PATH
    return path.focal_sigma_share > COARSE_FOCAL or _is_nearly_turn(path, graph)


def _of_turn_and_path(turn: Turn, path: Calibration | NoEstimate) -> Calibration | NoEstimate:
    """Choose the path if it fits clearly better, or determines what the turn does not."""
    left_px = turn.result.noise_sigma_px if turn.result else turn.noise_px
    clearer = path and path.noise_sigma_px < CLEARLY_LESS_NOISE * left_px
    settles = path and turn.leaves_open and not (
        path.focal_sigma_share > WEAK_FOCAL and left_px < CLEARLY_LESS_NOISE * path.noise_sigma_px)
    return path if clearer or settles else turn.result


def _leaves_open_as_well(plane: Calibration | NoEstimate, path: Calibration | NoEstimate) -> bool:
    """Tell whether one plane fits as well as a path, but does not determine the camera."""
    return (isinstance(path, Calibration) and isinstance(plane, NoEstimate)
            and plane.kind in OF_OPEN_PATH
            and CLEARLY_LESS_NOISE * plane.values.get('left_px', np.inf) < path.noise_sigma_px)


def _settles(plane: Calibration | NoEstimate) -> bool:
    """Tell whether points in a plane gave a camera, or the fact that is missing."""
    return bool(plane) or (isinstance(plane, NoEstimate) and plane.kind in OF_CIRCLES)


def _hides_path(rotating: Calibration, path: Calibration | NoEstimate) -> bool:
    """Tell whether a path explains better what a turn with a long lens seems to explain."""
    if path:
        left_px = path.noise_sigma_px
    elif path.kind in OF_OPEN_PATH:
        left_px = path.values.get('left_px', np.inf)
    else:
        return False
    camera = rotating.camera
    is_long = camera.K[0, 0] > LONG * max(camera.width, camera.height)
    return bool(is_long and rotating.noise_sigma_px > MAX_NOISE_BEHIND_LONG_LENS * left_px)
