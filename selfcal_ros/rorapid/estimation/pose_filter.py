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
"""The Kalman filter of a pose, within what motion and camera model allow."""

from __future__ import annotations

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.rorapid.estimation.allowed_motion import AllowedMotion
from selfcal_ros.rorapid.estimation.filter_start import started_filter
from selfcal_ros.rorapid.estimation.kalman_filter import ConstantVelocityFilter
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.start_search import proposed_covariance
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection


class PoseFilter:
    """
    What is known of a pose from all images so far.

    Parameters
    ----------
    projection : Projection
    options : TrackerOptions
    diameter_m : float
        Of the object.

    Attributes
    ----------
    allowed : AllowedMotion

    """

    def __init__(self, projection: Projection, options: TrackerOptions, diameter_m: float):
        """Wait for a start."""
        self._projection, self._options, self._diameter_m = projection, options, diameter_m
        self.allowed = AllowedMotion(projection, options)
        self._kalman: ConstantVelocityFilter | None = None

    @property
    def basis(self) -> np.ndarray:
        """Corrections that motion and camera model allow, (size, m)."""
        return self.allowed.basis

    @property
    def is_started(self) -> bool:
        """Whether there was a start."""
        return self._kalman is not None

    @property
    def kalman(self) -> ConstantVelocityFilter:
        """The filter, once there was a start."""
        if self._kalman is None:
            raise ArgumentError('The tracker needs a start pose before the first image.')
        return self._kalman

    def forget(self) -> None:
        """Forget the pose and what was learned of the motion."""
        self.allowed.reset()
        self._kalman = None

    def begin(self, state: ObjectPose, covariance: np.ndarray) -> None:
        """Start at a state with a covariance (6, 6) of (theta, Delta)."""
        self.allowed.begin()
        self._start(state, covariance)

    def _start(self, state: ObjectPose, covariance: np.ndarray) -> None:
        self._kalman = started_filter(self._projection, self.basis, self.allowed.free,
                                      self._options, self._diameter_m, state, covariance)

    def proposed_covariance(self, state: ObjectPose) -> np.ndarray:
        """Covariance (m, m) of a state that is only proposed."""
        return proposed_covariance(self._projection, self.basis, self._diameter_m, state)

    def restart_wide(self, state: ObjectPose) -> None:
        """Begin again at a state that is only proposed."""
        self.kalman.restart(state, self.proposed_covariance(state))

    def take(self, measured: PoseMeasurement) -> None:
        """Take in a measurement that is accepted."""
        if measured.with_prior:
            self.kalman.absorb(measured.state, measured.covariance,
                               None if measured.rows is None else measured.rows.late)
        else:
            self.kalman.update(measured.state, measured.covariance)

    def tell_rows(self) -> None:
        """Tell those who read the lines of the next image one by one how the object moves."""
        rows = self._projection.row_motion
        if rows is not None:
            B, m = self.basis, self.basis.shape[1]
            rows.now(B @ self.kalman.velocity, B @ self.kalman.covariance[m:, m:] @ B.T)

    def learns_motion(self) -> bool:
        """Whether the plane of motion has become known by the pose: then `switch`."""
        return self.allowed.learns(self.kalman.state, self.kalman.pose_covariance)

    def switch(self, camera_model: str) -> None:
        """Go on from the same pose with another basis of corrections, or camera model."""
        kalman, old = self.kalman, self.basis
        full, velocity = old @ kalman.pose_covariance @ old.T, old @ kalman.velocity
        self._projection.become(camera_model)
        self.allowed.lay()
        self._start(kalman.state, full[:6, :6])
        B, size = self.basis, self._projection.size
        moving = B.T @ velocity[:size]
        moving[self.allowed.free:] = 0
        self.kalman.restart(kalman.state, B.T @ full[:size, :size] @ B
                            + 1e-12 * np.eye(B.shape[1]), moving)
