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
Motion → K: the kinds of motion in turn, then what may have kept them from explaining the views.

`ATTEMPTS` is the order, with its reasons. How one kind of motion is calibrated is in `one_motion`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.motion import GENERAL, MotionModel, NEARLY_PLANAR
from selfcal_ros.calibration.estimators.attempts import always, Attempt, first_accepted
from selfcal_ros.calibration.estimators.coherent_start import straight_and_bent
from selfcal_ros.calibration.estimators.facts_in_the_way import fact_in_the_way, without_facts
from selfcal_ros.calibration.estimators.motion_class import widest_turn_rad
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.estimators.one_motion import (is_less_open, left_by,
                                                           LITTLE_TURN_RAD, OneMotion,
                                                           UNEXPLAINED, with_any_focal)
from selfcal_ros.calibration.estimators.other_starts import likeliest_start
from selfcal_ros.calibration.estimators.parted_tracks import (calibrate_coherent_tracks,
                                                              MANY_REJECTED)
from selfcal_ros.calibration.estimators.zoom_selection import zooming
from selfcal_ros.calibration.initialisation.planar_scene import FlatScene
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate

#: Kinds of motion to try, by name.
MOTION_MODELS = {
    'planar': (NEARLY_PLANAR,),
    'general': (GENERAL,),
    'auto': (NEARLY_PLANAR, GENERAL),
}
#: Refusals that things that move may be the reason of.
MAY_BE_MOVING = (*UNEXPLAINED, 'parameters_undetermined', 'circle_undetermined')
#: Noise of still tracks over that of pairs of images, which what moves only adds to. Drives and
#: orbits on which nothing moves leave up to 1.15.
PARTED_NOISE = 1.3
#: What a refused estimate leaves, over what pairs do: a motion that is too simple may be why.
POORLY_EXPLAINED = 1.5


@dataclass(frozen=True)
class MotionsTried:
    """
    What the attempts at some kinds of motion found so far.

    Attributes
    ----------
    problem : SelfCalibrationProblem
        Of the first kind of motion.
    graph : ViewGraph
    proposals : list of Camera
        Calibrations to start from.
    motions : tuple of MotionModel
        Kinds of motion to try, the most constrained first.
    motion : MotionModel
        That was tried last.
    may_be_flat : bool
        Nearly all points may be in one plane.
    found : Calibration or NoEstimate, optional
        The best so far; there is one once the kinds of motion were tried.
    ill_parted : bool
        Residuals of the first result exceed what still tracks leave: something moves among them.
    answer : Calibration or NoEstimate, optional
        What ends the search.

    """

    problem: SelfCalibrationProblem
    graph: ViewGraph
    proposals: list[Camera]
    motions: tuple[MotionModel, ...]
    motion: MotionModel
    may_be_flat: bool = False
    found: Calibration | NoEstimate | None = None
    ill_parted: bool = False
    answer: Calibration | NoEstimate | None = None

    @property
    def best(self) -> Calibration | NoEstimate:
        """The best result so far."""
        assert self.found is not None
        return self.found

    def by(self, motion: MotionModel) -> SelfCalibrationProblem:
        """Return the problem with a kind of motion."""
        return replace(self.problem, motion=motion)

    def refused_as(self, *kinds: str) -> bool:
        """Tell whether there is no calibration, for one of some reasons."""
        return isinstance(self.best, NoEstimate) and self.best.kind in kinds


# Which attempts are worth their time.

def _was_found(so_far: MotionsTried) -> bool:
    """Tell whether there is a calibration, of tracks that may all stand still."""
    return bool(so_far.best) and not so_far.ill_parted


def _was_found_of_few(so_far: MotionsTried) -> bool:
    """Tell whether there is a calibration, though some tracks seem to move."""
    return bool(so_far.best) and so_far.ill_parted


def _rejects_much_beside_little_turns(so_far: MotionsTried) -> bool:
    """Tell whether a motion that is not the freest rejects much, where turns are small."""
    found = so_far.best
    return (isinstance(found, Calibration) and so_far.motion is not so_far.motions[-1]
            and _rejected(found, so_far.graph) > MANY_REJECTED
            and widest_turn_rad(found.reconstructed.cam_from_world[:, :, :3]) < LITTLE_TURN_RAD)


def _is_unexplained(so_far: MotionsTried) -> bool:
    """Tell whether no motion explains the views."""
    return so_far.refused_as(*UNEXPLAINED)


def _is_unexplained_and_may_be_flat(so_far: MotionsTried) -> bool:
    """Tell whether no motion explains views of little parallax."""
    return so_far.may_be_flat and _is_unexplained(so_far)


def _may_show_what_moves(so_far: MotionsTried) -> bool:
    """Tell whether things that move may be why there is no calibration, or a poor one."""
    return so_far.refused_as(*MAY_BE_MOVING) or so_far.ill_parted


def _zooms_in_freer_motion(so_far: MotionsTried) -> bool:
    """Tell whether a focal length that varies was found with a motion that is not the first."""
    found = so_far.best
    return (isinstance(found, Calibration) and found.focal is not None
            and so_far.motion is not so_far.motions[0])


# What they do.

def _try_simplest_motion(so_far: MotionsTried) -> MotionsTried:
    """Calibrate with the first kind of motion that explains the views."""
    found, motion = _simplest_motion(so_far)
    return replace(so_far, found=found, motion=motion,
                   ill_parted=_is_ill_parted(found, so_far.problem))


def _begin_from_plane(so_far: MotionsTried) -> MotionsTried:
    """Begin as over points in one plane; it stays as it was where that explains nothing."""
    problem, graph = so_far.problem, so_far.graph
    plane = FlatScene.of(graph.tracks, graph.frames, graph.lens)
    over = _try_simplest_motion(replace(so_far, problem=replace(problem, flat=plane),
                                        proposals=[]))
    return over if over.found else so_far


def _begin_elsewhere(so_far: MotionsTried) -> MotionsTried:
    """Begin from other focal lengths, too, where the one that was found is loose."""
    assert isinstance(so_far.found, Calibration)
    found = likeliest_start(so_far.found, so_far.by(so_far.motion), so_far.graph)
    return replace(so_far, found=found)


def _try_free_motion_anew(so_far: MotionsTried) -> MotionsTried:
    """Take the freest motion, from starts of its own, where it rejects less than half as much."""
    graph, found = so_far.graph, so_far.found
    assert isinstance(found, Calibration)
    free = with_any_focal(so_far.by(so_far.motions[-1]), graph, so_far.proposals)
    better = free and _rejected(free, graph) < _rejected(found, graph) / 2
    return replace(so_far, found=free) if better else so_far


def _try_without_facts(so_far: MotionsTried) -> MotionsTried:
    """Refuse, and name a fact without which nearly all that pairs agree on is explained."""
    problem, graph = so_far.by(so_far.motions[-1]), so_far.graph
    facts = without_facts(problem.facts)
    if facts is None:
        return so_far
    # it must explain them alone: nothing is parted, and nothing zooms
    free = OneMotion(replace(problem, facts=replace(facts, focal='constant')),
                     replace(graph, given=None), so_far.proposals, None).result()
    if not free or _rejected(free, graph) > MANY_REJECTED:
        return so_far
    return replace(so_far, answer=fact_in_the_way(problem.facts, free))


def _try_coherent_tracks(so_far: MotionsTried) -> MotionsTried:
    """Calibrate from the half of the tracks that is most coherent, by each kind of motion."""
    may_stand = _is_unexplained(so_far)
    for motion in so_far.motions:
        problem = so_far.by(motion)
        parted = calibrate_coherent_tracks(problem, so_far.graph, straight_and_bent(problem),
                                           with_any_focal, may_stand=may_stand)
        if parted or (parted is not None and is_less_open(parted, so_far.best)):
            return replace(so_far, motion=motion, answer=parted)
    return replace(so_far, motion=so_far.motions[-1])


def _try_zoom_in_plane(so_far: MotionsTried) -> MotionsTried:
    """Take the first kind of motion where it zooms, too."""
    planar = OneMotion(zooming(so_far.by(so_far.motions[0])), so_far.graph, so_far.proposals,
                       None).result()
    return replace(so_far, found=planar) if planar and planar.focal is not None else so_far


def _answered(so_far: MotionsTried) -> Calibration | NoEstimate | None:
    """Return what ends the search, if that was found."""
    return so_far.answer


ATTEMPTS: tuple[Attempt[MotionsTried], ...] = (
    # First, since all others mend what this leaves open.
    Attempt('kinds of motion', tried_when=always, make=_try_simplest_motion),
    # Before anything is blamed: fundamental matrices of nearly a plane start none.
    Attempt('nearly a plane', tried_when=_is_unexplained_and_may_be_flat,
            make=_begin_from_plane),
    # At once where nothing seems to move: what follows compares with the best of this motion.
    # Else it waits until what moves was parted, as that bends every start.
    Attempt('other focal lengths', tried_when=_was_found, make=_begin_elsewhere),
    # Of calibrations the only one in doubt: the descent that began in a plane may have ended far
    # from the optimum of free motion.
    Attempt('free motion, its own starts', tried_when=_rejects_much_beside_little_turns,
            make=_try_free_motion_anew),
    # Before things that move, which would be blamed for it: a fact that is far off leaves no
    # start that explains the images.
    Attempt('without stated facts', tried_when=_is_unexplained, make=_try_without_facts,
            accepted=_answered),
    # After all that explains every track. The longest tracks start the estimate, and those ahead
    # of a vehicle may all be moving. It leaves the last motion as the one that was tried last.
    Attempt('most coherent tracks', tried_when=_may_show_what_moves, make=_try_coherent_tracks,
            accepted=_answered),
    # Here where something seemed to move, but could not be parted.
    Attempt('other focal lengths, all tracks', tried_when=_was_found_of_few,
            make=_begin_elsewhere),
    # Last, since only a zoom that stays needs it: a focal length that was held constant may have
    # hidden the plane.
    Attempt('zoom in the plane', tried_when=_zooms_in_freer_motion, make=_try_zoom_in_plane),
)


def calibrate_from_motion(graph: ViewGraph, size: tuple[int, int], facts: CameraFacts,
                          proposals: list[Camera], motions: tuple[MotionModel, ...],
                          flat: bool = False, at_once: bool = False, is_weak: bool = False,
                          may_be_flat: bool = False) -> Calibration | NoEstimate:
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
    may_be_flat : bool
        Begin as over one plane, too, where nothing else explains the views.

    Returns
    -------
    Calibration or NoEstimate

    """
    problem = problem_of(graph, size, facts, flat, at_once)
    if isinstance(problem, NoEstimate):
        return problem
    problem = replace(problem, is_weak=is_weak, supposes_plane=GENERAL in motions)
    accepted, so_far = first_accepted(ATTEMPTS, MotionsTried(problem, graph, proposals, motions,
                                                             motions[0], may_be_flat))
    return so_far.best if accepted is None else accepted


def _simplest_motion(so_far: MotionsTried) -> tuple[Calibration | NoEstimate, MotionModel]:
    """Calibrate with the first kind of motion that explains the views; it comes second."""
    refused: list[tuple[NoEstimate, MotionModel]] = []
    for motion in so_far.motions:
        result = with_any_focal(so_far.by(motion), so_far.graph, so_far.proposals)
        if isinstance(result, Calibration):
            return result, motion
        refused.append((result, motion))
        if not _may_be_freer(result, so_far.problem):
            break
    # a refusal that more freedom does not mend, and that explains more, stays
    return next((one for one in refused[:-1]
                 if _is_final(one[0]) and left_by(one[0]) <= left_by(refused[-1][0])),
                refused[-1])


def _is_final(refusal: NoEstimate) -> bool:
    """Tell whether a freer kind of motion would not mend a refusal."""
    return refusal.values.get('motion') != 'general'


def _may_be_freer(refusal: NoEstimate, problem: SelfCalibrationProblem) -> bool:
    """Tell whether a freer motion may mend a refusal: its residuals exceed the pairs' noise."""
    return (not _is_final(refusal)
            or np.inf > left_by(refusal) > POORLY_EXPLAINED * problem.noise_px)


def _is_ill_parted(result: Calibration | NoEstimate, problem: SelfCalibrationProblem) -> bool:
    """Tell whether the residuals of still tracks exceed the noise that pairs of images show."""
    return (isinstance(result, Calibration)
            and result.noise_sigma_px > PARTED_NOISE * problem.noise_px)


def _rejected(result: Calibration, graph: ViewGraph) -> float:
    """Share of outliers among the observations that agree with the epipolar geometry."""
    rejected = result.outlier_count - graph.rejected
    return rejected / max(rejected + result.observation_count, 1)
