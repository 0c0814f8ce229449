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
"""A tracker that other cameras lead: they saw the object, and say where it looks for it."""

from __future__ import annotations

import numpy as np

from selfcal_ros.rorapid.projection.camera_models import ObjectPose
from selfcal_ros.rorapid.tracked_frame import TrackerState
from selfcal_ros.rorapid.tracker import RorapidTracker


class LedTracker(RorapidTracker):
    """Follow a known object through the images of one of several cameras."""

    def follow_from(self, state: ObjectPose, velocity: np.ndarray, covariance: np.ndarray,
                    stamp_ns: int | None, searches: bool) -> None:
        """
        Go on from where other cameras saw the object.

        Parameters
        ----------
        state : ObjectPose
            Of the object's middle, at `stamp_ns`.
        velocity, covariance : ndarray, shape (6,) and (12, 12)
            As of `ConstantVelocityFilter`.
        stamp_ns : int or None
        searches : bool
            The object is sought around there, not only measured.

        """
        if self._kalman is None:
            self.start(state.rotation, state.translation - state.rotation @ self.centre, lost=True)
        self._stamp_ns, self._led = stamp_ns, not searches
        if searches:
            self._standing.state = TrackerState.LOST
            self._filter.restart(state, self._wide(state))
            return
        kalman = self._filter
        kalman.state, kalman.velocity, kalman.covariance = state, velocity, covariance
        self._standing.follow()

    def doubted(self) -> np.ndarray:
        """Covariance (6, 6) of (theta, Delta) that a doubt of model or camera adds."""
        return self._doubts.covariance(self._filter.state, self._basis)
