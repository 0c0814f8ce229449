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
From a guess to a pose that is believed: which start is looked at, and when it is confirmed.

The first images of a start are judged by `start_check`, not by the estimate itself. Where they do
not confirm it, other poses around are tried in some of them; after `TRIES` images it is given up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from selfcal_ros.rorapid.estimation.pose_estimator import SearchingEstimator
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.pose_search import best_turned, NOT_FREE, turned_by
from selfcal_ros.rorapid.estimation.start_check import Support
from selfcal_ros.rorapid.estimation.twin_watch import TWIN, TwinWatch
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection

#: A start that is not confirmed after so many images is given up; in these images other poses
#: are tried.
TRIES, _SEARCHES = 15, (0, 4, 9)
#: Another pose is better if it is seen by so much more of its length.
_BETTER = 0.05
#: The outline of a round part is nearly that of poses around. After an image that did not confirm
#: one, it must be sure in so many images in a row; so must what a search found.
_OUTLINE_IMAGES = 3
#: Two places tell a velocity if no more time lies between, and no more of a turn: parts that look
#: the same from several sides are found in any of these poses.
_RECENT_S, _SAME_RAD = 1.5, 0.7
#: Uncertainty of a proposed place: radians, diameters of the object, share of the distance.
_PROPOSED_RAD, _PROPOSED_DIAMETERS, _PROPOSED_DEPTH = 0.3, 0.15, 0.1


class StartSearch:
    """
    Confirms one start.

    Parameters
    ----------
    guess : ObjectPose
    covariance : ndarray, shape (m, m)
        Covariance of the guess.
    outline : bool
        The object is a mesh, known by its outline.
    free : ndarray, shape (k, 6)
        Turns that the shape leaves open.

    Attributes
    ----------
    tries : int
        Images that were looked at.
    support : Support
        Of the last pose.
    sure : bool
        The last pose is that of the object without doubt.

    """

    def __init__(self, guess: ObjectPose, covariance: np.ndarray, outline: bool,
                 free: np.ndarray = NOT_FREE):
        """Begin."""
        self._free = free
        self.guess, self.tries, self.support = guess, 0, Support()
        self._covariance, self._outline = covariance, outline
        self._searches, self._held, self.sure = 0, 0, False
        # before a search nothing is known of poses that are turned
        self._rival, self._turned = Support(), Support(1.0, 1.0)
        #: Images that must be sure in a row, even if the first one was.
        self._images = 1

    @classmethod
    def again(cls, guess: ObjectPose, covariance: np.ndarray,
              free: np.ndarray = NOT_FREE) -> StartSearch:
        """Confirm what a search found; it must be sure in several images in a row."""
        search = cls(guess, covariance, True, free)
        search._images = _OUTLINE_IMAGES
        return search

    def given_up(self, missed: bool) -> bool:
        """Whether there were images enough; what was found by a search is sought anew at once."""
        return self.tries >= TRIES or missed and self._images > 1

    def look(self, method: SearchingEstimator, image: np.ndarray, measured: PoseMeasurement,
             wide: np.ndarray) -> tuple[PoseMeasurement, bool]:
        """
        Look at a pose in an image, and at others around it where it is not seen well.

        Parameters
        ----------
        method : SearchingEstimator
        image : ndarray, shape (H, W), uint8
        measured : PoseMeasurement
        wide : ndarray, shape (m, m)
            Covariance of a pose that is only proposed.

        Returns
        -------
        measured : PoseMeasurement
            Of the best pose.
        other : bool
            Whether this is another pose than the one that came in.

        """
        check, other = method.check, False
        support = check.support(image, measured.state)
        fair = check.fair(support) and self._searches < len(_SEARCHES)
        if not check.plain(support) and (fair or self.tries in _SEARCHES):
            self._searches += 1
            poses = method.search.rivals(image, self.guess, measured.state, self._covariance)
            state, self._rival = poses[0]
            # of nearly equal poses (a box turned by half a turn) that next to the guess is right
            if self._rival.length > support.length + _BETTER:
                poses.append((measured.state, support))
                measured, self._rival = method.measure(image, state, wide), support
                support, other = check.support(image, measured.state), True
            self._turned = best_turned(poses, measured.state, self._free)
        self.tries += 1
        self.sure = not other and check.stands_alone(support, self._turned)
        self._held = self._held + 1 if self.sure else 0
        if self._held == self._images > 1 and method.search.turned_rival(
                image, measured.state, wide) > support.length - _BETTER:
            # no other image told where the object is: this one must not show it turned, too
            self._held = 0
        self.support = support
        return measured, other

    def confirmed(self, method: SearchingEstimator) -> bool:
        """Whether the last pose is confirmed; asked once an image where it was determined."""
        if not method.check.confirms(self.support, self._rival, self._turned):
            return False
        return not self._outline or self._held >= max(self._images,
                                                      min(_OUTLINE_IMAGES, self.tries))

    def reason(self) -> str:
        """Say what lacks."""
        seen = f'{100 * self.support.lines:.0f} % of the lines are seen along their length'
        if self._held:
            return f'The start pose is looked at in some more images: {seen}.'
        return f'The image does not confirm the start pose: {seen}.'


class LastSighting:
    """Where a search found the object last: two such places tell how it moves."""

    def __init__(self) -> None:
        """Wait for the first."""
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._state: ObjectPose | None = None
        self._seconds = 0.0

    def later(self, seconds: float) -> None:
        """Let so much time go by."""
        self._seconds += seconds

    def velocity(self, projection: Projection, basis: np.ndarray,
                 state: ObjectPose) -> np.ndarray | None:
        """Take another place; return the velocity (m,) since the last one, if that tells it."""
        before, seconds = self._state, self._seconds
        self._state, self._seconds = state, 0.0
        if before is None or not 0 < seconds < _RECENT_S or turned_by(before, state) > _SAME_RAD:
            return None
        motion: np.ndarray = basis.T @ projection.difference(state, before) / seconds
        return motion


def proposed_covariance(projection: Projection, basis: np.ndarray, diameter_m: float,
                        state: ObjectPose) -> np.ndarray:
    """Covariance (m, m) of a state that is only proposed."""
    sigma = np.full(projection.size, 0.1)
    if projection.size == 8:
        sigma /= state.translation[2]
    else:
        sigma[:3] = _PROPOSED_RAD
        sigma[3:6] = _PROPOSED_DIAMETERS * diameter_m
        sigma[5] = max(sigma[5], _PROPOSED_DEPTH * state.translation[2])
    spread: np.ndarray = (basis.T * sigma**2) @ basis
    return spread


def relocalised(method: SearchingEstimator, image: np.ndarray, measured: PoseMeasurement,
                expected: ObjectPose, lost: bool,
                wide: Callable[[ObjectPose], np.ndarray], twins: TwinWatch) -> PoseMeasurement:
    """
    Try other places for an object; return the measurement that is confirmed best.

    Parameters
    ----------
    method : SearchingEstimator
    image : ndarray, shape (H, W), uint8
    measured : PoseMeasurement
        Where it was expected.
    expected : ObjectPose
    lost : bool
        Search everywhere.
    wide : callable
        Covariance (m, m) of a state that is proposed.
    twins : TwinWatch
        What was seen beside the object is another one.

    Returns
    -------
    PoseMeasurement

    """
    reason = measured.reason
    twins.next_sought()
    for state in method.proposals(image, expected, lost, wide(expected),
                                  lambda pose: twins.is_known(method, pose)):
        other = method.measure(image, state, wide(state))
        if lost and other.determined and not other.recognised and method.check.sure(
                method.check.support(image, other.state)):
            other = method.measured_anew(image, other.state, wide(other.state))
        if other.recognised and twins.is_twin(method, image, other, wide):
            reason = TWIN
            continue
        if other.determined and (other.recognised, other.share) > (
                measured.recognised, measured.share + 0.05):
            measured = other
        if measured.recognised:
            return measured
    return replace(measured, reason=reason) if reason == TWIN else measured


def confirmed_again(method: SearchingEstimator, image: np.ndarray,
                    measured: PoseMeasurement) -> PoseMeasurement:
    """Return what was found of a lost object, recognised only if its lines are seen."""
    check = method.check
    support = check.support(image, measured.state)
    if check.found(support, measured.by_texture, method.placed):
        return measured
    return replace(measured, recognised=False)
