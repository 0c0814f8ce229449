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
"""A whole recording through the tracker, for whoever listens, and how it went."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
import logging
import math
from pathlib import Path
import time

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.pipeline.depth_topic import DepthTopic
from selfcal_ros.pipeline.frame_source import Frame, FrameSource
from selfcal_ros.pipeline.tracking_session import AUTO, TrackingSession
from selfcal_ros.rorapid.estimation.initial_pose import pose_from_clicks, read_init, read_pose_file
from selfcal_ros.rorapid.tracked_frame import TrackedFrame, TrackerState
from selfcal_ros.rorapid.tracker import TrackerOptions
from selfcal_ros.values.wireframe import WireframeModel

_LOGGER = logging.getLogger(__name__)
#: Clicks may miss a pose by so much of the image diagonal; beyond it they are in another order.
CLICK_ERROR_FRACTION = 0.03
#: Images without a clock are shown so many a second.
RATE_HZ = 30.0
#: Of several remarks of one kind, so many are told.
MAX_REMARKS = 3


@dataclass
class TrackingRun:
    """
    What a recording gave.

    Attributes
    ----------
    images : int
    by_state : dict of str to int
    stretches : list of (int, int, str)
        Where the object was lost: first image, last image, reason.
    doubts : list of (int, str)
        What seemed wrong with the model, the camera or the start, and from which image on.
    remarks : list of str
        Images that were passed over, and why.
    squares, edgels : float, int
        Squared distances (px²) of the edgels that support the poses, over all images.
    seconds : float
        Time of the tracker alone.
    last_state : str
    description : str
    distance_stated : bool
        Something else than the size of the model tells distances.
    cameras : dict of str to int
        Of several cameras: in how many images each saw the object.

    """

    images: int = 0
    by_state: dict = field(default_factory=dict)
    stretches: list = field(default_factory=list)
    doubts: list = field(default_factory=list)
    remarks: list = field(default_factory=list)
    squares: float = 0.0
    edgels: int = 0
    seconds: float = 0.0
    last_state: str = ''
    description: str = ''
    distance_stated: bool = False
    cameras: dict = field(default_factory=dict)

    @property
    def rms_px(self) -> float:
        """Of the edgels that support the poses, pixels."""
        return math.sqrt(self.squares / self.edgels) if self.edgels else math.nan

    @property
    def followed(self) -> bool:
        """Whether the object was still followed at the end."""
        return self.last_state in ('tracking', 'degraded')

    def text(self) -> str:
        """Return the outcome for a person."""
        if not self.images:
            lines = ['Not tracked: none of the images could be used.']
        else:
            seen = sum(self.by_state.get(state, 0) for state in ('tracking', 'degraded'))
            head = (f'Tracked in {seen} of {self.images} images' if self.followed else
                    f'Lost at the end, after {seen} of {self.images} images were tracked')
            states = ', '.join(f'{count} {state}' for state, count in self.by_state.items())
            lines = [f'{head} ({states}).']
            if math.isfinite(self.rms_px):
                lines.append(f'Edges lie {self.rms_px:.2f} px rms from the model; '
                             f'{1000 * self.seconds / self.images:.2f} ms an image.')
            if seen and not self.distance_stated:
                lines.append('Distances are as true as the size of the model: one camera cannot '
                             'tell a larger object farther away.')
        if self.cameras and self.images:
            seen_by = ', '.join(f'{name} in {count}' for name, count in self.cameras.items())
            lines.append(f'The object was seen by {seen_by}.')
        lines += [f'Lost from image {first} to {last}: {reason}'
                  for first, last, reason in self.stretches[:MAX_REMARKS]]
        if len(self.stretches) > MAX_REMARKS:
            lines.append(f'... and {len(self.stretches) - MAX_REMARKS} times more.')
        lines += [f'From image {first}: {doubt}' for first, doubt in self.doubts[:MAX_REMARKS]]
        lines += self.remarks[:MAX_REMARKS]
        if len(self.remarks) > MAX_REMARKS:
            lines.append(f'... and {len(self.remarks) - MAX_REMARKS} more images passed over.')
        return '\n'.join(lines)


def read_start(init: str | None, clicks, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """
    Read where the object is at first.

    Parameters
    ----------
    init : str or None
        Six numbers, or the name of a .pos or .init file.
    clicks : sequence of float or None
        u, v of each point of the .init file.
    camera : Camera

    Returns
    -------
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)

    Raises
    ------
    InputError, ArgumentError
        If something is missing or wrong; the sentence says what.

    """
    if not init:
        raise ArgumentError('Say where the object is in the first image: --init '
                            '"tx ty tz rx ry rz", or --init FILE.init with --clicks; or have it '
                            f'sought: --init {AUTO}.')
    try:
        numbers = [float(word) for word in init.replace(',', ' ').split()]
    except ValueError:
        numbers = None
    if numbers is not None:
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise ArgumentError('--init takes six finite numbers "tx ty tz rx ry rz" (metres, '
                                f'radians), not {init!r:.80}.')
        return rotation_matrix(np.array(numbers[3:])), np.array(numbers[:3])
    path = Path(init)
    if path.suffix.lower() != '.init':
        return read_pose_file(path)
    points = read_init(path)
    if clicks is None:
        raise ArgumentError(f'{path} names {len(points)} points of the object; say with --clicks '
                            f'where they are in the first image ({2 * len(points)} numbers).')
    if len(clicks) != 2 * len(points):
        raise ArgumentError(f'{path} names {len(points)} points of the object, so --clicks takes '
                            f'{2 * len(points)} numbers, not {len(clicks)}.')
    rotation, translation, rms_px = pose_from_clicks(points, np.reshape(clicks, (-1, 2)), camera)
    limit = CLICK_ERROR_FRACTION * (np.hypot(camera.width, camera.height) or 1000.0)
    if rms_px > limit:
        raise InputError(f'No pose fits the clicks: {rms_px:.0f} px remain. Check that they are '
                         f'in the order of {path.name}, and that the calibration is of this '
                         'camera.')
    return rotation, translation


@dataclass(frozen=True)
class Target:
    """
    One object that is to be followed.

    Attributes
    ----------
    model : WireframeModel
    start : (ndarray (3, 3), ndarray (3,)) or None
        Pose of the object in the first image, roughly. None: it is sought.
    distance_sigma_m : float or None
        Of the start, where its distance was measured.

    """

    model: WireframeModel
    start: tuple[np.ndarray, np.ndarray] | None
    distance_sigma_m: float | None = None


def track_objects(source: FrameSource, targets: Sequence[Target], camera: Camera,
                  options: TrackerOptions | None = None, *, seed: int = 0,
                  progress: Callable | None = None,
                  listeners: Iterable[Callable[[Frame, tuple[TrackedFrame, ...]], object]] = (),
                  depths: DepthTopic | None = None) -> list[TrackingRun]:
    """
    Follow objects through a recording, one or several.

    Parameters
    ----------
    source : FrameSource
        As `open_source` opens it.
    targets : sequence of Target
    camera : Camera
    options : TrackerOptions, optional
    seed : int
    progress : callable, optional
        Called as progress(text, done, total).
    listeners : iterable of callable
        Each is called as listener(frame, tracked) after every image that was tracked, with one
        TrackedFrame an object.
    depths : DepthTopic, optional
        Of a bag.

    Returns
    -------
    list of TrackingRun
        Of each object.

    Raises
    ------
    InputError
        If the input, a start pose or the size of the images is wrong.

    """
    runs = [TrackingRun(description=source.description, distance_stated=bool(
        target.distance_sigma_m)) for target in targets]
    sessions = [TrackingSession(target.model, options, camera, seed) for target in targets]
    for session, target in zip(sessions, targets):
        if target.start is None:
            session.seek()
        else:
            session.start(*target.start, target.distance_sigma_m)
    check_source(source, camera)
    listeners = tuple(listeners)
    # images of a folder have no clock of their own
    timed = source.clock != 'nominal'
    for frame in source:
        stamp_ns = frame.stamp_ns if timed else None
        depth = None if depths is None else depths.at(frame.stamp_ns)
        found = []
        try:
            for run, session in zip(runs, sessions):
                began = time.perf_counter()
                bgr = frame.bgr if session.wants_colour else None
                found.append(session.add(frame.image if bgr is None else bgr, stamp_ns, depth))
                run.seconds += time.perf_counter() - began
        except InputError as error:
            # an image that one of them cannot use is of no use to any
            remark = f'{frame.name or f"Image {frame.index}"} was passed over: {error}'
            for run in runs:
                run.remarks.append(remark)
            _LOGGER.info(remark)
            continue
        for run, tracked in zip(runs, found):
            count_image(run, frame.index, tracked)
            _LOGGER.debug('image %d: %s %s', frame.index, tracked.state.value, tracked.reason)
        for listener in listeners:
            listener(frame, tuple(found))
        if progress:
            progress('Tracking', frame.index + 1, source.count)
    return runs


def check_source(source: FrameSource, camera: Camera) -> None:
    """
    Refuse what is wrong before the first image: no images, or a calibration of another size.

    Raises
    ------
    InputError

    """
    if source.kind == 'tracks':
        raise InputError(f'{source.path} holds tracks, not images; the tracker needs images.')
    if source.image_size and camera.width and source.image_size != (camera.width, camera.height):
        raise InputError(f'The images are {source.image_size[0]}x{source.image_size[1]}, the '
                         f'calibration is for {camera.width}x{camera.height} pixels; use the '
                         'calibration of this image size.')


def playing_rate_hz(source: FrameSource) -> float:
    """Return at how many images a second a source is shown: `RATE_HZ` where it has no clock."""
    if source.clock in ('none', 'nominal'):
        return RATE_HZ
    stamps: list[int] = []
    for frame in source:
        stamps.append(frame.stamp_ns)
        if len(stamps) == 3:
            break
    steps = np.diff(stamps)
    return float(1e9 / steps.min()) if len(steps) and steps.min() > 0 else RATE_HZ


def count_image(run: TrackingRun, index: int, tracked: TrackedFrame) -> None:
    """Note how an image went."""
    run.images += 1
    run.squares += float(np.sum(tracked.edge_px[tracked.found]**2))
    run.edgels += int(np.count_nonzero(tracked.found))
    run.last_state = tracked.state.value
    run.by_state[run.last_state] = run.by_state.get(run.last_state, 0) + 1
    if tracked.doubt:
        # the amount is known better and better: the newest sentence of each kind stands
        kind = tracked.doubt.partition(' seems ')[0]
        if run.doubts and run.doubts[-1][1].startswith(kind):
            run.doubts[-1] = run.doubts[-1][0], tracked.doubt
        else:
            run.doubts.append((index, tracked.doubt))
    if tracked.state is TrackerState.LOST:
        if run.stretches and run.stretches[-1][1] == index - 1:
            run.stretches[-1] = (run.stretches[-1][0], index, run.stretches[-1][2])
        else:
            run.stretches.append((index, index, tracked.reason))
