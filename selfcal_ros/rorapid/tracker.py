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

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.estimation.corner_alignment import has_corners
from selfcal_ros.rorapid.estimation.edge_fit import PosePrior
from selfcal_ros.rorapid.estimation.filter_start import checked_start, start_covariance
from selfcal_ros.rorapid.estimation.free_turn import hold_free, with_any_turn
from selfcal_ros.rorapid.estimation.joint_search import alone, Searching
from selfcal_ros.rorapid.estimation.jump import JumpWatch
from selfcal_ros.rorapid.estimation.kalman_filter import DAMPING, seconds_between
from selfcal_ros.rorapid.estimation.plausibility import PlausibilityChecks
from selfcal_ros.rorapid.estimation.pose_estimator import PoseEstimator, SearchingEstimator
from selfcal_ros.rorapid.estimation.pose_filter import PoseFilter
from selfcal_ros.rorapid.estimation.pose_measurement import PoseMeasurement
from selfcal_ros.rorapid.estimation.rapid_tracker import RapidTracker
from selfcal_ros.rorapid.estimation.robust_tracker import RobustTracker
from selfcal_ros.rorapid.estimation.track_state import (
    ALONE, GUIDED, leaves_turn_open, rejection_reason, seeking_reason, TrackStateMachine)
from selfcal_ros.rorapid.estimation.start_search import (
    confirmed_again, LastSighting, relocalised, StartSearch)
from selfcal_ros.rorapid.estimation.told_frame import told_frame
from selfcal_ros.rorapid.estimation.twin_watch import TwinWatch
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.projection.row_motion import RowMotion
from selfcal_ros.rorapid.region.object_colour import ObjectColour
from selfcal_ros.rorapid.region.region_of_interest import checked_image
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.rorapid.visibility.visible_mesh import visible_of
from selfcal_ros.values.wireframe import WireframeModel

__all__ = ['RorapidTracker', 'TrackedFrame', 'TrackerOptions', 'TrackerState']

#: An object that was never seen is thought to be so many diameters of the image away.
_SOUGHT = 3.0


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
        rows = RowMotion(camera, options.line_delay_s, options.lines) if options.line_delay_s \
            else None
        self._projection = Projection(camera, options.camera_model, rows)
        self._pose = PoseFilter(self._projection, options, model.diameter_m)
        size = (camera.width or 1 << 30, camera.height or 1 << 30)
        self._control = ControlModel(visible_of(model, *options.control_points),
                                     self._projection, size)
        method = RobustTracker if options.method == 'modern' else RapidTracker
        self._method: PoseEstimator = method(self._control, self._pose.basis, options, self._rng)
        self._plausibility = PlausibilityChecks(self._control, self._pose.basis, options)
        self._track_state, self._policy = TrackStateMachine(), ALONE
        self._starting: StartSearch | None = None
        self._sighting, self._jump, self._twins = LastSighting(), JumpWatch(), TwinWatch()
        self._colour = ObjectColour()
        self._stamp_ns: int | None = None
        #: What the last image said of the pose; None where it did not confirm one.
        self.measured: PoseMeasurement | None = None

    @property
    def _unconfirmed(self) -> StartSearch | None:
        """What confirms the start, while no image has."""
        return self._starting if self.state is TrackerState.INITIALISING else None

    @property
    def state(self) -> TrackerState:
        """State after the last image; LOST before any start."""
        return self._track_state.state

    def reset(self) -> None:
        """Forget pose, texture and plane; a new start is needed."""
        self._method.reset()
        self._pose.forget()
        self._colour.forget()
        camera_model = self.options.camera_model
        if self._projection.model != camera_model or self.options.motion == 'planar':
            self._projection.become(camera_model)
            self._pose.allowed.lay()
            self._method.switch(self._pose.basis, camera_model)
            self._plausibility.adopt(self._control, self._pose.basis, self.options)
        self.measured = self._stamp_ns = self._starting = None
        self._policy = ALONE
        self._track_state.begin(lost=True)

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
            self._control = ControlModel(visible_of(self.model, *options.control_points),
                                         self._projection, self._control.image_size)
        self.options = options
        self._plausibility.adopt(self._control, self._pose.basis, options)
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
        guessed = start_covariance(rotation, centred, self._control.centre,
                                   self.model.diameter_m, covariance)
        state = self._projection.from_pose(rotation, centred)
        if focal_px is not None and self._projection.model == 'zoom':
            state = replace(state, zoom=focal_px / self.camera.K[0, 0])
        self._pose.begin(state, guessed)
        self._track_state.begin(lost)
        self._stamp_ns = None
        self._sighting.forget()
        self._jump.forget()
        self._twins.forget()
        if self._method.verifier is not None:
            self._method.verifier.disown()
        self._plausibility.begin(centred[2], distance_sigma_m, lost or not self.options.verifies)
        kalman = self._pose.kalman
        self._starting = StartSearch(kalman.state, kalman.pose_covariance.copy(),
                                     self.model.is_outlined, self.model.free_turns)
        if lost:
            self._pose.restart_wide(state)

    def seek(self) -> None:
        """
        Begin without a pose; the state becomes LOST until the object is recognised.

        A polyhedron is found by its corners, any object by its silhouette: before a plain
        background, or where it comes in before a camera that stands still.

        Raises
        ------
        ArgumentError
            If the method is one of the thesis's: they do not search.

        """
        self._method.seek()
        away = _SOUGHT * self.model.diameter_m * self.camera.K[0, 0] / min(
            self._control.image_size)
        self.start(np.eye(3), [0, 0, away] - self._control.centre, lost=True)

    def search_around(self, state: ObjectPose, stamp_ns: int | None) -> None:
        """Seek the object around a pose (of its middle) that other cameras tell, by itself."""
        self._told_by_others(state, stamp_ns)
        self._policy = ALONE
        self._track_state.lose()
        self._pose.restart_wide(state)

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
        self._pose.kalman.take_over(state, velocity, covariance)
        self._track_state.follow()

    def _told_by_others(self, state: ObjectPose, stamp_ns: int | None) -> None:
        """Take a start from other cameras, where there was none."""
        if not self._pose.is_started:
            self.start(state.rotation, state.translation - state.rotation @ self.centre, lost=True)
        self._stamp_ns = stamp_ns

    @property
    def doubt_covariance(self) -> np.ndarray:
        """Covariance (6, 6) of (theta, Delta) that a doubt of model or camera adds."""
        return self._plausibility.covariance(self._pose.kalman.state, self._pose.basis)

    @property
    def centre(self) -> np.ndarray:
        """Middle of the object in its own frame, (3,): what states are about."""
        return self._control.centre

    def track(self, image: np.ndarray, stamp_ns: int | None = None,
              depth: np.ndarray | None = None) -> TrackedFrame:
        """Find the object in the next image: `tracking`, by itself."""
        return alone(self.tracking(image, stamp_ns, depth))

    def tracking(self, image: np.ndarray, stamp_ns: int | None = None,
                 depth: np.ndarray | None = None) -> Searching[TrackedFrame]:
        """
        Find the object in the next image, beside others in the same one.

        Parameters
        ----------
        image : ndarray, shape (H, W) or (H, W, 3), uint8
            Grey or BGR.
        stamp_ns : int, optional
            Time of the image; without it images come at `frame_rate_hz`.
        depth : ndarray, shape (H, W), optional
            Metres along the optical axis, of the same pixels; 0 or NaN where there is none.

        Yields
        ------
        SearchTask
            To be sent its `SearchedEdges`; see `estimation.joint_search.together`.

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
        self.measured, kalman = None, self._pose.kalman
        picture = checked_image(image, self.camera)
        self._control.resize(picture.shape[1::-1])
        seconds = seconds_between(self._stamp_ns, stamp_ns, self.options.frame_rate_hz)
        self._stamp_ns = stamp_ns
        self._sighting.later(seconds)
        # what is lost stays where it was; a start is looked at more than once where it is tested
        starting, verifier = self._unconfirmed, self._method.verifier
        fresh = starting is not None and not (starting.tries and verifier)
        if not fresh and self.state is not TrackerState.LOST:
            kalman.predict(seconds, DAMPING if self._track_state.misses >= 1 else 0.0)
        self._pose.tell_rows()
        mask = None if starting is None else self._control.mask(kalman.state, picture.shape)
        if mask is not None:
            # in which grey an outline stands out
            self._colour.learn(picture, mask)
        image = self._colour.grey(picture)
        if fresh:
            measured = self._method.initialise(image, kalman.state, kalman.pose_covariance)
        else:
            measured = yield from self._method.measuring(image, kalman.state,
                                                         kalman.pose_covariance)
        if starting is None:
            measured = self._sought(image, measured)
            starting = self._unconfirmed
        if starting is not None and verifier is not None:
            return self._confirm(starting, verifier, image, measured, stamp_ns)
        outline = self._plausibility.outline
        if verifier is not None and outline is not None and self._policy.relocalises and (
                self.state is not TrackerState.LOST):
            wide = self._pose.proposed_covariance(measured.state)
            prior = PosePrior.of(kalman.state, kalman.pose_covariance)
            measured, other = outline.look(verifier, image, measured, prior, wide)
            if other:
                kalman.restart(measured.state, wide)
        if depth is not None and self._projection.model == 'perspective' and (
                measured.share >= self.options.lost_share):
            measured = self._plausibility.depths.improved(measured, depth, self._pose.basis)
        return self._judge(measured, image, stamp_ns)

    def _sought(self, image: np.ndarray, measured: PoseMeasurement) -> PoseMeasurement:
        """Seek what is not seen as expected; what is found again is tested, or a new start."""
        lost, seeker, verifier = (self.state is TrackerState.LOST, self._method.seeker,
                                  self._method.verifier)
        if seeker is not None and self._policy.relocalises and not measured.recognised and (
                lost or measured.share < self.options.tracking_share):
            measured = relocalised(seeker, image, measured, self._pose.kalman.state, lost,
                                   self._pose.proposed_covariance, self._twins)
        if lost:
            self._jump.forget()
        elif seeker is not None and self._policy.relocalises and (
                measured.share >= self.options.lost_share):
            measured = self._jump.look(seeker, image, measured, self._pose.kalman,
                                       self._pose.proposed_covariance)
        if not lost or not measured.recognised or verifier is None:
            return measured
        measured = confirmed_again(verifier, image, measured)
        if measured.recognised and self._track_state.good is None:
            # what was never confirmed is a start, not a return, and nobody said how far it is
            self._starting = StartSearch.again(
                measured.state, self._pose.proposed_covariance(measured.state),
                self.model.free_turns)
            self._plausibility.begin(measured.state.translation[2], None, sure=False)
            self._track_state.begin(lost=False)
            self._pose.kalman.restart(
                measured.state, measured.whole_covariance,
                self._sighting.velocity(self._projection, self._pose.basis, measured.state))
        return measured

    def _confirm(self, starting: StartSearch, method: SearchingEstimator, image: np.ndarray,
                 measured: PoseMeasurement, stamp_ns: int | None) -> TrackedFrame:
        """Take a start for a pose once an independent test confirms it; else say what lacks."""
        wide = self._pose.proposed_covariance(measured.state)
        measured, other = starting.look(method, image, measured, wide)
        if other:
            self._pose.kalman.restart(measured.state, wide)
            method.disown()
        good = measured.determined and measured.share >= self.options.lost_share
        if good and starting.confirmed(method):
            away = self._of_pose(measured.state, measured.whole_covariance)[5, 5]
            self._plausibility.confirmed(starting.sure, measured.state.translation[2],
                                         float(away)**0.5)
            return self._judge(measured, image, stamp_ns)
        if good:
            method.glance(image, measured)
            self._pose.take(measured)
        if self._track_state.gives_up(good, starting.given_up(not good), self.options):
            self._pose.restart_wide(starting.guess)
            method.disown()
        reason = measured.reason or starting.reason()
        return self._frame(measured, False, reason, float('nan'), stamp_ns)

    def _of_pose(self, state: ObjectPose, covariance: np.ndarray) -> np.ndarray:
        """Carry a covariance (m, m) of a correction to (theta, Delta), (6, 6)."""
        B = self._pose.basis
        return self._projection.covariance_of_pose(state, B @ covariance @ B.T)

    def _switch(self, camera_model: str) -> None:
        """Go on from the same pose with another basis of corrections."""
        self._pose.switch(camera_model)
        self._method.switch(self._pose.basis, camera_model)
        self._plausibility.adopt(self._control, self._pose.basis, self.options)

    def _judge(self, measured: PoseMeasurement, image: np.ndarray, stamp_ns: int | None,
               ) -> TrackedFrame:
        """Accept or refuse a measurement, and say what the state is."""
        options, track = self.options, self._track_state
        lost = self.state is TrackerState.LOST
        open_turn = self._policy.needs_whole_pose and leaves_turn_open(
            self._pose.basis, measured, self._control.free(measured.state))
        accepted, innovation = track.accepts(measured, open_turn, self._policy, options), np.nan
        if accepted:
            self.measured = measured
            innovation = self._pose.kalman.innovation_share(measured.state, measured.covariance)
            if lost:
                self._pose.kalman.restart(measured.state, measured.whole_covariance)
            else:
                self._pose.take(measured)
            tracking = measured.share >= options.tracking_share and not open_turn
            if tracking or measured.recognised or self._policy.learns_from_little:
                self._method.remember(measured, tracking or measured.recognised)
            if self._pose.learns_motion():
                self._switch(self._projection.model)
            if self._pose.allowed.leaves_zoom(measured.focal_sigma):
                self._switch('weak')
            if tracking and self._method.verifier is not None:
                self._twins.remember(image, measured.state)
                self._plausibility.look(image, measured, self._method.verifier.check)
            doubt = self._plausibility.text()
            reason = track.confirm(measured, tracking, doubt, options)
            if tracking and not doubt and self._projection.model != options.camera_model:
                reason = ('Focal length and distance cannot be told apart in these views; weak '
                          'perspective is used with the last focal length.')
        else:
            if track.rejects(options):
                self._pose.restart_wide(track.good or self._pose.kalman.state)
            elif not lost and self._policy.relocalises and track.misses <= 1:
                # it is not where it was expected
                self._pose.kalman.doubt_motion()
            seeking = '' if self._method.placed else seeking_reason(
                has_corners(self._control.visible_model))
            reason = rejection_reason(measured, seeking, open_turn, options)
        return self._frame(measured, accepted, reason, innovation, stamp_ns)

    def _frame(self, measured: PoseMeasurement, accepted: bool, reason: str, innovation: float,
               stamp_ns: int | None) -> TrackedFrame:
        """Say what the state is, with what a doubt adds to the covariance."""
        state, B = self._pose.kalman.state, self._pose.basis
        full = B @ self._pose.kalman.pose_covariance @ B.T
        free = self._control.free(state)
        if free.size and measured.details is not None:
            hold_free(self._pose.kalman, free, measured.details.fit.measured)
            full = with_any_turn(full, free)
        doubted = self._plausibility.covariance(state, B) if accepted else np.zeros((6, 6))
        shown = self._method.placed or self.state is not TrackerState.LOST
        return told_frame(self._control, measured, state, full, accepted, doubted=doubted,
                          shown=shown, told=self.state,
                          reason=reason, doubt=self._plausibility.text() if accepted else '',
                          innovation=innovation, stamp_ns=stamp_ns)
