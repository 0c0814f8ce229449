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
from selfcal_ros.rorapid.estimation.kalman_filter import ConstantVelocityFilter
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.rapid_tracker import RapidTracker
from selfcal_ros.rorapid.estimation.robust_tracker import RobustTracker
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.projection.motion_models import (completed, motion_basis, PlaneLearner,
                                                          recentring)
from selfcal_ros.rorapid.region.region_of_interest import checked_grey
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.values.wireframe import WireframeModel

__all__ = ['RorapidTracker', 'TrackedFrame', 'TrackerOptions', 'TrackerState']

#: Uncertainty of a first guess: share of the distance, diameters across, and radians.
_START_FRACTION, _START_DIAMETERS, _START_RAD = 0.02, 0.1, 0.05
#: Unknown first velocity: diameters of the object, and radians, per second.
_START_SPEED, _START_TURN = 2.0, 1.0
#: Uncertainty of a proposed place: radians, diameters of the object, share of the distance.
_PROPOSED_RAD, _PROPOSED_DIAMETERS, _PROPOSED_DEPTH = 0.3, 0.15, 0.1
#: Share of the velocity that is lost with each frame in which nothing is seen.
_DAMPING = 0.3
#: Random walk of what a restricted motion does not change, per square root of a second.
_RANDOM_WALK_RAD, _RANDOM_WALK_DIAMETERS = 2e-3, 1e-3
#: The plane of motion is learned when its normal is known so well, from so many poses.
_PLANE_RAD, _PLANE_POSES = 0.005, 30
#: Zoom is left when so many images in a row leave the focal length open by this share.
_ZOOM_OPEN, _ZOOM_FRAMES = 0.1, 10
#: Takes (theta, Delta) to (t, r), and back.
_TURN_LAST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
#: Longest time that a prediction reaches over, seconds.
_LONGEST_S = 0.5


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
        self._visible = VisibleModel(model, *options.control_points)
        self._plane = PlaneLearner()
        self._axis: tuple | np.ndarray | None = options.plane_axis
        self._camera_model = options.camera_model
        self._projection = Projection(camera, options.camera_model)
        self._lay_basis()
        size = (camera.width or 1 << 30, camera.height or 1 << 30)
        self._control = ControlModel(self._visible, self._projection, size)
        method = RobustTracker if options.method == 'modern' else RapidTracker
        self._method = method(self._control, self._basis, options, self._rng)
        self._kalman: ConstantVelocityFilter | None = None
        self._state, self._stamp_ns = TrackerState.LOST, None

    def _lay_basis(self) -> None:
        """Lay out the corrections that motion and camera model allow."""
        motion = self.options.motion
        if motion == 'planar' and self._axis is None:
            motion = 'general'                # until the plane is learned
        self._basis = motion_basis(motion, self._projection.size, self._axis)
        self._free = self._basis.shape[1]
        if self.options.method == 'modern':
            # what the motion does not change is estimated all the same, from all images
            self._basis = completed(self._basis)

    @property
    def _filter(self) -> ConstantVelocityFilter:
        """The filter, once there was a start."""
        if self._kalman is None:
            raise ArgumentError('The tracker needs a start pose before the first image.')
        return self._kalman

    @property
    def state(self) -> TrackerState:
        """State after the last image; LOST before any start."""
        return self._state

    def reset(self) -> None:
        """Forget pose, texture and plane; a new start is needed."""
        self._method.reset()
        self._plane.reset()
        self._axis = self.options.plane_axis
        if self._camera_model != self.options.camera_model or self.options.motion == 'planar':
            self._camera_model = self.options.camera_model
            self._projection.become(self._camera_model)
            self._lay_basis()
            self._method.switch(self._basis, self._camera_model)
        self._kalman = None
        self._state, self._stamp_ns = TrackerState.LOST, None

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
            self._visible = VisibleModel(self.model, *options.control_points)
            self._control = ControlModel(self._visible, self._projection, self._control.image_size)
        self.options = options
        self._method.adopt(options, self._control)
        return True

    def start(self, rotation: ArrayLike, translation: ArrayLike,
              covariance: ArrayLike | None = None, focal_px: float | None = None,
              lost: bool = False) -> None:
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

        Raises
        ------
        ArgumentError
            If it is no pose, or the object is behind the camera.

        """
        rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
        if rotation.shape != (3, 3) or translation.shape != (3,) or not (
                np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise ArgumentError('A start pose is a 3x3 rotation and three finite metres.')
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-2 or np.linalg.det(rotation) < 0:
            raise ArgumentError('The rotation of the start pose is not a rotation matrix.')
        U, _, Vt = np.linalg.svd(rotation)
        rotation = U @ Vt
        centred = translation + rotation @ self._control.centre
        if not centred[2] > 0:
            raise ArgumentError('The start pose puts the object behind the camera (z is not '
                                'positive).')
        if covariance is None:
            # a guess is right to some pixels, however far away the object is
            depth = _START_FRACTION * centred[2]
            lateral = min(depth, _START_DIAMETERS * self.model.diameter_m)
            spread = np.diag(np.square([_START_RAD] * 3 + [lateral, lateral, depth]))
        else:
            spread = np.asarray(covariance, float)
            if spread.shape != (6, 6) or not np.isfinite(spread).all():
                raise ArgumentError('The covariance of a start pose is a finite 6x6 matrix.')
            back = np.linalg.inv(recentring(rotation @ self._control.centre))
            spread = back @ spread[_TURN_LAST] @ back.T
            spread += np.diag([1e-8] * 3 + [(1e-4 * centred[2])**2] * 3)
        state = self._projection.from_pose(rotation, centred)
        if focal_px is not None and self._camera_model == 'zoom':
            state = replace(state, zoom=focal_px / self.camera.K[0, 0])
        self._start_filter(state, spread)
        self._state = TrackerState.LOST if lost else TrackerState.INITIALISING
        self._misses, self._open, self._stamp_ns = 0.0, 0, None
        self._good: ObjectPose | None = None
        if lost:
            self._filter.restart(state, self._wide(state))

    def _start_filter(self, state, spread) -> None:
        """Start the Kalman filter at a state with a covariance of (theta, Delta)."""
        options, size = self.options, self._projection.size
        full = np.zeros((size, size))
        turn, speed = np.zeros(size), np.zeros(size)
        diameter = self.model.diameter_m
        if size == 8:
            scale = 1 / state.translation[2]
            full[:6, :6] = np.eye(6) * (_START_RAD * scale)**2
            full[6:, 6:] = np.eye(2) * (_START_FRACTION)**2
            speed[:6], speed[6:] = _START_TURN * scale, _START_SPEED * diameter * scale
            turn[:6] = options.acceleration_rad_s2 * scale
            turn[6:] = options.acceleration_m_s2 * scale
        else:
            full[:6, :6] = spread
            speed[:6] = [_START_TURN] * 3 + [_START_SPEED * diameter] * 3
            turn[:6] = [options.acceleration_rad_s2] * 3 + [options.acceleration_m_s2] * 3
            if size == 7:
                full[6, 6] = 0.15**2
                speed[6], turn[6] = options.zoom_rate_s, options.zoom_rate_s
        B = self._basis
        speed, turn = (np.sqrt(np.einsum('im,i->m', B**2, sigma**2)) for sigma in (speed, turn))
        random_walk = np.zeros(B.shape[1])
        if self._free < B.shape[1]:
            wide = np.r_[[_RANDOM_WALK_RAD] * 3, [_RANDOM_WALK_DIAMETERS * diameter] * 3,
                         [0.0] * (size - 6)]
            if size == 8:
                wide = np.full(8, _RANDOM_WALK_DIAMETERS * diameter * scale)
            random_walk[self._free:] = np.sqrt(np.einsum('im,i->m', B**2, wide**2))[self._free:]
            speed[self._free:] = turn[self._free:] = 0
        self._kalman = ConstantVelocityFilter(self._projection, B, state, B.T @ full @ B, speed,
                                              turn, random_walk)

    def track(self, image: np.ndarray, stamp_ns: int | None = None) -> TrackedFrame:
        """
        Find the object in the next image.

        Parameters
        ----------
        image : ndarray, shape (H, W) or (H, W, 3), uint8
            Grey or BGR.
        stamp_ns : int, optional
            Time of the image; without it images come at `frame_rate_hz`.

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
        if self._kalman is None:
            raise ArgumentError('The tracker needs a start pose before the first image.')
        image = checked_grey(image, self.camera)
        self._control.resize(image.shape[::-1])
        seconds = self._elapsed(stamp_ns)
        lost = self._state is TrackerState.LOST
        first = self._state is TrackerState.INITIALISING
        if not (first or lost):
            self._filter.predict(seconds, _DAMPING if self._misses >= 1 else 0.0)
        predicted, spread = self._filter.state, self._filter.spread
        if first:
            measured = self._method.initialise(image, predicted, spread)
        else:
            measured = self._method.measure(image, predicted, spread)
        if not first and self.options.seeks and not measured.recognised and (
                lost or measured.share < self.options.tracking_share):
            measured = self._relocalise(image, measured, lost)
        return self._judge(measured, stamp_ns)

    def _relocalise(self, image, measured: PoseMeasurement, lost: bool) -> PoseMeasurement:
        """Try other places for the object; return the measurement that is confirmed best."""
        proposals = self._method.proposals(image, self._filter.state, lost,
                                           self._wide(self._filter.state))
        for state in proposals:
            other = self._method.measure(image, state, self._wide(state))
            if other.determined and (other.recognised, other.share) > (
                    measured.recognised, measured.share + 0.05):
                measured = other
            if measured.recognised:
                break
        return measured

    def _wide(self, state) -> np.ndarray:
        """Covariance (m, m) of a state that is only proposed."""
        size = self._projection.size
        sigma = np.full(size, 0.1)
        if size == 8:
            sigma /= state.translation[2]
        else:
            sigma[:3] = _PROPOSED_RAD
            sigma[3:6] = _PROPOSED_DIAMETERS * self.model.diameter_m
            sigma[5] = max(sigma[5], _PROPOSED_DEPTH * state.translation[2])
        return (self._basis.T * sigma**2) @ self._basis

    def _adapt(self, measured: PoseMeasurement) -> None:
        """Learn the plane of motion; leave a zoom that the images leave open."""
        if self.options.motion == 'planar' and self._axis is None:
            state, B = self._filter.state, self._basis
            self._plane.add(state.rotation, state.translation,
                            (B @ self._filter.spread @ B.T)[:6, :6])
            plane = self._plane.plane()
            if plane.sigma_rad < _PLANE_RAD and self._plane.count >= _PLANE_POSES:
                self._axis = plane.axis
                self._switch(self._camera_model)
        if self._camera_model == 'zoom':
            self._open = self._open + 1 if measured.focal_sigma > _ZOOM_OPEN else 0
            if self._open >= _ZOOM_FRAMES:
                self._switch('weak')

    def _switch(self, camera_model: str) -> None:
        """Go on from the same pose with another basis of corrections."""
        kalman, old = self._filter, self._basis
        full, velocity = old @ kalman.spread @ old.T, old @ kalman.velocity
        self._camera_model = camera_model
        self._projection.become(camera_model)
        self._lay_basis()
        self._method.switch(self._basis, camera_model)
        self._start_filter(kalman.state, full[:6, :6])
        B, size = self._basis, self._projection.size
        moving = B.T @ velocity[:size]
        moving[self._free:] = 0
        self._filter.restart(kalman.state, B.T @ full[:size, :size] @ B
                             + 1e-12 * np.eye(B.shape[1]), moving)

    def _elapsed(self, stamp_ns):
        """Seconds since the last image."""
        before, self._stamp_ns = self._stamp_ns, stamp_ns
        if stamp_ns is None or before is None or stamp_ns <= before:
            return 1 / self.options.frame_rate_hz
        return min((stamp_ns - before) * 1e-9, _LONGEST_S)

    def _judge(self, measured: PoseMeasurement, stamp_ns) -> TrackedFrame:
        """Accept or refuse a measurement, and say what the state is."""
        options = self.options
        lost = self._state is TrackerState.LOST
        accepted = measured.determined and (
            measured.recognised if lost else measured.share >= options.lost_share)
        innovation = float('nan')
        if accepted and not measured.recognised and measured.share <= options.lost_share:
            # barely found, and not recognised: half a miss
            self._misses += 0.5
            accepted = self._misses < options.frames_to_lost
        elif accepted:
            self._misses = 0
        else:
            self._misses += 1
        if accepted:
            innovation = self._filter.innovation_share(measured.state, measured.covariance)
            if lost:
                self._filter.restart(measured.state, measured.covariance)
            elif measured.with_prior:
                self._filter.absorb(measured.state, measured.covariance)
            else:
                self._filter.update(measured.state, measured.covariance)
            self._adapt(measured)
            tracking = measured.share >= options.tracking_share
            self._state = TrackerState.TRACKING if tracking else TrackerState.DEGRADED
            self._good = measured.state
            self._method.remember(measured, tracking or measured.recognised)
            reason = '' if tracking else (
                f'Only {100 * measured.share:.0f} % of what should be visible is found.')
            if tracking and self._camera_model != options.camera_model:
                reason = ('Focal length and distance cannot be told apart in these views; weak '
                          'perspective is used with the last focal length.')
        else:
            if not lost and self._misses >= options.frames_to_lost:
                self._state = TrackerState.LOST
                place = self._filter.state if self._good is None else self._good
                self._filter.restart(place, self._wide(place))
            elif not lost and self._state is not TrackerState.INITIALISING:
                self._state = TrackerState.DEGRADED
            reason = measured.reason or (
                f'Only {100 * measured.share:.0f} % of what should be visible is found where '
                'the object was expected.')
        return self._frame(measured, accepted, reason, innovation, stamp_ns)

    def _frame(self, measured, accepted, reason, innovation, stamp_ns) -> TrackedFrame:
        """Put the result into the object's own frame."""
        state = self._filter.state
        arm = state.rotation @ self._control.centre
        B = self._basis
        full = B @ self._filter.spread @ B.T
        carry = recentring(arm)
        pose = carry @ self._projection.covariance_of_pose(state, full) @ carry.T
        view = measured.view if accepted and measured.with_prior else self._control.again(
            measured.view, state)
        edge = measured.edge_px
        found = measured.found & accepted
        rms = float(np.sqrt(np.mean(edge[found]**2))) if found.any() else float('nan')
        focal = float(self.camera.K[0, 0] * state.zoom)
        sigma = focal * float(np.sqrt(full[6, 6])) if len(full) == 7 else 0.0
        return TrackedFrame(
            state=self._state, reason=reason, rotation=state.rotation,
            translation=state.translation - arm, covariance=pose[_TURN_LAST], focal_px=focal,
            focal_sigma_px=sigma, camera_model=self._camera_model,
            image_px=view.projected.pixels, normal=view.normal, edge_px=edge, found=found,
            rejected=np.isfinite(edge) & ~found, hidden=~view.searched,
            primitive=view.primitive, texture_px=measured.texture_px, rms_px=rms,
            share_found=measured.share, innovation=innovation, stamp_ns=stamp_ns)
