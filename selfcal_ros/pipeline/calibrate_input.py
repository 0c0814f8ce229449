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
"""From an input that a user names to its calibration, with or without a known object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
import logging
from pathlib import Path
import sys
import time
from typing import Any, TYPE_CHECKING

import numpy as np

from selfcal_ros.calibration.mount import MountFacts
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.errors import InputError
from selfcal_ros.features.freed_memory import return_freed_memory
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.pipeline.excerpt import Excerpt
from selfcal_ros.pipeline.feature_session import ExtractedTracks
from selfcal_ros.pipeline.long_policy import LongRecordings
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.robot.robot_source import RobotSource

if TYPE_CHECKING:
    from selfcal_ros.pipeline.frame_source import FrameSource

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class CalibrationSettings:
    """
    How to calibrate an input; values as on the command line, so that processes can share them.

    Attributes
    ----------
    facts : CameraFacts
    motion : str
        See `selfcal_ros.calibrate`.
    translation_frames, parallel_objects : tuple of int, optional
    views : int, optional
    known_object : str, optional
        See `selfcal_ros.features.targets.parse_target`; the motion does not matter then.
    flatness : float, optional
        Of a board; see `calibrate_known_object`.
    mode : {'auto', 'video', 'wide'}
    topic : str, optional
        Image topic of a bag.
    max_keyframes : int, optional
    image_size : (int, int), optional
        Width and height in pixels, for tracks from a table.
    mask : str, optional
        Image file that is white where the images may be used.
    excerpt : Excerpt
        The part of the recording that is used.
    seed : int
        What is drawn at random is drawn from it: the same one gives the same result.
    long : LongRecordings, optional
        When a recording is long, and followed in parts; None: never.
    robot : RobotSource, optional
        Where the poses of the robot are, to find where the camera sits on it.
    mount_facts : MountFacts
        Known parts of that.

    """

    facts: CameraFacts = field(default_factory=CameraFacts)
    motion: str = 'auto'
    translation_frames: tuple[int, ...] | None = None
    views: int | None = None
    known_object: str | None = None
    flatness: float | None = None
    mode: str = 'auto'
    topic: str | None = None
    max_keyframes: int | None = None
    image_size: tuple[int, int] | None = None
    mask: str | None = None
    excerpt: Excerpt = field(default_factory=Excerpt)
    seed: int = 0
    long: LongRecordings | None = field(default_factory=LongRecordings)
    robot: RobotSource | None = None
    mount_facts: MountFacts = field(default_factory=MountFacts)
    parallel_objects: tuple[int, ...] | None = None


def calibrate_input(path: str | Path, settings: CalibrationSettings,
                    progress: Progress | None = None,
                    ) -> tuple[Calibration | NotCalibrated, ExtractedTracks]:
    """
    Read an input of any kind that `open_source` knows, and calibrate from it.

    Parameters
    ----------
    path : str or Path
    settings : CalibrationSettings
    progress : callable, optional
        Called as progress(text, done, total); total is None where it is not known.

    Returns
    -------
    Calibration or NotCalibrated
    ExtractedTracks
        The tracks that it comes from.

    Raises
    ------
    InputError, ArgumentError
        If the input cannot be used; the sentence says what to do.

    """
    odd = _check_facts(path, settings)
    if settings.robot is None:
        result, reading = _calibrated(path, settings, progress)
        return result, replace(reading, findings=(*odd, *reading.findings))
    from selfcal_ros.pipeline.robot.robot_mount import read_robot
    robot = read_robot(path, settings.robot, settings.mount_facts, topic=settings.topic,
                       image_size=settings.image_size, excerpt=settings.excerpt)
    result, reading = _calibrated(path, settings, progress)
    reading = replace(reading, findings=(*odd, *reading.findings))
    return robot.mounted(result, reading, progress) if result else result, reading


def _check_facts(path: str | Path, settings: CalibrationSettings) -> tuple[Finding, ...]:
    """Refuse facts and frames that these images cannot have; tell of odd ones."""
    facts, named = settings.facts, settings.translation_frames
    if (facts.principal_point is None and not facts.skew and facts.line_delay_s is None
            and named is None):
        return ()
    from selfcal_ros.pipeline.sources import open_source
    with open_source(path, settings.topic, settings.image_size) as source:
        size = source.image_size
        if size is not None:
            facts.check_for(size)
        # of a video the number is an estimate
        if named is not None and source.kind in ('bag', 'images') and source.count:
            beyond = [one for one in named if not 0 <= one < source.count]
            if beyond:
                raise InputError(f'{path} has no image {beyond[0]}: its {source.count} images '
                                 'are counted from 0.')
    point = facts.principal_point
    if point is None or size is None or all(0 <= u < most for u, most in zip(point, size)):
        return ()
    return Finding('stated_centre_outside', cx=point[0], cy=point[1], width=size[0],
                   height=size[1]),


def _calibrated(path: str | Path, settings: CalibrationSettings, progress: Progress | None,
                ) -> tuple[Calibration | NotCalibrated, ExtractedTracks]:
    """Calibrate from the images alone; see `calibrate_input`."""
    shared: dict[str, Any] = {
        'topic': settings.topic, 'max_keyframes': settings.max_keyframes,
        'image_size': settings.image_size, 'progress': progress, 'excerpt': settings.excerpt}
    named = settings.translation_frames or settings.motion == 'repeated'
    if named and Path(path).suffix.lower() == '.csv' and settings.max_keyframes is None:
        # frames that are named, or are objects, are all used
        shared['max_keyframes'] = sys.maxsize
    # OpenCV and SciPy load here, not where the command line starts
    if settings.mask is not None:
        from selfcal_ros.features.mask import read_mask
        shared['mask'] = read_mask(settings.mask)
    from selfcal_ros.pipeline.sources import open_source
    if settings.known_object:
        from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
        from selfcal_ros.features.targets import parse_target
        from selfcal_ros.pipeline.object_session import read_object_views
        target = parse_target(settings.known_object)
        with open_source(path, settings.topic, settings.image_size, excerpt=settings.excerpt,
                         ) as source:
            _refuse_what_no_camera_sees(source)
        reading = read_object_views(path, target, **shared)
        _tell(progress)
        return _timed(lambda: calibrate_known_object(
            reading.tracks, target.known, facts=settings.facts, flatness=settings.flatness),
            reading), reading
    from selfcal_ros.calibration.calibrate import calibrate
    from selfcal_ros.pipeline.feature_session import generator, tracks_of
    if settings.motion == 'repeated' and Path(path).suffix.lower() != '.csv':
        raise InputError(f'{path} is no table of tracks: for equal objects give tracks.csv, '
                         'where frame numbers the object, and track the point on it.')
    mask = shared.get('mask')
    return_freed_memory()
    with open_source(path, settings.topic, settings.image_size, excerpt=settings.excerpt,
                     ) as source:
        source.leaves_out_damaged = source.deinterlaces = True
        _refuse_what_no_camera_sees(source)
        if settings.long is not None and settings.long.concern(source, settings):
            from selfcal_ros.pipeline.long_recording import calibrate_long
            found = calibrate_long(source, settings, settings.long, mask, progress)
            if found is not None:
                return found
        reading = tracks_of(source, settings.mode, shared['max_keyframes'], progress, mask,
                            settings.seed)
    _tell(progress)
    return _timed(lambda: calibrate(
        reading.tracks, motion=settings.motion, facts=settings.facts,
        translation_frames=settings.translation_frames, views=settings.views,
        parallel_objects=settings.parallel_objects,
        rng=generator(settings.seed)), reading), reading


def _refuse_what_no_camera_sees(source: FrameSource) -> None:
    """Refuse panoramas, and images that hold two views unless one half of them is asked for."""
    if source.kind == 'tracks':
        return
    from selfcal_ros.features.panorama import are_panoramas
    from selfcal_ros.features.two_views import IMAGES_APART, IMAGES_ASKED, two_views
    begin, apart = next(iter(source)), IMAGES_APART * source.excerpt.every
    images = [begin.image, *(frame.image for frame in source.only(
        begin.index + apart * number for number in range(1, IMAGES_ASKED)))]
    if are_panoramas(images):
        raise InputError(f'The images of {source.path} are panoramas, whose left and right edges '
                         'meet, and no camera matrix describes them; give the images of the '
                         'lenses, or views cut out of the panorama.')
    halves = two_views(images) if source.excerpt.half is None else None
    if halves:
        first, _, second = halves.split()
        raise InputError(f'Each image of {source.path} holds two views of one scene, {halves}, as '
                         f'of a stereo camera: calibrate both with --cameras {first},{second}, or '
                         f'one with --half {first}.')


def _tell(progress: Progress | None) -> None:
    """Tell that the estimate begins, which cannot know how far it is."""
    # the images are gone
    return_freed_memory()
    if progress:
        progress('estimating', 0, None)


def _timed(estimate: Callable[[], Calibration | NotCalibrated],
           reading: ExtractedTracks) -> Calibration | NotCalibrated:
    """Estimate, and log from what and how long it took."""
    tracks = reading.tracks
    _LOGGER.info('%s: %d observations of %d points in %d images', reading.description,
                 len(tracks), len(np.unique(tracks.track)), len(tracks.frames))
    began = time.perf_counter()
    result = estimate()
    _LOGGER.info('%s, after %.2f s', f'calibrated by {result.motion} motion' if result
                 else 'not calibrated', time.perf_counter() - began)
    return result
