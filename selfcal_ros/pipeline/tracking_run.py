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
"""Track objects through a whole recording: listeners get each frame, the caller a summary."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import os
from pathlib import Path
import re

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.pipeline.depth_topic import DepthTopic
from selfcal_ros.pipeline.frame_source import Frame, FrameSource
from selfcal_ros.pipeline.instant import Instant
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.tracking_loop import (
    begin_sessions, check_source, follow_through, note, Target)
from selfcal_ros.pipeline.tracking_outcome import TrackingRun
from selfcal_ros.pipeline.tracking_session import AUTO, TrackingSession
from selfcal_ros.rorapid.estimation.initial_pose import pose_from_clicks, read_init, read_pose_file
from selfcal_ros.rorapid.several_cameras.rig_frame import RigFrame
from selfcal_ros.rorapid.tracked_frame import TrackedFrame
from selfcal_ros.rorapid.tracker import TrackerOptions

#: Clicks may miss a pose by so much of the image diagonal; beyond it they are in another order.
CLICK_ERROR_FRACTION = 0.03
#: Images without a clock are shown so many a second.
RATE_HZ = 30.0


def read_start(init: str | None, clicks: Sequence[float] | None, camera: Camera,
               ) -> tuple[np.ndarray, np.ndarray]:
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
    numbers: list[float] | None
    try:
        numbers = [float(word) for word in init.replace(',', ' ').split()]
    except ValueError:
        # several words of which the first begins a number are no name, unless there is such a file
        meant = re.match(r'\s*[-+.]*\d\S*\s+\S', init) and not os.path.exists(init)
        numbers = [] if meant else None
    if numbers is not None:
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise ArgumentError('--init takes six finite numbers "tx ty tz rx ry rz" (metres, '
                                f'radians), not {init!r:.80}.')
    path = Path(init)
    is_pose = numbers is not None or path.suffix.lower() != '.init'
    if is_pose and clicks is not None:
        raise ArgumentError('--clicks are of the points of a .init file, but --init gives a pose; '
                            'leave one of them out.')
    if numbers is not None:
        return rotation_matrix(np.array(numbers[3:])), np.array(numbers[:3])
    if is_pose:
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


def track_objects(source: FrameSource, targets: Sequence[Target], camera: Camera,
                  options: TrackerOptions | None = None, *, seed: int = 0,
                  progress: Progress | None = None,
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
    runs = [TrackingRun(description=source.description, size_m=(
        () if target.distance_sigma_m else tuple(np.ptp(target.model.extent, axis=0).tolist())))
        for target in targets]
    sessions = [TrackingSession(target.model, options, camera, seed) for target in targets]
    begin_sessions(sessions, targets)
    check_source(source, camera)
    # images of a folder have no clock of their own
    timed = source.clock != 'nominal'

    def depth_of(frame: Frame) -> np.ndarray | None:
        try:
            return None if depths is None else depths.at(frame.stamp_ns)
        except InputError as error:
            note(runs, f'{frame.name or f"Image {frame.index}"} was tracked without its depth '
                 f'image: {error}')
            return None

    instants = (Instant(frame.index, (frame,), frame.stamp_ns if timed else None, depth_of(frame))
                for frame in source)

    def of_frame(listener: Callable[[Frame, tuple[TrackedFrame, ...]], object],
                 ) -> Callable[[Instant, Sequence[RigFrame]], object]:
        return lambda instant, found: listener(instant.first, tuple(
            one.tracked for one in found))

    follow_through(instants, sessions, runs, word='Image', count=source.count, progress=progress,
                   listeners=map(of_frame, listeners))
    return runs


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
