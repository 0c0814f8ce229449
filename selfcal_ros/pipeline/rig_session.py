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
"""Tracks one object in the images of several cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from selfcal_ros.errors import InputError, SelfcalError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.instant import Instant
from selfcal_ros.pipeline.tracking_session import check_image, check_in_image, TrackingSession
from selfcal_ros.rorapid.estimation.joint_search import Searching
from selfcal_ros.rorapid.several_cameras.rig_frame import RigFrame
from selfcal_ros.rorapid.several_cameras.rig_tracker import check_rig_options, RigTracker
from selfcal_ros.rorapid.tracker import TrackerOptions, TrackerState
from selfcal_ros.values.camera_rig import PlacedCamera
from selfcal_ros.values.wireframe import WireframeModel


class RigSession(TrackingSession):
    """
    Follows one object through the images of several cameras.

    Parameters
    ----------
    model : WireframeModel
    cameras : sequence of PlacedCamera
        Poses are in the frame of the first one. Without any, nothing is tracked until
        `set_cameras`.
    options : TrackerOptions, optional
    seed : int

    Raises
    ------
    ArgumentError
        If an option is for a single camera.

    """

    def __init__(self, model: WireframeModel, cameras: Sequence[PlacedCamera],
                 options: TrackerOptions | None = None, seed: int = 0) -> None:
        super().__init__(model, options, None, seed)
        check_rig_options(self.options)
        self._placed = tuple(cameras)
        self.newest_of_rig: RigFrame | None = None
        if self._placed:
            self._take(self._placed[0].camera, self.options)

    @property
    def cameras(self) -> tuple[PlacedCamera, ...]:
        """The cameras in use."""
        return self._placed

    def set_cameras(self, cameras: Sequence[PlacedCamera]) -> bool:
        """
        Take calibrations and places; the object is followed on, or sought.

        Returns
        -------
        bool
            Whether they differ from those in use; else nothing is learned anew.

        """
        cameras = tuple(cameras)
        if len(cameras) == len(self._placed) and all(map(_is_same, cameras, self._placed)):
            return False
        self._place(cameras)
        return True

    def set_options(self, options: TrackerOptions) -> None:
        """Take other settings; see `TrackingSession.set_options`."""
        check_rig_options(options)
        super().set_options(options)

    def set_camera(self, camera: Camera, which: int = 0) -> bool:
        """Take a calibration of one of the cameras; see `TrackingSession.set_camera`."""
        if camera == self._placed[which].camera:
            return False
        self._place(tuple(replace(one, camera=camera) if k == which else one
                          for k, one in enumerate(self._placed)))
        return True

    def _place(self, cameras: tuple[PlacedCamera, ...]) -> None:
        """Go on with other cameras; those that are refused leave the old ones in use."""
        before, self._placed = self._placed, cameras
        try:
            self._take(cameras[0].camera, self.options)
        except SelfcalError:
            self._placed = before
            raise

    def _take(self, camera: Camera, options: TrackerOptions) -> None:
        tracker = RigTracker(self.model, self._placed, options, self._seed)
        newest = self._newest
        if newest is not None and {'tracking', 'degraded'} & set(self._by_state):
            tracker.start(newest.rotation, newest.translation,
                          lost=newest.state is TrackerState.LOST)
        else:
            self._begin(tracker)
        self._tracker, self._camera, self.options = tracker, camera, options

    def _check_start(self, points: np.ndarray) -> None:
        """Refuse a start that no camera sees; one of them is enough."""
        if not self._placed:
            check_in_image(None, points)
            return
        problems = []
        for one in self._placed:
            back = np.linalg.inv(one.T_rig_camera)
            here = points @ back[:3, :3].T + back[:3, 3]
            try:
                check_in_image(one.camera, here)
                return
            except InputError as error:
                problems.append(error)
        raise problems[0]

    def looking_at(self, instant: Instant) -> Searching[RigFrame]:
        """Find the object at an instant of several recordings; see `look`."""
        yield from ()
        return self.look([None if frame is None else frame.image for frame in instant.frames],
                         instant.stamp_ns)

    def look(self, images: Sequence[np.ndarray | None], stamp_ns: int | None = None) -> RigFrame:
        """
        Find the object in the images of one instant.

        Parameters
        ----------
        images : sequence of ndarray of uint8 (H, W) or (H, W, 3), or None
            Of each camera.
        stamp_ns : int, optional
            See `TrackingSession.add`.

        Returns
        -------
        RigFrame

        Raises
        ------
        InputError
            If there is no start pose yet, an image is of another size than its camera was
            calibrated for, or older than those before.

        """
        if self._tracker is None:
            raise InputError('There are no calibrations and places of the cameras yet.')
        if self._start is None and not self._seeking:
            raise InputError('There is no start pose yet; say roughly where the object is.')
        for image, one in zip(images, self._placed):
            if image is not None:
                try:
                    check_image(image, one.camera)
                except InputError as error:
                    raise InputError(f'{one.name}: {error}') from None
        stamp_ns = self._checked_stamp(stamp_ns)
        self.newest_of_rig = self._tracker.track(images, stamp_ns)
        self._count(self.newest_of_rig.tracked)
        return self.newest_of_rig


def _is_same(one: PlacedCamera, other: PlacedCamera) -> bool:
    """Whether name, calibration and place of two cameras are the same."""
    return (one.name == other.name and one.camera == other.camera
            and np.array_equal(one.T_rig_camera, other.T_rig_camera)
            and np.array_equal(one.covariance, other.covariance))
