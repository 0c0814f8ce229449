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
"""From starts to poses: edges draw starts to themselves; the pose that is seen best is kept."""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.edges.control_points import ControlModel, views_together
from selfcal_ros.rorapid.edges.edge_choice import clutter_weight
from selfcal_ros.rorapid.estimation.edge_fit import PosePrior, SearchRound
from selfcal_ros.rorapid.estimation.edge_search import EdgeSearch
from selfcal_ros.rorapid.estimation.joint_fit import fit_together, FitTask
from selfcal_ros.rorapid.estimation.start_check import quartered, StartCheck, Support, turned
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose

#: Rounds of the search from each start, the first of them wide; range of the others, pixels.
_START_ROUNDS, _WIDE_ROUNDS, _GUESS_REACH_PX = 4, 2, 8
#: Of many starts so many are looked at more closely. They are turned by more than this angle
#: from each other, or one wrong pose would take all places.
_CLOSELY, OTHER_RAD = 6, 0.2
#: What is turned by more may look the same: a cube has six sides. The guess has to decide.
_QUARTER_RAD = 0.9
#: No turn that the shape leaves open.
NOT_FREE = np.zeros((0, 6))


class PoseSearch:
    """
    Searches a pose from many starts.

    Parameters
    ----------
    control : ControlModel
    basis : ndarray, shape (size, m)
    options : TrackerOptions
    edges : EdgeSearch
    check : StartCheck

    """

    def __init__(self, control: ControlModel, basis: np.ndarray, options: TrackerOptions,
                 edges: EdgeSearch, check: StartCheck):
        """Take what measures and what judges."""
        self.basis, self._edges = basis, edges
        self.adopt(options, control, check)

    def switch(self, basis: np.ndarray) -> None:
        """Go on with another basis of corrections."""
        self.basis = basis

    def adopt(self, options: TrackerOptions, control: ControlModel, check: StartCheck) -> None:
        """Go on by other settings."""
        self.options, self.control, self.check = options, control, check

    def nearby(self, image: np.ndarray, guess: ObjectPose, covariance: np.ndarray) -> ObjectPose:
        """
        Try starts around a guess, one sigma away; return the pose with the strongest edges.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        guess : ObjectPose
        covariance : ndarray, shape (m, m)
            Covariance of the guess.

        Returns
        -------
        ObjectPose

        """
        values, vectors = np.linalg.eigh(covariance)
        shifts = vectors * np.sqrt(values)
        starts = np.concatenate([np.zeros((1, len(covariance))), shifts.T, -shifts.T])
        prior = PosePrior.of(guess, covariance)
        states = [self.control.projection.moved(guess, self.basis @ start) for start in starts]
        best, best_score = guess, -1.0
        states = self._drawn_in(image, states, len(states) * [prior], _START_ROUNDS)
        for state, view in zip(states, views_together([self.control] * len(states), states)):
            score = self._edges.score(image, view)
            if score > best_score:
                best, best_score = state, score
        return best

    def rivals(self, image: np.ndarray, guess: ObjectPose, found: ObjectPose,
               covariance: np.ndarray) -> list[tuple[ObjectPose, Support]]:
        """
        Find poses from starts that are turned from a guess, or by quarters from what was found.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        guess, found : ObjectPose
        covariance : ndarray, shape (m, m)
            Covariance of the guess.

        Returns
        -------
        list of (ObjectPose, Support)
            The best first. What was found may be among them.

        """
        if self.control.is_outlined:
            # the outline of a round part looks much the same from other sides: nearby ones only
            starts = turned(guess)
            return self.ranked(image, starts[:len(starts) // 2], covariance)
        poses = self.ranked(image, turned(guess) + quartered(found), covariance)
        state, support = poses[0]
        if not self.check.plain(support):
            # what looks nearly right may be right but for a quarter of a turn
            other = self.ranked(image, quartered(state), covariance)[0]
            if other[1].length > support.length:
                return [other, *poses]
        return poses

    def turned_rival(self, image: np.ndarray, found: ObjectPose, covariance: np.ndarray) -> float:
        """Share of the length seen of the best pose that is turned from what was found."""
        starts = turned(found)
        return best_turned(self.ranked(image, starts[:len(starts) // 2], covariance), found,
                           self.control.free_turns).length

    def ranked(self, image: np.ndarray, starts: list[ObjectPose],
               covariance: np.ndarray) -> list[tuple[ObjectPose, Support]]:
        """
        Draw all starts in a little and the best ones wholly.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8
        starts : list of ObjectPose
        covariance : ndarray, shape (m, m)
            Covariance of each start.

        Returns
        -------
        list of (ObjectPose, Support)
            What was drawn in wholly, the best first.

        """
        information = np.linalg.inv(covariance)

        def drawn(states: list[ObjectPose], rounds: int) -> list[tuple[ObjectPose, Support]]:
            poses = self._drawn_in(image, states, [
                PosePrior(state, covariance, information) for state in states], rounds)
            found = [(pose, self.check.support(image, pose)) for pose in poses]
            return sorted(found, key=lambda pair: -pair[1].length)

        chosen: list[ObjectPose] = []
        for pose, _ in drawn(starts, _WIDE_ROUNDS):
            if all(turned_by(pose, other, self.control.free_turns) > OTHER_RAD
                   for other in chosen):
                chosen.append(pose)
        return drawn(chosen[:_CLOSELY], _START_ROUNDS)

    def _drawn_in(self, image: np.ndarray, states: list[ObjectPose], priors: list[PosePrior],
                  rounds: int) -> list[ObjectPose]:
        """Let the edges draw starts to themselves."""
        reach = int(np.ceil(self.options.search_most_px))
        for turn in range(rounds):
            wide = turn < _WIDE_ROUNDS
            views = views_together([self.control] * len(states), states)
            limits = self._edges.limits(reach, wide, not wide)
            # one by one: at once their sums round otherwise, and blurred images fall either way
            states = [fit_together(image, [FitTask(self._edges, prior, SearchRound(
                state, view, reach if wide else _GUESS_REACH_PX, limits,
                clutter_weight(view)))])[0].state
                for state, prior, view in zip(states, priors, views)]
        return states


def best_turned(poses: list[tuple[ObjectPose, Support]], found: ObjectPose,
                free: np.ndarray = NOT_FREE) -> Support:
    """Return the best support of the poses that are turned from one, but not by a quarter."""
    return max((support for pose, support in poses
                if OTHER_RAD < turned_by(pose, found, free) < _QUARTER_RAD),
               key=lambda support: support.length, default=Support())


def turned_by(pose: ObjectPose, other: ObjectPose, free: np.ndarray = NOT_FREE) -> float:
    """Angle between two poses' rotations, radians; up to turns that the shape leaves open."""
    if len(free) > 1:
        return 0.0
    between = pose.rotation.T @ other.rotation
    if len(free):
        cosine = free[0, :3] @ between @ free[0, :3]
    else:
        cosine = (np.trace(between) - 1) / 2
    return float(np.arccos(np.clip(cosine, -1, 1)))
