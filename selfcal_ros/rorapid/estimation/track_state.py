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
"""The state of an object that is followed: when a measurement is accepted, and what then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.rorapid.estimation.free_turn import without_free
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.tracked_frame import TrackerState

#: A pose whose rotation is known worse than this is hardly one, radians.
_OPEN_RAD = 0.1
#: What is said where enough is found, and fits poses that are turned.
_OPEN_TURN = 'What is seen fits poses that are turned by some degrees: a rotation stays open.'
#: What is said while an object that was never seen is sought; and one with corners.
_SEEKING = ('The object was not seen yet: nothing that stands out from a plain background, or '
            'comes in before a still camera, has its silhouette')
_NO_CORNERS = ', and no corners are like its own'


@dataclass(frozen=True)
class SearchPolicy:
    """
    What is asked of an image, by who says where the object is.

    Attributes
    ----------
    relocalises : bool
        An object that is not seen where it was expected is sought around there.
    needs_whole_pose : bool
        An image must determine all of a pose to be accepted.
    learns_from_little : bool
        The appearance is learned from an image that confirms little of the object, too.

    """

    relocalises: bool
    needs_whole_pose: bool
    learns_from_little: bool


#: The camera finds the object by itself.
ALONE = SearchPolicy(relocalises=True, needs_whole_pose=True, learns_from_little=True)
#: Other cameras see the object and say where it is: a part of a pose is of use, but what little is
#: seen there may be something else.
GUIDED = SearchPolicy(relocalises=False, needs_whole_pose=False, learns_from_little=False)


class TrackStateMachine:
    """
    State of an object that is followed, and what each image makes of it.

    A measurement is accepted or not (`accepts`). What was accepted confirms the object
    (`confirm`); what was not may lose it (`rejects`), as may a start that nothing confirms
    (`gives_up`).

    Attributes
    ----------
    state : TrackerState
    misses : float
        Images in a row that did not confirm the pose; half a miss where little did.
    good : ObjectPose or None
        The last pose that was accepted.

    """

    def __init__(self) -> None:
        """Wait for a start."""
        self.begin(lost=True)

    def begin(self, lost: bool) -> None:
        """Take a start; or it was lost there."""
        self.state = TrackerState.LOST if lost else TrackerState.INITIALISING
        self.misses = 0.0
        self.good: ObjectPose | None = None

    def follow(self) -> None:
        """Other cameras see it."""
        if self.state is TrackerState.LOST:
            self.state, self.misses = TrackerState.DEGRADED, 0.0

    def gives_up(self, found: bool, given_up: bool, options: TrackerOptions) -> bool:
        """
        Take note of an image of a start that is not confirmed yet.

        Parameters
        ----------
        found : bool
            Whether enough was found near it.
        given_up : bool
            There were images enough.
        options : TrackerOptions

        Returns
        -------
        bool
            Whether the object is lost now.

        """
        self.misses = 0.0 if found else self.misses + 1
        lost_now = given_up or self.misses >= options.frames_to_lost
        if lost_now:
            self.lose()
        return lost_now

    def lose(self) -> None:
        """Seek it: it is not where it was thought to be."""
        self.state = TrackerState.LOST

    def accepts(self, measured: PoseMeasurement, open_turn: bool, policy: SearchPolicy,
                options: TrackerOptions) -> bool:
        """
        Accept or refuse a measurement, and count misses.

        Parameters
        ----------
        measured : PoseMeasurement
        open_turn : bool
            It leaves a rotation open.
        policy : SearchPolicy
        options : TrackerOptions

        Returns
        -------
        bool
            Whether it is accepted.

        """
        accepted = (measured.determined or not policy.needs_whole_pose) and (
            measured.recognised if self.state is TrackerState.LOST
            else measured.share >= options.lost_share)
        if accepted and (open_turn or not measured.recognised
                         and measured.share <= options.lost_share):
            # barely found and not recognised, or hardly determined: half a miss
            self.misses += 0.5
            return self.misses < options.frames_to_lost
        self.misses = 0.0 if accepted else self.misses + 1
        return accepted

    def confirm(self, measured: PoseMeasurement, tracking: bool, doubt: str,
                options: TrackerOptions) -> str:
        """Take an accepted measurement; returns the reason, empty while all is well."""
        self.state = TrackerState.TRACKING if tracking and not doubt else TrackerState.DEGRADED
        self.good = measured.state
        if not tracking and measured.share >= options.tracking_share:
            return doubt or _OPEN_TURN
        return doubt if tracking else (
            f'Only {100 * measured.share:.0f} % of what should be visible is found.')

    def rejects(self, options: TrackerOptions) -> bool:
        """Take note of an image that did not confirm the pose; returns whether it is lost now."""
        if self.state is TrackerState.LOST:
            return False
        lost_now = self.misses >= options.frames_to_lost
        if lost_now:
            self.state = TrackerState.LOST
        elif self.state is not TrackerState.INITIALISING:
            self.state = TrackerState.DEGRADED
        return lost_now


def seeking_reason(by_corners: bool) -> str:
    """Say that an object was not found yet, which may be sought by its corners, too."""
    return f'{_SEEKING}{_NO_CORNERS if by_corners else ""}.'


def rejection_reason(measured: PoseMeasurement, seeking: str, open_turn: bool,
                     options: TrackerOptions) -> str:
    """
    Say why a measurement is refused.

    Parameters
    ----------
    measured : PoseMeasurement
    seeking : str
        What is said of an object that was never seen, and is only sought; else empty.
    open_turn : bool
        The measurement leaves a rotation open.
    options : TrackerOptions

    Returns
    -------
    str
        One sentence.

    """
    if measured.reason or seeking:
        return measured.reason or seeking
    if measured.share >= options.lost_share:
        # enough is found: something else is wrong
        if not measured.determined:
            return (f'Too little is seen: {int(measured.found.sum())} places on edges do not '
                    'determine a pose.')
        if open_turn:
            return _OPEN_TURN
        if measured.share >= options.tracking_share:
            return 'What is found is too little of the object to recognise it.'
    return (f'Only {100 * measured.share:.0f} % of what should be visible is found where '
            'the object was expected.')


def leaves_turn_open(basis: np.ndarray, measured: PoseMeasurement, free: np.ndarray) -> bool:
    """
    Whether an image leaves a rotation open: what is seen of an outline fits many poses.

    Turns that no image of the shape could show, free (size, k), do not count.
    """
    if len(basis) != 6:
        return False
    full = without_free(basis @ measured.covariance @ basis.T, free)[:3, :3]
    # no eigenvalue is larger than their sum
    return bool(np.trace(full) > _OPEN_RAD**2
                and np.linalg.eigvalsh(full)[-1] > _OPEN_RAD**2)
