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
Images in, poses of a known object out: what `selfcal track` and the node rorapid_tracker drive.

The session checks what comes from outside (cameras, start poses, images, stamps) and says in a
sentence what is wrong with it; the tracker behind it only sees what it can work with.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.instant import Instant
from selfcal_ros.pipeline.stamp_order import stamp_order, StampOrder
from selfcal_ros.rorapid.several_cameras.rig_frame import RigFrame
from selfcal_ros.rorapid.estimation.joint_search import alone, Searching
from selfcal_ros.rorapid.several_cameras.rig_tracker import RigTracker
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackedFrame, TrackerOptions, TrackerState
from selfcal_ros.rorapid.visibility.visible_model import check_size
from selfcal_ros.values.known_object import FARTHEST
from selfcal_ros.values.wireframe import WireframeModel

#: In place of a start pose: the object is sought.
AUTO = 'auto'
#: Smaller images than this hold no object that could be followed.
MINIMUM_SIDE_PX = 16
#: A rotation may miss orthogonality by so much, as numbers in a file do.
ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True)
class TrackingSnapshot:
    """
    State of a session, for diagnostics.

    Attributes
    ----------
    images : int
        Images since the last reset.
    by_state : dict of str to int
        How many of them left the tracker in which state.
    losses : int
        How often the object was lost.
    resets : int
    newest : TrackedFrame or None
    waiting_for : str
        'camera', 'pose', or empty.

    """

    images: int
    by_state: dict[str, int]
    losses: int
    resets: int
    newest: TrackedFrame | None
    waiting_for: str


class TrackingSession:
    """
    Follows one object.

    Parameters
    ----------
    model : WireframeModel
    options : TrackerOptions, optional
    camera : Camera, optional
        Without it nothing is tracked until `set_camera`.
    seed : int
        Of the samples of RANSAC: the same images give the same poses.

    Raises
    ------
    ArgumentError
        If there are too many control points for the model; so do `set_camera` and `set_options`,
        which change nothing then.

    """

    def __init__(self, model: WireframeModel, options: TrackerOptions | None = None,
                 camera: Camera | None = None, seed: int = 0) -> None:
        self.model = model
        self.options = TrackerOptions() if options is None else options
        check_size(model, *self.options.control_points)
        self._seed = seed
        self._camera: Camera | None = None
        # of one camera, or of several (`RigSession`)
        self._tracker: Any = None
        self._start: tuple[np.ndarray, np.ndarray] | None = None
        self._seeking = False
        self._distance_sigma_m: float | None = None
        self._resets = -1
        self.reset(forget_pose=True)
        if camera is not None:
            self.set_camera(camera)

    @property
    def camera(self) -> Camera | None:
        """The camera in use."""
        return self._camera

    @property
    def newest(self) -> TrackedFrame | None:
        """What the last image gave."""
        return self._newest

    def reset(self, forget_pose: bool = False) -> None:
        """Begin again from the start pose; or wait for another one."""
        self._newest: TrackedFrame | None = None
        self._newest_ns: int | None = None
        self._images = 0
        self._losses = 0
        self._by_state: dict[str, int] = {}
        self._resets += 1
        if forget_pose:
            self._start, self._seeking = None, False
        if self._tracker is not None:
            self._tracker.reset()
            self._begin(self._tracker)

    def _begin(self, tracker: RorapidTracker | RigTracker) -> None:
        """Give a tracker the start pose."""
        if self._start is not None:
            tracker.start(*self._start, distance_sigma_m=self._distance_sigma_m)
        elif self._seeking:
            tracker.seek()

    def set_camera(self, camera: Camera) -> bool:
        """
        Take a calibration; the object is followed on, or sought, from where it is.

        What it looks like is learned anew.

        Returns
        -------
        bool
            Whether it differs from the one in use.

        """
        if camera == self._camera:
            return False
        self._take(camera, self.options)
        return True

    def set_options(self, options: TrackerOptions) -> None:
        """Take other settings; the object is followed on, or sought, from where it is."""
        if options == self.options:
            return
        check_size(self.model, *options.control_points)
        if self._tracker is not None and self._camera is not None and \
                not self._tracker.adopt(options):
            self._take(self._camera, options)
        self.options = options

    def _take(self, camera: Camera, options: TrackerOptions) -> None:
        """Make another tracker; where that fails, the old one stays and what belongs to it."""
        tracker = RorapidTracker(self.model, camera, options,
                                 rng=np.random.default_rng(self._seed))
        newest = self._newest
        if newest is not None and {'tracking', 'degraded'} & set(self._by_state):
            # of an object that is lost since it is the last good pose
            tracker.start(newest.rotation, newest.translation, focal_px=newest.focal_px,
                          lost=newest.state is TrackerState.LOST)
        else:
            self._begin(tracker)
        self._tracker, self._camera, self.options = tracker, camera, options

    def start(self, rotation: ArrayLike, translation: ArrayLike,
              distance_sigma_m: float | None = None) -> None:
        """
        Take a guess of the pose of the object in the camera's optical frame.

        Parameters
        ----------
        rotation : array_like, shape (3, 3)
        translation : array_like, shape (3,)
            Metres.
        distance_sigma_m : float, optional
            Standard deviation of the object's distance, where it was measured; with it a model of
            the wrong size is noticed.

        Raises
        ------
        InputError
            If it is no pose, or the object would lie behind the camera or outside the image.

        """
        rotation, translation = checked_pose(rotation, translation)
        self._check_start(self.model.extent @ rotation.T + translation)
        self._start, self._distance_sigma_m = (rotation, translation), distance_sigma_m
        self._seeking = False
        self.reset()

    def _check_start(self, points: np.ndarray) -> None:
        """Refuse a start that puts the points (N, 3) of the object out of sight."""
        check_in_image(self._camera, points)

    def seek(self) -> None:
        """
        Begin without a pose; see `RorapidTracker.seek`.

        Raises
        ------
        ArgumentError
            If the method cannot.

        """
        if self.options.method != 'modern' or self.options.camera_model != 'perspective':
            raise ArgumentError(f'--init {AUTO} needs --method modern and --camera-model '
                                'perspective.')
        self._start, self._seeking = None, True
        self.reset()

    @property
    def wants_colour(self) -> bool:
        """Whether colours help: an outline stands out in the grey that they choose."""
        return self.model.is_outlined

    def add(self, image: np.ndarray, stamp_ns: int | None = None,
            depth: np.ndarray | None = None) -> TrackedFrame:
        """
        Find the object in the next image.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W) or (H, W, 3)
        stamp_ns : int, optional
            Acquisition time. When time jumps back (a bag that is played again), the session
            begins again from the start pose.
        depth : ndarray, shape (H, W), optional
            Metres along the optical axis, registered to the image; 0 or NaN where there is none.

        Returns
        -------
        TrackedFrame

        Raises
        ------
        InputError
            If the image cannot be used: there is no camera or start pose yet, its size is not the
            camera's, or it is older than the one before.

        """
        return alone(self.finding(image, stamp_ns, depth))

    def finding(self, image: np.ndarray, stamp_ns: int | None = None,
                depth: np.ndarray | None = None) -> Searching[TrackedFrame]:
        """
        Find the object in the next image beside others; see `add`.

        What is wrong with the input is raised at once, and nothing has changed then. The object
        is found by `together`, which searches the edges of several at once.

        Returns
        -------
        Searching
            It comes to a TrackedFrame.

        """
        if self._tracker is None or self._camera is None:
            raise InputError('There is no calibration of the camera yet; the tracker needs one.')
        if self._start is None and not self._seeking:
            raise InputError('There is no start pose yet; say roughly where the object is.')
        check_image(image, self._camera)
        stamp_ns = self._checked_stamp(stamp_ns)
        if depth is not None and depth.shape != image.shape[:2]:
            raise InputError(f'The depth image is {depth.shape[1]}x{depth.shape[0]}, the image '
                             f'{image.shape[1]}x{image.shape[0]} pixels; give depths that are '
                             'registered to it.')
        return self._finding(image, stamp_ns, depth)

    def _finding(self, image: np.ndarray, stamp_ns: int | None, depth: np.ndarray | None,
                 ) -> Searching[TrackedFrame]:
        frame: TrackedFrame = yield from self._tracker.tracking(image, stamp_ns, depth)
        self._count(frame)
        return frame

    def looking_at(self, instant: Instant) -> Searching[RigFrame]:
        """Find the object at an instant of a recording; see `finding`."""
        frame = instant.first
        bgr = frame.bgr if self.wants_colour else None
        tracked = yield from self.finding(frame.image if bgr is None else bgr, instant.stamp_ns,
                                          instant.depth)
        return RigFrame(tracked, (tracked,), (bool(tracked),))

    def _count(self, frame: TrackedFrame) -> None:
        """Note how an image went."""
        self._images += 1
        self._by_state[frame.state.value] = self._by_state.get(frame.state.value, 0) + 1
        before = self._newest.state if self._newest is not None else None
        if frame.state is TrackerState.LOST and before is not TrackerState.LOST:
            self._losses += 1
        self._newest = frame

    def snapshot(self) -> TrackingSnapshot:
        """Return the state for diagnostics."""
        waiting = ('camera' if self._tracker is None else
                   'pose' if self._start is None and not self._seeking else '')
        return TrackingSnapshot(self._images, dict(self._by_state), self._losses, self._resets,
                                self._newest, waiting)

    def _checked_stamp(self, stamp_ns: int | None) -> int | None:
        """Return the stamp as the tracker takes it; begin anew where time jumps back."""
        if stamp_ns is None:
            return None
        newest = self._newest_ns
        order = stamp_order(stamp_ns, newest)
        if order is StampOrder.OVERTAKEN:
            raise InputError(f'The image is {((newest or 0) - stamp_ns) * 1e-6:.1f} ms older than '
                             'the one before it; images must come in order.')
        if order is StampOrder.JUMPED_BACK:
            self.reset()
            newest = None
        self._newest_ns = stamp_ns
        # a driver without a clock stamps all images alike
        return None if stamp_ns == newest else stamp_ns


def check_image(image: np.ndarray, camera: Camera) -> None:
    """Refuse what is no image of this camera."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (
            image.ndim == 3 and image.shape[2] != 3):
        raise InputError(f'An array of shape {image.shape} and type {image.dtype} is no image '
                         'that can be tracked in; give 8 bits, grey or bgr.')
    height, width = image.shape[:2]
    if camera.width and camera.height and (width, height) != (camera.width, camera.height):
        raise InputError(f'The image is {width}x{height}, the calibration for '
                         f'{camera.width}x{camera.height} pixels; use the calibration of '
                         'this image size.')
    if min(height, width) < MINIMUM_SIDE_PX:
        raise InputError(f'The image is {width}x{height} pixels, too small to track in; '
                         f'{MINIMUM_SIDE_PX} a side are needed.')


def checked_pose(rotation: ArrayLike, translation: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a pose as arrays, its rotation made exactly orthogonal.

    Raises
    ------
    InputError
        If a number is not finite, the object is out of reach or the matrix is no rotation.

    """
    rotation = np.asarray(rotation, float)
    translation = np.asarray(translation, float).ravel()
    if rotation.shape != (3, 3) or translation.shape != (3,) or not (
            np.isfinite(rotation).all() and np.isfinite(translation).all()):
        raise InputError('The start pose must be finite numbers: three metres and a rotation.')
    if np.abs(translation).max() >= FARTHEST:
        raise InputError(f'The start pose is {np.abs(translation).max():.3g} m away; check its '
                         'unit (metres) and its order (translation first).')
    U, _, V = np.linalg.svd(rotation)
    nearest = U @ V
    if np.abs(nearest - rotation).max() > ROTATION_TOLERANCE or np.linalg.det(nearest) < 0:
        raise InputError('The start pose has no rotation matrix; check what gives it.')
    return nearest, translation


def check_in_image(camera: Camera | None, points: np.ndarray) -> None:
    """
    Refuse a pose at which nothing of the object is in the image.

    Parameters
    ----------
    camera : Camera or None
        None: only what is behind any camera is refused.
    points : ndarray, shape (N, 3)
        Of the object, in the frame of the camera.

    Raises
    ------
    InputError

    """
    if not points[:, 2].max() > 0:
        raise InputError('The start pose puts the object behind the camera; its z (the third '
                         'number, metres along the optical axis) must be positive.')
    if camera is None or not (camera.width and camera.height):
        return
    ahead = points[points[:, 2] > 1e-6]
    low, high = ahead_box(camera, ahead)
    size = np.array([camera.width, camera.height])
    if (high < 0).any() or (low > size - 1).any():
        centre = np.rint(0.5 * (low + high)).astype(int)
        raise InputError('The start pose puts the object outside the image, at pixel '
                         f'({centre[0]}, {centre[1]}) of {camera.width}x{camera.height}; check '
                         'its unit (metres), its frame (optical: x right, y down, z forward) and '
                         'the calibration.')


def ahead_box(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Bound the image of points (N, 3) that lie ahead: two corners (2,) in pixels.

    Without distortion, whose polynomial means nothing far outside the image.
    """
    xy = np.clip(points[:, :2] / points[:, 2:], -1e6, 1e6)
    pixels = xy @ camera.K[:2, :2].T + camera.K[:2, 2]
    return pixels.min(axis=0), pixels.max(axis=0)
