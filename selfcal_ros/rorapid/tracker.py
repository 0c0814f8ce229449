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
"""RAPiD, RoRAPiD and what came after: the pose of a known object from frame to frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.estimation.allowed_motion import AllowedMotion
from selfcal_ros.rorapid.estimation.doubts import Doubts
from selfcal_ros.rorapid.estimation.filter_start import (
    checked_start, start_spread, started_filter)
from selfcal_ros.rorapid.estimation.free_turn import hold_free, with_any_turn
from selfcal_ros.rorapid.estimation.kalman_filter import (
    ConstantVelocityFilter, DAMPING, seconds_between)
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.rapid_tracker import RapidTracker
from selfcal_ros.rorapid.estimation.robust_tracker import RobustTracker
from selfcal_ros.rorapid.estimation.standing import (
    ALONE, GUIDED, leaves_turn_open, refusal, Standing)
from selfcal_ros.rorapid.estimation.start_search import (
    confirmed_again, proposed_spread, relocalised, StartSearch)
from selfcal_ros.rorapid.estimation.told_frame import told_frame
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.region.object_colour import ObjectColour
from selfcal_ros.rorapid.region.region_of_interest import checked_image
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.rorapid.visibility.visible_mesh import visible_of, VisibleMesh
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.wireframe import WireframeModel

__all__ = ['RorapidTracker', 'TrackedFrame', 'TrackerOptions', 'TrackerState']

#: An object that was never seen is thought to be so many diameters of the image away.
_SOUGHT = 3.0
_NO_START = 'The tracker needs a start pose before the first image.'


class RorapidTracker:
    """
    Follow a known object through images.

    Parameters
    ----------
    model : WireframeModel
    camera : Camera
    options : TrackerOptions, optional
    rng : numpy.random.Generator, optional
        For the samples of RANSAC; None: a generator of fixed seed.

    """

    def __init__(self, model: WireframeModel, camera: Camera,
                 options: TrackerOptions | None = None,
                 rng: np.random.Generator | None = None) -> None:
        """Prepare the model for this camera."""
        self.model, self.camera = model, camera
        self.options = options = TrackerOptions() if options is None else options
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._visible = visible_of(model, *options.control_points)
        self._projection = Projection(camera, options.camera_model)
        self._allowed = AllowedMotion(self._projection, options)
        size = (camera.width or 1 << 30, camera.height or 1 << 30)
        self._control = ControlModel(self._visible, self._projection, size)
        method = RobustTracker if options.method == 'modern' else RapidTracker
        self._method = method(self._control, self._basis, options, self._rng)
        self._kalman: ConstantVelocityFilter | None = None
        self._doubts = Doubts(self._control, self._basis, options, self._is_perspective)
        self._standing, self._policy = Standing(), ALONE
        self._starting: StartSearch | None = None
        self._colour = ObjectColour()
        self._stamp_ns: int | None = None
        #: What the last image said of the pose; None where it did not confirm one.
        self.measured: PoseMeasurement | None = None

    @property
    def _basis(self) -> np.ndarray:
        """Corrections that motion and camera model allow, (size, m)."""
        return self._allowed.basis

    @property
    def _filter(self) -> ConstantVelocityFilter:
        """The filter, once there was a start."""
        if self._kalman is None:
            raise ArgumentError(_NO_START)
        return self._kalman

    @property
    def _start_search(self) -> StartSearch:
        """What confirms the start, once there was one."""
        if self._starting is None:
            raise ArgumentError(_NO_START)
        return self._starting

    @property
    def _outlined(self) -> bool:
        return isinstance(self.model, MeshModel)

    @property
    def _is_perspective(self) -> bool:
        return self._projection.model == 'perspective'

    @property
    def state(self) -> TrackerState:
        """State after the last image; LOST before any start."""
        return self._standing.state

    def reset(self) -> None:
        """Forget pose, texture and plane; a new start is needed."""
        self._method.reset()
        self._allowed.reset()
        self._colour.forget()
        camera_model = self.options.camera_model
        if self._projection.model != camera_model or self.options.motion == 'planar':
            self._projection.become(camera_model)
            self._allowed.lay()
            self._method.switch(self._basis, camera_model)
        self._kalman = self.measured = self._stamp_ns = self._starting = None
        self._policy = ALONE
        self._standing.begin(lost=True)

    def adopt(self, options: TrackerOptions) -> bool:
        """
        Go on by other settings, with all that was learned: pose, velocity, plane, appearance.

        Returns
        -------
        bool
            False, and nothing has changed, where it takes a new tracker (`built_in` differs).

        Raises
        ------
        ArgumentError
            If there were too many control points; nothing has changed then, either.

        """
        if options.built_in != self.options.built_in:
            return False
        if options.control_points != self.options.control_points:
            self._visible = visible_of(self.model, *options.control_points)
            self._control = ControlModel(self._visible, self._projection, self._control.image_size)
        self.options = options
        self._doubts.adopt(self._control, self._basis, options, self._is_perspective)
        self._method.adopt(options, self._control)
        return True

    def start(self, rotation: ArrayLike, translation: ArrayLike,
              covariance: ArrayLike | None = None, focal_px: float | None = None,
              lost: bool = False, distance_sigma_m: float | None = None) -> None:
        """
        Take a guess of the pose; the state becomes INITIALISING, or LOST.

        Parameters
        ----------
        rotation : array_like, shape (3, 3)
        translation : array_like, shape (3,)
            Metres, object before the camera.
        covariance : array_like, shape (6, 6), optional
            Of the guess, (tx ty tz rx ry rz).
        focal_px : float, optional
            fx where a zoom stands; that of the camera by default.
        lost : bool
            The object was last seen there, and is to be sought.
        distance_sigma_m : float, optional
            Standard deviation of its distance, where that was measured: it tells the size of the
            object, which images do not.

        Raises
        ------
        ArgumentError
            If it is no pose, or the object is behind the camera.

        """
        rotation, translation = checked_start(rotation, translation)
        centred = translation + rotation @ self._control.centre
        spread = start_spread(rotation, centred, self._control.centre, self.model.diameter_m,
                              covariance)
        state = self._projection.from_pose(rotation, centred)
        if focal_px is not None and self._projection.model == 'zoom':
            state = replace(state, zoom=focal_px / self.camera.K[0, 0])
        self._start_filter(state, spread)
        self._standing.begin(lost)
        self._allowed.begin()
        self._stamp_ns = None
        self._doubts.begin(centred[2], distance_sigma_m, lost or not self.options.doubts)
        self._starting = StartSearch(self._filter.state, self._filter.spread.copy(),
                                     self._outlined, self.model.free_turns)
        if lost:
            self._filter.restart(state, self._wide(state))

    def seek(self) -> None:
        """
        Begin without a pose; the state becomes LOST until the object is recognised.

        It is found by its silhouette, before a plain background, or where it comes in before a
        camera that stands still.

        Raises
        ------
        ArgumentError
            If the method is one of the thesis's: they do not search.

        """
        method = self._method
        if not isinstance(method, RobustTracker):
            raise ArgumentError('A start without a pose needs the method modern.')
        away = _SOUGHT * self.model.diameter_m * self.camera.K[0, 0] / min(
            self._control.image_size)
        self.start(np.eye(3), [0, 0, away] - self._control.centre, lost=True)
        method.placed = False

    def search_around(self, state: ObjectPose, stamp_ns: int | None) -> None:
        """Seek the object around a pose (of its middle) that other cameras tell, by itself."""
        self._told_by_others(state, stamp_ns)
        self._policy = ALONE
        self._standing.lose()
        self._filter.restart(state, self._wide(state))

    def follow(self, state: ObjectPose, velocity: np.ndarray, covariance: np.ndarray,
               stamp_ns: int | None) -> None:
        """
        Go on from where other cameras see the object: it is measured there, not sought.

        Parameters
        ----------
        state : ObjectPose
            Of the object's middle, at `stamp_ns`.
        velocity, covariance : ndarray, shape (6,) and (12, 12)
            As of `ConstantVelocityFilter`.
        stamp_ns : int or None

        """
        self._told_by_others(state, stamp_ns)
        self._policy = GUIDED
        self._filter.take_over(state, velocity, covariance)
        self._standing.follow()

    def _told_by_others(self, state: ObjectPose, stamp_ns: int | None) -> None:
        """Take a start from other cameras, where there was none."""
        if self._kalman is None:
            self.start(state.rotation, state.translation - state.rotation @ self.centre, lost=True)
        self._stamp_ns = stamp_ns

    @property
    def doubt_covariance(self) -> np.ndarray:
        """Covariance (6, 6) of (theta, Delta) that a doubt of model or camera adds."""
        return self._doubts.covariance(self._filter.state, self._basis)

    @property
    def centre(self) -> np.ndarray:
        """Middle of the object in its own frame, (3,): what states are about."""
        return self._control.centre

    def _start_filter(self, state, spread) -> None:
        """Start the Kalman filter at a state with a covariance of (theta, Delta)."""
        self._kalman = started_filter(self._projection, self._basis, self._allowed.free,
                                      self.options, self.model.diameter_m, state, spread)

    def track(self, image: np.ndarray, stamp_ns: int | None = None,
              depth: np.ndarray | None = None) -> TrackedFrame:
        """
        Find the object in the next image.

        Parameters
        ----------
        image : ndarray, shape (H, W) or (H, W, 3), uint8
            Grey or BGR.
        stamp_ns : int, optional
            Time of the image; without it images come at `frame_rate_hz`.
        depth : ndarray, shape (H, W), optional
            Metres along the optical axis, of the same pixels; 0 or NaN where there is none.

        Returns
        -------
        TrackedFrame

        Raises
        ------
        ArgumentError
            If there was no `start`.
        InputError
            If the image is not of the camera's size or type.

        """
        self.measured, kalman = None, self._filter
        picture = checked_image(image, self.camera)
        self._control.resize(picture.shape[1::-1])
        seconds = seconds_between(self._stamp_ns, stamp_ns, self.options.frame_rate_hz)
        self._stamp_ns = stamp_ns
        lost = self.state is TrackerState.LOST
        first = self.state is TrackerState.INITIALISING
        fresh = first and not (self._start_search.tries and self.options.doubts)
        if not lost and not fresh:
            kalman.predict(seconds, DAMPING if self._standing.misses >= 1 else 0.0)
        predicted, spread = kalman.state, kalman.spread
        if first and isinstance(self._visible, VisibleMesh):
            self._colour.learn(picture, self._visible.mask(
                predicted.rotation, predicted.translation - predicted.rotation @ self.centre,
                picture.shape[:2], lambda points: self._projection.project(
                    predicted, points - self.centre).pixels))
        image = self._colour.grey(picture)
        if fresh:
            measured = self._method.initialise(image, predicted, spread)
        else:
            measured = self._method.measure(image, predicted, spread)
        if first and self.options.doubts and isinstance(self._method, RobustTracker):
            return self._confirm(self._method, image, measured, stamp_ns)
        if not first and self.options.seeks and self._policy.relocalises and not (
                measured.recognised) and (lost or measured.share < self.options.tracking_share):
            measured = relocalised(self._method, image, measured, self._filter.state, lost,
                                   self._wide)
        if lost and measured.recognised and self.options.doubts and isinstance(
                self._method, RobustTracker):
            measured = confirmed_again(self._method, image, measured)
            if measured.recognised and self._standing.good is None and self._outlined:
                # an outline that was never confirmed is a start, not a return
                self._starting = StartSearch.again(
                    measured.state, self._wide(measured.state), self.model.free_turns)
                self._standing.begin(lost=False)
                self._filter.restart(measured.state, measured.covariance)
                return self._confirm(self._method, image, measured, stamp_ns)
        if depth is not None and self._is_perspective and (
                measured.share >= self.options.lost_share):
            measured = self._doubts.depths.improved(measured, depth, self._basis)
        return self._judge(measured, image, stamp_ns)

    def _confirm(self, method: RobustTracker, image, measured: PoseMeasurement,
                 stamp_ns) -> TrackedFrame:
        """Take a start for a pose once an independent test confirms it; else say what lacks."""
        starting, wide = self._start_search, self._wide(measured.state)
        measured, other = starting.look(method, image, measured, wide)
        if other:
            self._filter.restart(measured.state, wide)
        good = measured.determined and measured.share >= self.options.lost_share
        if good and starting.confirmed(method):
            self._doubts.confirmed(starting.sure, measured.state.translation[2])
            return self._judge(measured, image, stamp_ns)
        if good:
            self._standing.misses = 0.0
            method.glance(image, measured.state)
            self._filter.absorb(measured.state, measured.covariance)
        else:
            self._standing.misses += 1
        if starting.given_up or self._standing.misses >= self.options.frames_to_lost:
            self._standing.lose()
            self._filter.restart(starting.guess, self._wide(starting.guess))
        reason = measured.reason or starting.reason()
        return self._frame(measured, False, reason, float('nan'), stamp_ns)

    def _wide(self, state) -> np.ndarray:
        """Covariance (m, m) of a state that is only proposed."""
        return proposed_spread(self._projection, self._basis, self.model.diameter_m, state)

    def _adapt(self, measured: PoseMeasurement) -> None:
        """Learn the plane of motion; leave a zoom that the images leave open."""
        if self._allowed.learns(self._filter.state, self._filter.spread):
            self._switch(self._projection.model)
        if self._allowed.leaves_zoom(measured.focal_sigma):
            self._switch('weak')

    def _switch(self, camera_model: str) -> None:
        """Go on from the same pose with another basis of corrections."""
        kalman, old = self._filter, self._basis
        full, velocity = old @ kalman.spread @ old.T, old @ kalman.velocity
        self._projection.become(camera_model)
        self._allowed.lay()
        self._method.switch(self._basis, camera_model)
        self._doubts.adopt(self._control, self._basis, self.options, self._is_perspective)
        self._start_filter(kalman.state, full[:6, :6])
        B, size = self._basis, self._projection.size
        moving = B.T @ velocity[:size]
        moving[self._allowed.free:] = 0
        self._filter.restart(kalman.state, B.T @ full[:size, :size] @ B
                             + 1e-12 * np.eye(B.shape[1]), moving)

    def _judge(self, measured: PoseMeasurement, image, stamp_ns) -> TrackedFrame:
        """Accept or refuse a measurement, and say what the state is."""
        options, standing = self.options, self._standing
        lost = self.state is TrackerState.LOST
        open_turn = self._policy.needs_whole_pose and leaves_turn_open(
            self._basis, measured, self._control.free(measured.state))
        accepted, innovation = standing.weighs(measured, open_turn, self._policy, options), np.nan
        if accepted:
            self.measured = measured
            innovation = self._filter.innovation_share(measured.state, measured.covariance)
            if lost:
                self._filter.restart(measured.state, measured.covariance)
            elif measured.with_prior:
                self._filter.absorb(measured.state, measured.covariance)
            else:
                self._filter.update(measured.state, measured.covariance)
            tracking = measured.share >= options.tracking_share and not open_turn
            if tracking or measured.recognised or self._policy.learns_from_little:
                self._method.remember(measured, tracking or measured.recognised)
            self._adapt(measured)
            if tracking and isinstance(self._method, RobustTracker):
                self._doubts.look(image, measured, self._method.check)
            doubt = self._doubts.text()
            reason = standing.confirm(measured, tracking, doubt, options)
            if tracking and not doubt and self._projection.model != options.camera_model:
                reason = ('Focal length and distance cannot be told apart in these views; weak '
                          'perspective is used with the last focal length.')
        else:
            if standing.refuse(options):
                place = self._filter.state if standing.good is None else standing.good
                self._filter.restart(place, self._wide(place))
            reason = refusal(measured, isinstance(self._method, RobustTracker)
                             and not self._method.placed, open_turn, options)
        return self._frame(measured, accepted, reason, innovation, stamp_ns)

    def _frame(self, measured, accepted, reason, innovation, stamp_ns) -> TrackedFrame:
        """Say what the state is, with what a doubt adds to the covariance."""
        state, B = self._filter.state, self._basis
        full = B @ self._filter.spread @ B.T
        free = self._control.free(state)
        if free.size and measured.details is not None:
            hold_free(self._filter, free, measured.details.fit.measured)
            full = with_any_turn(full, free)
        if accepted and len(full) == 6:
            full = full + self._doubts.covariance(state, B)
        return told_frame(self._control, measured, state, full, accepted, told=self.state,
                          reason=reason, doubt=self._doubts.text() if accepted else '',
                          innovation=innovation, stamp_ns=stamp_ns)
