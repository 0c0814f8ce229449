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
One of several cameras, and what its image says in the frame of the rig.

A correction (theta, Delta) turns the object about its middle, and shifts that. In the frame of
another camera it is the same, turned: (R theta, R Delta). So the information of an image is turned
to the rig and added. So is M (z - x), which pulls a pose x towards the measurement z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.rorapid.estimation.kalman_filter import ConstantVelocityFilter
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.rorapid.tracker import RorapidTracker
from selfcal_ros.values.camera_rig import PlacedCamera
from selfcal_ros.values.wireframe import WireframeModel

#: A camera that sees nothing where the others see the object searches by itself in these images
#: after it did, and then in every so many.
_SEARCHES, _SEARCH_EVERY = range(3, 9), 3


@dataclass(frozen=True)
class PoseInformation:
    """
    What one image says of the pose of the object in the rig.

    Attributes
    ----------
    state : ObjectPose
        Of the object's middle.
    own : ndarray, shape (6, 6)
        Information of the image alone.
    information : ndarray, shape (6, 6)
        The same, less what is not known of where the camera sits.
    pull : ndarray, shape (6,)
        information (z - state): to the measurement without any prediction.
    misplaced : ndarray, shape (6, 6)
        Covariance of the pose for what is not known of where the camera sits.
    good : bool
        Enough of the object is seen.

    """

    state: ObjectPose
    own: np.ndarray
    information: np.ndarray
    pull: np.ndarray
    misplaced: np.ndarray
    good: bool

    def about(self, place: ObjectPose,
              difference: Callable[[ObjectPose, ObjectPose], np.ndarray]) -> np.ndarray:
        """Pull (6,) on another pose near by."""
        pull: np.ndarray = self.pull + self.information @ difference(self.state, place)
        return pull


class RigCamera:
    """
    A camera of a rig.

    Parameters
    ----------
    model : WireframeModel
    placed : PlacedCamera
    options : TrackerOptions
    rng : numpy.random.Generator

    Attributes
    ----------
    tracker : RorapidTracker
    placed : PlacedCamera
    is_apart : bool
        It contradicts the others, and follows what it sees by itself until it loses that.

    """

    def __init__(self, model: WireframeModel, placed: PlacedCamera, options: TrackerOptions,
                 rng: np.random.Generator):
        """Prepare the camera."""
        self.placed = placed
        self.tracker = RorapidTracker(model, placed.camera, options, rng)
        self._turn = placed.T_rig_camera[:3, :3]
        self._shift = placed.T_rig_camera[:3, 3]
        self._both = np.kron(np.eye(2), self._turn)
        self.reset()

    def reset(self) -> None:
        """Forget the object."""
        self.tracker.reset()
        self._started, self._blind = False, 0
        self.is_apart = False

    def start(self, rotation: np.ndarray, translation: np.ndarray,
              covariance: ArrayLike | None, lost: bool, distance_sigma_m: float | None) -> bool:
        """
        Take a guess of the pose in the rig; see `RorapidTracker.start`.

        Returns
        -------
        bool
            False where the object is behind this camera, which then waits for the others.

        """
        here = self._turn.T @ (translation - self._shift)
        turned = self._turn.T @ rotation
        self._started = (here + turned @ self.tracker.centre)[2] > 0
        self._blind = 0
        if self._started:
            if covariance is not None:
                covariance = self._both.T @ np.asarray(covariance, float) @ self._both
            self.tracker.start(turned, here, covariance, lost=lost,
                               distance_sigma_m=distance_sigma_m)
        return bool(self._started)

    def seek(self) -> None:
        """Begin without a pose."""
        self.tracker.seek()
        self._started = True

    def expect(self, kalman: ConstantVelocityFilter, stamp_ns: int | None) -> None:
        """
        Go on from where all cameras together saw the object.

        A start that is being confirmed is left alone: a second opinion is worth more.

        Parameters
        ----------
        kalman : ConstantVelocityFilter
            Of the rig, after its last image.
        stamp_ns : int or None
            Of that image.

        """
        tracker = self.tracker
        place = self._here(kalman.state)
        self.is_apart &= tracker.state is not TrackerState.LOST
        if place.translation[2] <= 0 or self.confirms or self.is_apart:
            return
        searches = self._blind in _SEARCHES or (
            self._blind > 0 and self._blind % _SEARCH_EVERY == 0)
        self._started = True
        if searches:
            tracker.search_around(place, stamp_ns)
            return
        twice = np.kron(np.eye(2), self._both.T)
        tracker.follow(place, twice[:6, :6] @ kalman.velocity,
                       twice @ kalman.covariance @ twice.T, stamp_ns)

    def look(self, image: np.ndarray, stamp_ns: int | None) -> TrackedFrame | None:
        """Find the object in an image (H, W) of uint8; None where it is behind the camera."""
        if not self._started:
            return None
        return self.tracker.track(image, stamp_ns)

    def in_rig(self, frame: TrackedFrame) -> TrackedFrame:
        """Return what this camera tells with its pose in the frame of the rig."""
        return replace(frame, rotation=self._turn @ frame.rotation,
                       translation=self._turn @ frame.translation + self._shift,
                       covariance=self._both @ frame.covariance @ self._both.T)

    def settle(self, sees: bool) -> None:
        """Note whether the last image was of use; who sees nothing searches, after a while."""
        self._blind = 0 if sees else self._blind + 1

    @property
    def is_started(self) -> bool:
        """Whether it looks for the object: it was not behind the camera at the start."""
        return self._started

    @property
    def is_blind(self) -> bool:
        """Whether it did not see the object for some images."""
        return self._blind >= self.tracker.options.frames_to_lost

    @property
    def confirms(self) -> bool:
        """Whether a start is still being confirmed."""
        return self._started and self.tracker.state is TrackerState.INITIALISING

    def search(self, state: ObjectPose) -> None:
        """Search by itself from now on, around a pose of the object's middle in the rig."""
        place = self._here(state)
        self.is_apart = False
        if self._started and place.translation[2] > 0:
            self.tracker.search_around(place, None)

    def pose_information(self) -> PoseInformation | None:
        """Return what the last image said; None where it did not confirm a pose."""
        measured = self.tracker.measured
        if measured is None or measured.details is None:
            return None
        good = measured.recognised or measured.share >= self.tracker.options.tracking_share
        if self._blind and not good:
            # what was hidden is seen again only if it is seen well
            return None
        fit = measured.details.fit
        prior = fit.solved - fit.measured
        information = np.linalg.inv(measured.covariance) - prior
        floor = 1e-9 * np.diag(np.diag(fit.measured)) + 1e-9 * np.eye(6)
        pull = information @ np.linalg.solve(fit.measured + floor, fit.pull)
        there = self._there(measured.state)
        # an error of the camera's place is one of the pose; it takes information away
        lever = np.zeros((6, 6))
        x, y, z = there.translation - self._shift
        lever[:3, 3:] = np.eye(3)
        lever[3:, :3] = np.eye(3)
        lever[3:, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        own = self._both @ information @ self._both.T
        misplaced = lever @ self.placed.covariance @ lever.T
        if measured.rows is not None:
            misplaced = misplaced + self._both @ measured.rows.covariance @ self._both.T
        less = np.linalg.inv(np.eye(6) + own @ misplaced)
        known = less @ own
        return PoseInformation(there, own, 0.5 * (known + known.T), less @ self._both @ pull,
                               misplaced, good)

    def doubted(self) -> np.ndarray:
        """Covariance (6, 6) that a doubt of model or camera adds in the rig."""
        covariance: np.ndarray = self._both @ self.tracker.doubt_covariance @ self._both.T
        return covariance

    def _here(self, state: ObjectPose) -> ObjectPose:
        return ObjectPose(self._turn.T @ state.rotation,
                          self._turn.T @ (state.translation - self._shift), state.zoom)

    def _there(self, state: ObjectPose) -> ObjectPose:
        return ObjectPose(self._turn @ state.rotation,
                          self._turn @ state.translation + self._shift, state.zoom)

    @property
    def place(self) -> np.ndarray:
        """Where the camera sits in the rig, (3,) metres."""
        return self._shift
