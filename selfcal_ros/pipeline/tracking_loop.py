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
"""The loop over a recording: objects are followed through what one camera, or several, saw."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import logging
import time

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.pipeline.frame_source import FrameSource
from selfcal_ros.pipeline.instant import Instant
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.tracking_outcome import TrackingRun
from selfcal_ros.pipeline.tracking_session import TrackingSession
from selfcal_ros.rorapid.estimation.joint_search import together
from selfcal_ros.rorapid.several_cameras.rig_frame import RigFrame
from selfcal_ros.values.wireframe import WireframeModel

_LOGGER = logging.getLogger(__name__)


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


def begin_sessions(sessions: Sequence[TrackingSession], targets: Sequence[Target]) -> None:
    """
    Give each session the start of its target, or let it seek.

    Raises
    ------
    InputError
        If a start pose is wrong.

    """
    for session, target in zip(sessions, targets):
        if target.start is None:
            session.seek()
        else:
            session.start(*target.start, target.distance_sigma_m)


def follow_through(instants: Iterable[Instant], sessions: Sequence[TrackingSession],
                   runs: Sequence[TrackingRun], *, word: str, count: int | None,
                   progress: Progress | None,
                   listeners: Iterable[Callable[[Instant, Sequence[RigFrame]], object]]) -> None:
    """
    Follow objects from instant to instant, and note how it goes.

    Parameters
    ----------
    instants : iterable of Instant
    sessions : sequence of TrackingSession
        One an object, with a start each; of a rig `RigSession`.
    runs : sequence of TrackingRun
        One an object; they are filled in.
    word : str
        What an instant without a name is called: 'Image'.
    count : int or None
        Of all instants.
    progress : callable or None
        Called as progress(text, done, total).
    listeners : iterable of callable
        Each is called as listener(instant, found) with a RigFrame an object.

    """
    listeners = tuple(listeners)
    for instant in instants:
        began = time.perf_counter()
        try:
            found = together([session.looking_at(instant) for session in sessions])
        except InputError as error:
            # what one of them cannot use is of no use to any
            name = instant.first.name or f'{word} {instant.index}'
            note(runs, f'{name} was passed over: {error}')
            continue
        took = time.perf_counter() - began
        for run, now in zip(runs, found):
            # of an image with several objects each has its share
            run.seconds += took / len(runs)
            run.count(instant.index, now.tracked, now.sees)
            _LOGGER.debug('%s %d: %s %s', word, instant.index, now.tracked.state.value,
                          now.tracked.reason)
        for listener in listeners:
            listener(instant, found)
        if progress:
            progress('Tracking', instant.index + 1, count)


def note(runs: Sequence[TrackingRun], remark: str) -> None:
    """Note of all objects what could not be used of the recording."""
    for run in runs:
        run.remarks.append(remark)
    _LOGGER.info(remark)


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
