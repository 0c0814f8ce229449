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
held against what they leave. `ATTEMPTS` is the order, with its reasons.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.estimators.attempts import always, Attempt, first_accepted
from selfcal_ros.calibration.estimators.moving_camera import (MAX_NOISE_OF_ROTATION, MovingCamera,
                                                              Turn)
from selfcal_ros.calibration.estimators.pivot import left_by_turns
from selfcal_ros.calibration.estimators.rotation import RotationFit
from selfcal_ros.calibration.estimators.sliding_images import LONG
from selfcal_ros.calibration.estimators.turning_cameras import of_two_turning
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.metric_structure import IN_A_PLANE
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.two_view_tests import PARALLAX_RATIO

#: A turn about a point is tried where rotations leave less than this many times the noise.
MAX_NOISE_NEAR_TURN = 16.0
#: Rotations that need a long lens are taken up to this ratio to a path. Over a plane that is
#: nearly parallel to the image a path leaves the focal length open, and such a turn looks much
#: the same.
MAX_NOISE_BEHIND_LONG_LENS = 1.02
#: A free path is preferred to a turn where it leaves less than this share of what that leaves.
CLEARLY_LESS_NOISE = 0.97
#: It may leave out few of the observations that the turn explains: what is left of the rest is
#: no measure of both.
AS_MANY = 0.97
#: A free path is weak where rotations leave less than this many times the noise in the middle.
#: Heads with a lever of 8 cm leave 1 to 8, drives and hands 24 and more.
MAX_NOISE_OF_WEAK_PATH = 10.0
#: A free path that knows the focal length to no more than this share of it is weak, too: behind a
#: fisheye pairs of a head's views show what looks like parallax.
WEAK_FOCAL = 0.03
#: One that knows it to no more than this share is held against rotations alone: a head behind a
#: fisheye was taken for a hand, 140 % off and 1.9 % sure.
COARSE_FOCAL = 0.01

#: Refusals of circular motion, which name the fact that is missing.
OF_CIRCLES = ('flat_turntable', 'circle_undetermined')
#: Refusals of paths that explain the images, whatever the focal length is.
OF_OPEN_PATH = ('parameters_undetermined', 'unlike_rotations', *OF_CIRCLES)


@dataclass(frozen=True)
class MotionsSeen:
    """
    What the attempts to tell the motion found so far.

    Attributes
    ----------
    case : MovingCamera
    rotations : RotationFit or NoEstimate, optional
        Rotations alone; none were fitted where pairs of views show parallax.
    despite_parallax : RotationFit or NoEstimate, optional
        Rotations alone that were fitted all the same.
    turn : Turn, optional
        About a point beside the camera.
    path, plane : Calibration or NoEstimate, optional
        Of a camera that translates; over points in one plane.
    rotating : Calibration or NoEstimate, optional
        Of a camera that only rotates.
    answer : Calibration or NoEstimate, optional
        What ends the search.

    """

    case: MovingCamera
    rotations: RotationFit | NoEstimate | None = None
    despite_parallax: RotationFit | NoEstimate | None = None
    turn: Turn | None = None
    path: Calibration | NoEstimate | None = None
    plane: Calibration | NoEstimate | None = None
    rotating: Calibration | NoEstimate | None = None
    answer: Calibration | NoEstimate | None = None

    @property
    def is_near_turn(self) -> bool:
        """Tell whether rotations alone leave so little that a turn about a point may explain."""
        rotations = self.rotations
        return isinstance(rotations, RotationFit) and self.leaves_little(rotations.left_px)

    @property
    def may_be_flat(self) -> bool:
        """Tell whether little parallax shows, and no plane was tried."""
        return self.case.may_turn and self.plane is None

    def leaves_little(self, left_px: float) -> bool:
        """Tell whether a turn about a point may explain what rotations leave."""
        assert isinstance(self.rotations, RotationFit)
        return left_px < MAX_NOISE_NEAR_TURN * max(self.rotations.noise_px,
                                                   self.case.graph.noise_px)

    @property
    def best_path(self) -> Calibration | NoEstimate:
        """Return the path, once it was tried."""
        assert self.path is not None
        return self.path


# Which attempts are worth their time.

def _may_only_turn(so_far: MotionsSeen) -> bool:
    """Tell whether little parallax shows, and the focal length is not said to vary."""
    return so_far.case.may_turn and so_far.case.facts.focal != 'varying'


def _rotates(so_far: MotionsSeen) -> bool:
    """Tell whether rotations alone could be fitted."""
    return isinstance(so_far.rotations, RotationFit)


def _is_near_turn(so_far: MotionsSeen) -> bool:
    """Tell whether rotations alone leave little."""
    return so_far.is_near_turn


def _is_hardly_near_turn(so_far: MotionsSeen) -> bool:
    """Tell whether rotations with a simple lens leave more than any head does."""
    rotations, graph = so_far.rotations, so_far.case.graph
    return (isinstance(rotations, RotationFit)
            and rotations.start_px > MAX_NOISE_OF_WEAK_PATH * graph.noise_px
            and so_far.case.in_plane is None)


def _may_be_plane(so_far: MotionsSeen) -> bool:
    """Tell whether little parallax shows, and not for want of translations."""
    return so_far.case.may_turn and not so_far.is_near_turn


def _may_turn_despite_parallax(so_far: MotionsSeen) -> bool:
    """Tell whether a path may owe its translations to the lens, and no rotations were fitted."""
    case = so_far.case
    return (case.has_enough_views and so_far.rotations is None and case.facts.focal != 'varying'
            and _may_be_weak(so_far.best_path, case.graph))


def _is_nearly_turn_despite_parallax(so_far: MotionsSeen) -> bool:
    """Tell whether turns alone, fitted all the same, would leave little behind a path's camera."""
    return (so_far.despite_parallax is not None and isinstance(so_far.path, Calibration)
            and _is_nearly_turn(so_far.path, so_far.case.graph))


def _has_turn(so_far: MotionsSeen) -> bool:
    """Tell whether there is a turn about a point."""
    return so_far.turn is not None


def _is_clearly_path(so_far: MotionsSeen) -> bool:
    """Tell whether parallax shows, or a path passed beside rotations."""
    return (not so_far.case.has_little_parallax
            or (bool(so_far.path) and so_far.rotations is not None))


def _hides_plane(so_far: MotionsSeen) -> bool:
    """
    Tell whether no pair shows parallax, and neither a path nor rotations explain the views.

    One plane that was tried of all tracks already would be tried again, to the same end.
    """
    rotating, case = so_far.rotating, so_far.case
    return (not so_far.path and case.graph.parallax < PARALLAX_RATIO
            and (not rotating or case.leaves_much(rotating))
            and not (so_far.plane is not None and case.is_all_in_plane))


# What they do.

def _fit_rotations(so_far: MotionsSeen) -> MotionsSeen:
    return replace(so_far, rotations=so_far.case.rotations())


def _try_two_cameras(so_far: MotionsSeen) -> MotionsSeen:
    """Refuse rotations of two cameras whose images are mixed."""
    assert isinstance(so_far.rotations, RotationFit)
    case = so_far.case
    return replace(so_far, answer=of_two_turning(so_far.rotations, case.graph, case.size,
                                                 case.facts))


def _try_path_before_turns(so_far: MotionsSeen) -> MotionsSeen:
    """Calibrate from a path, while what rotations leave is known with a simple lens alone."""
    assert isinstance(so_far.rotations, RotationFit)
    near = so_far.leaves_little(so_far.rotations.start_px)
    return replace(so_far, path=so_far.case.path(is_weak=near, may_be_flat=so_far.may_be_flat))


def _try_path(so_far: MotionsSeen) -> MotionsSeen:
    case = so_far.case
    path = so_far.path
    if path is None:
        path = case.path(is_weak=so_far.is_near_turn, may_be_flat=so_far.may_be_flat)
    return replace(so_far, path=case.unless_like_turns(path, so_far.rotations))


def _try_turn(so_far: MotionsSeen) -> MotionsSeen:
    assert isinstance(so_far.rotations, RotationFit)
    return replace(so_far, turn=so_far.case.about_a_point(so_far.rotations))


def _try_one_plane(so_far: MotionsSeen) -> MotionsSeen:
    """Calibrate from the tracks of one plane, where there is one."""
    in_plane = so_far.case.in_plane
    return replace(so_far, plane=None if in_plane is None else so_far.case.over_a_plane(in_plane))


def _try_turn_despite_parallax(so_far: MotionsSeen) -> MotionsSeen:
    nearly = so_far.case.rotations_despite_parallax()
    turn = so_far.case.about_a_point(nearly) if isinstance(nearly, RotationFit) else None
    return replace(so_far, despite_parallax=nearly, turn=turn)


def _try_weak_path(so_far: MotionsSeen) -> MotionsSeen:
    """Suppose that translations are small, and hold the path against rotations."""
    path = so_far.case.path(is_weak=True)
    return replace(so_far, path=so_far.case.unless_like_turns(path, so_far.despite_parallax))


def _judge_rotations(so_far: MotionsSeen) -> MotionsSeen:
    return replace(so_far, rotating=so_far.case.judged(so_far.rotations,
                                                       may_zoom=not so_far.path))


def _try_hidden_plane(so_far: MotionsSeen) -> MotionsSeen:
    """Suppose that all tracks are in a plane; a plane that turns in itself settles it, too."""
    plane = so_far.case.over_a_plane(so_far.case.graph)
    return replace(so_far, path=plane if _settles(plane) else so_far.path)


def _nothing_new(so_far: MotionsSeen) -> MotionsSeen:
    return so_far


# What ends the search.

def _answered(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    return so_far.answer


def _path_of_no_head(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    """Return a path that no lens makes of a turn, with a constant focal length."""
    path = so_far.path
    is_sure = path and path.focal is None and not _may_be_weak(path, so_far.case.graph)
    return path if is_sure else None


def _sure_turn(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    """Return what a turn gave, a refusal too, if no path needs to be tried."""
    turn = so_far.turn
    return turn.result if turn is not None and turn.is_sure(so_far.case.graph.noise_px) else None


def _sure_calibrated_turn(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    """Return the camera of a turn, if no path needs to be tried; never a refusal."""
    return _sure_turn(so_far) or None


def _settled_plane(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    """Return what a plane gave, if that is a camera or the fact that is missing."""
    return so_far.plane if so_far.plane is not None and _settles(so_far.plane) else None


def _plane_that_leaves_open(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    """Return the refusal of a plane, if it fits as well as the path."""
    plane = so_far.plane
    return plane if plane is not None and _leaves_open_as_well(plane, so_far.best_path) else None


def _turn_or_path(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    """Return the path if it fits clearly better, or determines what the turn does not."""
    turn, path = so_far.turn, so_far.best_path
    assert turn is not None
    left_px = turn.result.noise_sigma_px if turn.result else turn.noise_px
    clearer = (path and path.noise_sigma_px < CLEARLY_LESS_NOISE * left_px
               and not (turn.result and path.observation_count
                        < AS_MANY * turn.result.observation_count))
    # turns are free paths, too: what they leave open, those know only where they explain more
    settles = path and turn.leaves_open and path.motion in IN_A_PLANE and not (
        path.focal_sigma_share > WEAK_FOCAL and left_px < CLEARLY_LESS_NOISE * path.noise_sigma_px)
    return path if clearer or settles else turn.result


def _path(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    return so_far.path


def _rotations_or_path(so_far: MotionsSeen) -> Calibration | NoEstimate | None:
    """Return rotations where they are the simpler explanation, else the path."""
    case, rotating, path = so_far.case, so_far.rotating, so_far.best_path
    if not rotating:
        return path
    simpler = not _hides_path(rotating, path) and (
        not path or rotating.noise_sigma_px <= MAX_NOISE_OF_ROTATION * path.noise_sigma_px)
    if simpler and not path and rotating.focal and case.leaves_much(rotating):
        # a zoom of every view, or a step ahead: the images do not tell
        return NoEstimate('moved_not_rotated', left_px=rotating.noise_sigma_px,
                          noise_px=case.graph.noise_px, facts=rotating.facts)
    return rotating if case.motion == 'auto' and simpler else path


ATTEMPTS: tuple[Attempt[MotionsSeen], ...] = (
    # First, and no answer itself: what rotations leave tells which others are worth their time.
    Attempt('rotations alone', tried_when=_may_only_turn, make=_fit_rotations),
    # Before the turn, and before the lens of rotations is looked for at length: no head leaves so
    # much unless it zooms, and a path is found sooner.
    Attempt('path that is no turn', tried_when=_is_hardly_near_turn,
            make=_try_path_before_turns, accepted=_path_of_no_head),
    # Before anything is fitted further: no one camera explains images of two.
    Attempt('two cameras that turn', tried_when=_rotates, make=_try_two_cameras,
            accepted=_answered),
    # Before the path: small translations beside large rotations bend a free path, which then
    # may fit inside out. A turn has but three unknowns for them.
    Attempt('turn about a point', tried_when=_is_near_turn, make=_try_turn, accepted=_sure_turn),
    # Before the path, too, which a plane starts badly. Never beside a turn: there it is the
    # translations that do not show.
    Attempt('one plane', tried_when=_may_be_plane, make=_try_one_plane, accepted=_settled_plane),
    # All simpler motions were tried that little parallax asks for. One plane that fits as well,
    # and leaves the camera open, is believed: the path owes its camera to the noise.
    Attempt('path', tried_when=always, make=_try_path, accepted=_plane_that_leaves_open),
    # After the path, whose weakness asks for it: what pairs show beside a homography was no
    # parallax.
    Attempt('turn despite parallax', tried_when=_may_turn_despite_parallax,
            make=_try_turn_despite_parallax, accepted=_sure_calibrated_turn),
    # With the rotations of the attempt before: they tell that translations are small.
    Attempt('path of small translations', tried_when=_is_nearly_turn_despite_parallax,
            make=_try_weak_path),
    # The choice begins. A turn that was not sure is held against the best path.
    Attempt('turn or path', tried_when=_has_turn, make=_nothing_new, accepted=_turn_or_path),
    # Without a turn a path stands, unless there is so little parallax that rotations may do.
    Attempt('path alone', tried_when=_is_clearly_path, make=_nothing_new, accepted=_path),
    # Only here, since rotations may zoom where no path was found.
    Attempt('judgement of rotations', tried_when=always, make=_judge_rotations),
    # After rotations were judged: what no pair shows in its noise, many views may.
    Attempt('plane that no pair shows', tried_when=_hides_plane, make=_try_hidden_plane),
    # Last, of all that was found.
    Attempt('rotations or path', tried_when=always, make=_nothing_new,
            accepted=_rotations_or_path),
)


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
    accepted, so_far = first_accepted(ATTEMPTS, MotionsSeen(case))
    return so_far.best_path if accepted is None else accepted


def _is_nearly_turn(path: Calibration, graph: ViewGraph) -> bool:
    """Tell whether turns alone would leave little, behind the camera of a path."""
    return left_by_turns(graph, path.camera) < MAX_NOISE_OF_WEAK_PATH


def _may_be_weak(path: Calibration | NoEstimate, graph: ViewGraph) -> bool:
    """Tell whether a path may owe its translations to the lens."""
    if isinstance(path, NoEstimate):
        return path.kind in OF_OPEN_PATH
    return path.focal_sigma_share > COARSE_FOCAL or _is_nearly_turn(path, graph)


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
