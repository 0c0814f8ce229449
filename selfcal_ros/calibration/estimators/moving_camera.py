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
What can be tried of a camera that moved: turns, turns about a point beside it, and paths.

In which order, and when, is in `motion_choice`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from selfcal_ros.calibration.estimators.all_views import finish, NOT_CONSTANT, settled
from selfcal_ros.calibration.estimators.motion_calibration import (calibrate_from_motion,
                                                                   MOTION_MODELS)
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.estimators.one_motion import UNEXPLAINED
from selfcal_ros.calibration.estimators.pivot import (decide_pivot, extent_share,
                                                      MAX_NOISE_OF_PIVOT)
from selfcal_ros.calibration.estimators.rotation import (calibrate_rotating, fit_rotations,
                                                         judge_rotations, RotationFit)
from selfcal_ros.calibration.initialisation.one_plane import on_one_plane
from selfcal_ros.calibration.initialisation.supposed_lens import is_strong
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.observability import LEAST_NOISE_PX
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.metric_structure import IN_A_PLANE
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import camera_centres
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
#: Rotations are taken up to this ratio to a free path: depths that rest on so little would lead
#: the calibration astray.
MAX_NOISE_OF_ROTATION = 1.2
#: The same where no pair shows parallax: the noise of pairs is known to some 3 %, and a drive with
#: the smallest of steps is no turn.
MAX_NOISE_OF_HIDDEN_PIVOT = 1.1
#: A turn that leaves more than this ratio to the noise of pairs is held against a free path.
MAX_NOISE_OF_SURE_PIVOT = 1.04

#: A path is short when its extent is less than this share of the points' depth. A longer one
#: shows in the images, and needs no model of its own.
SHORT_PATH = 0.3
#: Where rotations leave less than this many times the noise, what moved was too little to change
#: the logarithm of the focal length by more: heads with a lever changed it by up to 0.04.
MAX_NOISE_OF_LIKE_TURN, MAX_FOCAL_CHANGE = 2.0, 0.1
#: That does not hold of a path in a plane whose extent is more than this share of the points'
#: depth, if rotations leave this many times its noise. So it is with vehicles that stand most of
#: the time, or drive before what is far. Heads with a lever move by less than 0.05.
A_WAY, CLEARLY_MORE = 0.15, 1.4


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

    @cached_property
    def in_plane(self) -> ViewGraph | None:
        """The views by the tracks of one plane, where most are in one."""
        return on_one_plane(self.graph)

    @property
    def is_all_in_plane(self) -> bool:
        """Tell whether the views by the tracks of one plane are those by all tracks, no less."""
        every, plane = self.graph, self.in_plane
        return (plane is not None and len(plane.tracks) == len(every.tracks)
                and [len(pair.track) for pair in plane.pairs] == [
                    len(pair.track) for pair in every.pairs]
                and max(plane.noise_px, LEAST_NOISE_PX) == max(every.noise_px, LEAST_NOISE_PX))

    def rotations(self) -> RotationFit | NoEstimate:
        """Fit rotations alone."""
        graph = self.graph
        # what a strong lens leaves of a rotation says nothing before the lens is fitted
        any_noise = self.has_little_parallax and (
            graph.parallax < PARALLAX_RATIO or is_strong(graph.bend))
        return fit_rotations(graph.tracks, self.size, self.facts,
                             np.inf if any_noise else MAX_NOISE_OF_START * graph.noise_px)

    def rotations_despite_parallax(self) -> RotationFit | NoEstimate:
        """Fit rotations alone, where pairs of views seemed to show parallax."""
        return fit_rotations(self.graph.tracks, self.size, self.facts,
                             MAX_NOISE_OF_START * self.graph.noise_px)

    def rotations_as_stated(self) -> RotationFit | NoEstimate:
        """Fit rotations alone, as the camera is said to turn only."""
        return fit_rotations(self.graph.tracks, self.size, self.facts,
                             varying=self.facts.focal == 'varying')

    def judged(self, rotations: RotationFit | NoEstimate | None, may_zoom: bool,
               ) -> Calibration | NoEstimate:
        """Return a camera that only rotates; where no rotations were fitted, it may zoom."""
        if rotations is None:
            return calibrate_rotating(self.graph.tracks, self.size, self.facts, may_zoom,
                                      may_miss=True)
        return (judge_rotations(rotations, may_miss=True) if isinstance(rotations, RotationFit)
                else rotations)

    def path(self, is_weak: bool, may_be_flat: bool = False) -> Calibration | NoEstimate:
        """Calibrate from a translating camera; see `calibrate_from_motion`."""
        return calibrate_from_motion(self.graph, self.size, self.facts, self.proposals,
                                     MOTION_MODELS[self.motion], is_weak=is_weak,
                                     may_be_flat=may_be_flat)

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
        # a focal length that varies is for the free motions, and so is what has moved on
        if not result and result.kind in (NOT_CONSTANT, 'points_behind', *UNEXPLAINED):
            return None
        return Turn(result, noise_px)

    def leaves_much(self, rotating: Calibration) -> bool:
        """Tell whether rotations leave more than pairs of views do."""
        return rotating.noise_sigma_px > MAX_NOISE_OF_ROTATION * self.graph.noise_px

    def unless_like_turns(self, result: Calibration | NoEstimate,
                          rotations: RotationFit | NoEstimate | None,
                          ) -> Calibration | NoEstimate:
        """Refuse a path if rotations fit as well, with a quite different focal length."""
        if (not isinstance(rotations, RotationFit) or isinstance(result, NoEstimate)
                or rotations.left_px > MAX_NOISE_OF_LIKE_TURN * self.graph.noise_px
                or _drove(result, rotations.left_px)):
            return result
        turned_px, focal_px = rotations.lens.fit.state.lens['f'], float(result.camera.K[0, 0])
        if abs(np.log(focal_px / turned_px)) < MAX_FOCAL_CHANGE:
            return result
        return NoEstimate('unlike_rotations', focal_px=focal_px, turned_px=float(turned_px),
                          left_px=result.noise_sigma_px, motion=result.motion,
                          facts=result.facts, status=result.status)


def _drove(result: Calibration, turned_px: float) -> bool:
    """Tell whether a path in a plane is long, and explains clearly more than rotations do."""
    scene = result.reconstructed
    return (result.motion in IN_A_PLANE and turned_px > CLEARLY_MORE * result.noise_sigma_px
            and extent_share(camera_centres(scene.cam_from_world), scene.points) > A_WAY)
