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
The pose of one object from the images of several cameras that sit still to each other.

Each camera looks near the prediction that all share. What its image says is an information matrix
and a pull; those of all images add up, and with the prediction they are one pose and one
covariance. A camera that does not see the object adds nothing. Where cameras contradict each
other, they are not mixed: the largest group that agrees gives the pose, the covariance counts the
whole difference, and the finding is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.scaled_inverse import is_regular
from selfcal_ros.rorapid.estimation.filter_start import (
    checked_start, started_filter, TURN_LAST)
from selfcal_ros.rorapid.estimation.free_turn import hold_free, with_any_turn
from selfcal_ros.rorapid.estimation.kalman_filter import (
    ConstantVelocityFilter, DAMPING, seconds_between)
from selfcal_ros.rorapid.estimation.track_quality import RANK_TOLERANCE
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.projection.free_directions import free_at
from selfcal_ros.rorapid.projection.motion_models import recentring
from selfcal_ros.rorapid.several_cameras.agreement import Agreement, CONFLICT
from selfcal_ros.rorapid.several_cameras.rig_camera import PoseInformation, RigCamera
from selfcal_ros.rorapid.several_cameras.rig_frame import RigFrame, unseen
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.values.camera_rig import placed_beside, PlacedCamera
from selfcal_ros.values.wireframe import WireframeModel

#: Instants in a row without an image of a camera that saw the object last.
_UNSEEN = 3


class RigTracker:
    """
    Follow a known object through the images of several cameras.

    Parameters
    ----------
    model : WireframeModel
    cameras : sequence of PlacedCamera
        Poses are in the frame of the first one.
    options : TrackerOptions, optional
    seed : int

    Raises
    ------
    ArgumentError
        If an option is for a single camera.

    """

    def __init__(self, model: WireframeModel, cameras: Sequence[PlacedCamera],
                 options: TrackerOptions | None = None, seed: int = 0):
        """Prepare the model for each camera."""
        self.options = options = TrackerOptions() if options is None else options
        check_rig_options(options)
        self.model, self.cameras = model, placed_beside(cameras)
        self.members = [RigCamera(model, placed, options, np.random.default_rng(seed))
                        for placed in self.cameras]
        self._names = [placed.name for placed in self.cameras]
        self._projection = Projection(cameras[0].camera)
        self._centre = self.members[0].tracker.centre
        self._agreement = Agreement(np.array([camera.place for camera in self.members]))
        self.reset()

    @property
    def state(self) -> TrackerState:
        """State after the last images; LOST before any start."""
        return self._state

    def reset(self) -> None:
        """Forget all that was learned; a new start is needed."""
        for camera in self.members:
            camera.reset()
        self._begin(TrackerState.LOST)

    def _begin(self, state: TrackerState) -> None:
        self._agreement.forget()
        self._kalman: ConstantVelocityFilter | None = None
        self._stamp_ns: int | None = None
        # what some camera saw last, for instants at which none that sees has an image
        self._shown: TrackedFrame | None = None
        self._misses, self._unseen, self._state = 0, 0, state
        self._reason = ''

    def start(self, rotation: ArrayLike, translation: ArrayLike,
              covariance: ArrayLike | None = None, lost: bool = False,
              distance_sigma_m: float | None = None) -> None:
        """
        Take a guess of the pose in the frame of the first camera; see `RorapidTracker.start`.

        Raises
        ------
        ArgumentError
            If it is no pose, or behind all cameras.

        """
        rotation, translation = checked_start(rotation, translation)
        # of all cameras: each may be the one that sees the object
        if not any([camera.start(rotation, translation, covariance, lost, distance_sigma_m)
                    for camera in self.members]):
            raise ArgumentError('The start pose puts the object behind all cameras.')
        self._begin(TrackerState.LOST if lost else TrackerState.INITIALISING)

    def seek(self) -> None:
        """Begin without a pose; see `RorapidTracker.seek`."""
        for camera in self.members:
            camera.seek()
        self._begin(TrackerState.LOST)

    def adopt(self, options: TrackerOptions) -> bool:
        """Go on by other settings; see `RorapidTracker.adopt`."""
        check_rig_options(options)
        if options.built_in != self.options.built_in:
            return False
        for camera in self.members:
            camera.tracker.adopt(options)
        self.options = options
        return True

    def track(self, images: Sequence[np.ndarray | None],
              stamp_ns: int | None = None) -> RigFrame:
        """
        Find the object in the next images.

        Parameters
        ----------
        images : sequence of ndarray (H, W) or (H, W, 3) of uint8, or None
            Of each camera, of one instant; None where there is none.
        stamp_ns : int, optional

        Returns
        -------
        RigFrame

        Raises
        ------
        ArgumentError
            If there was no start, or no image.
        InputError
            If an image is not of its camera's size or type, or the first ones are of cameras
            that the start is behind.

        """
        if all(image is None for image in images):
            raise ArgumentError('There is no image of any camera.')
        kalman = self._kalman
        views: list[TrackedFrame | None] = []
        for camera, image in zip(self.members, images):
            if image is not None and kalman is not None:
                camera.expect(kalman, self._stamp_ns)
            views.append(None if image is None else camera.look(image, stamp_ns))
        first = self._first(views)
        self._shown = self._shown if first is None else first
        if self._shown is None:
            if any(camera.is_started for camera in self.members):
                raise InputError('The only image of this instant is of a camera that looks away '
                                 'from where the object is to start.')
            raise ArgumentError('The tracker needs a start pose before the first image.')
        seconds = seconds_between(self._stamp_ns, stamp_ns, self.options.frame_rate_hz)
        self._stamp_ns = stamp_ns
        if kalman is not None:
            kalman.predict(seconds, DAMPING if self._misses else 0.0)
        seen = {k: part for k, (camera, view) in enumerate(zip(self.members, views))
                if view is not None and (part := camera.pose_information()) is not None}
        return self._judged(views, seen, stamp_ns)

    # one pose from all

    def _group(self, seen: dict[int, PoseInformation]) -> list[int]:
        """Return the largest group of cameras that agree; of equals the first."""
        best: list[int] = []
        for k in seen:
            place, known = self._joined([seen[k]])
            group = [j for j in seen if j == k or self._square(seen[j], place, known) < CONFLICT]
            if (len(group), sum(seen[j].good for j in group)) > (
                    len(best), sum(seen[j].good for j in best)):
                best = group
        return best

    def _joined(self, parts: Sequence[PoseInformation]) -> tuple[ObjectPose, np.ndarray]:
        """Return the pose and information (6, 6) of some images with the prediction."""
        if self._kalman is None:
            place, known = parts[0].state, np.zeros((6, 6))
        else:
            place, known = self._kalman.state, np.linalg.inv(self._kalman.pose_covariance)
        pull = np.zeros(6)
        for part in parts:
            known = known + part.information
            pull += part.about(place, self._projection.difference)
        return self._projection.moved(place, np.linalg.solve(known, pull)), known

    def _square(self, part: PoseInformation, place: ObjectPose, known: np.ndarray) -> float:
        """Squared difference of what one image says from a pose, in sigmas."""
        pull = part.about(place, self._projection.difference)
        M = part.information
        covariance = M + M @ np.linalg.solve(known, M)
        return float(pull @ np.linalg.pinv(covariance, 1e-9, hermitian=True) @ pull)

    def _judged(self, views: Sequence[TrackedFrame | None], seen: dict[int, PoseInformation],
                stamp_ns: int | None) -> RigFrame:
        """Join what is seen, and say what the state is."""
        doubt, apart = '', np.zeros((6, 6))
        if seen:
            self._compare(seen)
            group = self._group(seen)
            found = self._agreement.found
            if found is not None and len(seen) > 1:
                # no mixture of what contradicts: it would be far from all of them
                out = found.which if len(self.members) > 2 else max(seen)
                group = [k for k in seen if k != out]
            place, known = self._joined([seen[k] for k in group])
            others = [k for k in seen if k not in group and seen[k].good]
            for k in seen:
                self.members[k].is_apart = k in others or found is not None
            doubt, apart = self._told(seen, others, place)
            self._take(place, np.linalg.inv(known))
            if self._kalman is not None and len(self.model.free_turns):
                hold_free(self._kalman, self._free(place),
                          np.sum([seen[k].information for k in group], axis=0))
            self._misses = self._unseen = 0
            good = any(seen[k].good for k in group)
            told = [(f'{self._names[k]}: {view.doubt}', self.members[k].doubted()) for k in group
                    if (view := views[k]) is not None and view.doubt]
            for text, covariance in told:
                doubt, apart = doubt or text, apart + covariance
            self._state = (TrackerState.TRACKING if good and not doubt
                           else TrackerState.DEGRADED)
            reason = doubt if good else 'No camera sees more than a little of the object.'
        else:
            group, others, reason = [], [], self._missed(views)
        self._reason = reason
        for k, (camera, view) in enumerate(zip(self.members, views)):
            if view is not None:
                camera.settle(k in group or k in others)
        return self._frame(views, group, reason, doubt, apart, stamp_ns)

    def _free(self, place: ObjectPose) -> np.ndarray:
        """Corrections (6, k) that the shape leaves open."""
        return free_at(self.model.free_turns, place, self._projection)

    def _take(self, place: ObjectPose, covariance: np.ndarray) -> None:
        """Take over a pose with its covariance (6, 6)."""
        if self._kalman is not None:
            self._kalman.absorb(place, covariance)
            return
        self._kalman = started_filter(self._projection, np.eye(6), 6, self.options,
                                      self.model.diameter_m, place, covariance)
        self._kalman.restart(place, covariance)

    def _missed(self, views: Sequence[TrackedFrame | None]) -> str:
        """No camera sees the object; returns why."""
        alone = [camera for camera, view in zip(self.members, views) if view is None]
        looked = [camera for camera, view in zip(self.members, views) if view is not None]
        if self._kalman is not None and all(camera.is_blind for camera in looked) and any(
                not camera.is_blind for camera in alone) and self._unseen < _UNSEEN:
            # who sees the object has no image of this instant: nothing is new
            self._unseen += 1
            return self._reason
        self._misses += 1
        if self._kalman is not None and self._misses >= self.options.frames_to_lost:
            for camera in self.members:
                camera.search(self._kalman.state)
            self._kalman, self._state = None, TrackerState.LOST
            self._agreement.forget()
        elif self._kalman is not None:
            self._state = TrackerState.DEGRADED
        else:
            begun = any(view is not None and view.state is TrackerState.INITIALISING
                        for view in views)
            if begun or self._state is not TrackerState.INITIALISING:
                self._state = TrackerState.INITIALISING if begun else TrackerState.LOST
            elif not any(camera.confirms for camera in self.members):
                self._state = TrackerState.LOST
        reasons = [f'{name}: {view.reason}' for name, view in zip(self._names, views)
                   if view is not None and view.reason]
        return reasons[0] if reasons else 'No camera sees the object where it was expected.'

    def _compare(self, seen: dict[int, PoseInformation]) -> None:
        """Hold each camera against the others."""
        sure = [k for k in seen if seen[k].good and _determined(seen[k].own)]
        if len(sure) < 2:
            return
        place, _ = self._joined([seen[k] for k in sure])
        difference = self._projection.difference
        pulls = {k: seen[k].about(place, difference) for k in sure}
        # of two the first would only say the same as the second
        for k in sure[len(sure) == 2:]:
            others = [j for j in sure if j != k]
            known = sum(seen[j].information for j in others)
            d = (np.linalg.solve(seen[k].information, pulls[k])
                 - np.linalg.solve(known, sum(pulls[j] for j in others)))
            weight = np.linalg.inv(np.linalg.inv(seen[k].own)
                                   + np.linalg.inv(sum(seen[j].own for j in others)))
            misplaced = seen[k].misplaced + sum(seen[j].misplaced for j in others) / len(others)
            self._agreement.add(k, others, d, weight, misplaced, place.translation)
        self._agreement.judge(float(np.linalg.norm(place.translation)))

    def _told(self, seen: dict[int, PoseInformation], others: list[int], place: ObjectPose,
              ) -> tuple[str, np.ndarray]:
        """Say what contradicts, and return the covariance (6, 6) that counts it."""
        found, covariance = self._agreement.found, np.zeros((6, 6))
        for k in others:
            pull = seen[k].about(place, self._projection.difference)
            M = seen[k].information
            d = np.linalg.solve(M + 1e-9 * np.diag(np.diag(M)), pull)
            covariance += np.outer(d, d)
            if found is None:
                # it may be the size of the model, which one image does not tell from other causes
                apart = np.mean([self.members[j].place for j in seen if j not in others], axis=0)
                apart = apart - self.members[k].place
                size = float(apart @ d[3:]) / max(float(apart @ apart), 1e-12)
                farther = np.r_[np.zeros(3), size * place.translation]
                covariance += np.outer(farther, farther)
        if found is not None:
            covariance += 0.0 if others else np.outer(found.difference, found.difference)
            if found.size is not None:
                farther = np.r_[np.zeros(3), found.size[0] * place.translation]
                covariance += np.outer(farther, farther)
            return found.text(self._names), covariance
        if not others:
            return '', covariance
        turn, shift = np.rad2deg(np.linalg.norm(d[:3])), 1000 * np.linalg.norm(d[3:])
        return (f'The camera {self._names[others[-1]]} sees the object elsewhere than the others, '
                f'by {turn:.2f}° and {shift:.1f} mm.'), covariance

    def _first(self, views: Sequence[TrackedFrame | None]) -> TrackedFrame | None:
        """Return what the first camera with an image tells, in the frame of the rig."""
        return next((camera.in_rig(view) for camera, view in zip(self.members, views)
                     if view is not None), None)

    def _frame(self, views: Sequence[TrackedFrame | None], group: Sequence[int], reason: str,
               doubt: str, apart: np.ndarray, stamp_ns: int | None) -> RigFrame:
        """Put the result into the object's own frame."""
        sees = tuple(k in group for k in range(len(self.members)))
        first = self._first(views)
        if first is None:
            assert self._shown is not None
            first = unseen(self._shown)
        kalman = self._kalman
        if kalman is None:
            tracked = replace(first, state=self._state, reason=reason, doubt='',
                              stamp_ns=stamp_ns)
            return RigFrame(tracked, tuple(views), sees)
        arm = kalman.state.rotation @ self._centre
        carry = recentring(arm)
        covariance = kalman.pose_covariance
        if len(self.model.free_turns):
            covariance = with_any_turn(covariance, self._free(kalman.state))
        pose = carry @ (covariance + apart) @ carry.T
        shares = [view.share_found for k, view in enumerate(views)
                  if view is not None and (k in group or not group)]
        tracked = replace(
            first, state=self._state, reason=reason, doubt=doubt, stamp_ns=stamp_ns,
            rotation=kalman.state.rotation, translation=kalman.state.translation - arm,
            covariance=pose[TURN_LAST], share_found=max(shares, default=0.0))
        return RigFrame(tracked, tuple(views), sees)


def check_rig_options(options: TrackerOptions) -> None:
    """
    Refuse what several cameras cannot do.

    Raises
    ------
    ArgumentError
        If an option is for a single camera.

    """
    for name, value in (('method', 'modern'), ('camera_model', 'perspective'),
                        ('motion', 'general')):
        if getattr(options, name) != value:
            raise ArgumentError(f'Several cameras of one object need {name.replace("_", " ")} '
                                f'{value}, not {getattr(options, name)}.')


def _determined(information: np.ndarray) -> bool:
    """Whether an image determines the whole pose."""
    return is_regular(information, RANK_TOLERANCE)
