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
"""From poses of the robot beside a recording to where its camera sits."""

from __future__ import annotations

from dataclasses import dataclass, replace
import logging
from pathlib import Path

import numpy as np

from selfcal_ros.calibration.mount import Mount, MountFacts
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.excerpt import Excerpt
from selfcal_ros.pipeline.feature_session import ExtractedTracks
from selfcal_ros.pipeline.frame_source import FrameSource
from selfcal_ros.pipeline.progress import Progress
from selfcal_ros.pipeline.robot.robot_source import instants_by_name, robot_poses, RobotSource
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.values.angular_rates import AngularRates
from selfcal_ros.values.body_poses import BodyPoses

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class RobotBeside:
    """
    Poses of the robot that were read, and how they belong to the images.

    Attributes
    ----------
    poses : BodyPoses or AngularRates
    facts : MountFacts
        Known parts of the mount.
    instants_ns : dict of int to int, or None
        Of the images by frame, where their file names tell.
    camera_frame : str
        Frame of the images; '' where they name none.

    """

    poses: BodyPoses | AngularRates
    facts: MountFacts
    instants_ns: dict[int, int] | None = None
    camera_frame: str = ''

    def mounted(self, result: Calibration, reading: ExtractedTracks,
                progress: Progress | None = None) -> Calibration:
        """
        Return the calibration with the mount of the camera, or with why there is none.

        Parameters
        ----------
        result : Calibration
        reading : ExtractedTracks
            The tracks that it comes from.
        progress : callable, optional
            Called as progress(text, done, total).

        """
        from selfcal_ros.calibration.mounting.gyro import mount_by_gyro
        from selfcal_ros.calibration.mounting.mounting import mount_camera
        from selfcal_ros.calibration.structure.floor import with_floor
        stamps = self.instants_ns or reading.stamps_ns
        if progress:
            progress('mounting', 0, None)
        if isinstance(self.poses, AngularRates):
            found = mount_by_gyro(result, self.poses, stamps or {})
        else:
            found = mount_camera(result, self.poses,
                                 None if self.poses.frames is not None else stamps, self.facts)
            if reading.tracks is not None:
                found = with_floor(found, reading.tracks)
        if isinstance(found.mount, Mount):
            found = replace(found, mount=replace(found.mount, camera_frame=self.camera_frame))
        _LOGGER.info('mount from %d poses: %s', len(self.poses),
                     'found' if found.mount else found.mount)
        return found


def read_robot(path: str | Path, robot: RobotSource, facts: MountFacts,
               topic: str | None = None, image_size: tuple[int, int] | None = None,
               excerpt: Excerpt = Excerpt()) -> RobotBeside:
    """
    Read the poses of the robot beside a recording, before the long work.

    Parameters
    ----------
    path : str or Path
        The recording.
    robot : RobotSource
    facts : MountFacts
    topic, image_size, excerpt
        Of `selfcal_ros.pipeline.sources.open_source`.

    Raises
    ------
    InputError
        If they cannot be used, or do not overlap the images; the sentence says what to do.

    """
    with open_source(path, topic, image_size, excerpt=excerpt) as images:
        poses = robot_poses(robot, images)
        instants = instants_by_name(images)
        if isinstance(poses, AngularRates):
            if facts.stated:
                raise ArgumentError('--mount-fact needs poses of the robot; a gyro tells its turn '
                                    'against the camera alone.')
            _check_overlap(poses, images, instants)
        elif poses.frames is None:
            _check_overlap(poses, images, instants, facts)
        elif images.kind == 'tracks':
            _check_frames(poses, images.tracks().frames)
        elif images.count is not None and images.excerpt.is_whole:
            _check_frames(poses, np.arange(images.count))
        frame = images.frame_id.lstrip('/')
    return RobotBeside(poses, facts, instants, frame)


def _check_frames(poses: BodyPoses, frames: np.ndarray) -> None:
    """Refuse poses of other frames."""
    known = poses.frames
    if known is not None and len(frames) and not np.isin(frames, known).any():
        raise InputError(f'The poses of the robot are of the frames {known[0]} to {known[-1]}, '
                         f'and the images are {frames.min()} to {frames.max()}: none has both.')


def _check_overlap(poses: BodyPoses | AngularRates, images: FrameSource,
                   instants: dict[int, int] | None, facts: MountFacts = MountFacts()) -> None:
    """Refuse poses of another time, by what is stated of the clocks."""
    known = poses.stamps_ns
    if known is None:
        return
    if facts.time_offset is not None:
        known = known + np.int64(round(1e9 * facts.time_offset[0]))
    end: int | None
    if instants is not None:
        begin, end = min(instants.values()), max(instants.values())
    elif not images.has_own_clock:
        raise InputError(f'The images of {images.path} do not say when they were taken, and the '
                         'poses of the robot are by stamps; give them a column image (file '
                         'names) or frame (0, 1, ...).')
    else:
        begin, end = images.began_ns, images.ended_ns
    if known[-1] < begin:
        how, gap_s = 'end {} s before the images begin', (begin - int(known[-1])) / 1e9
    elif end is not None and known[0] > end:
        how, gap_s = 'begin {} s after the images end', (int(known[0]) - end) / 1e9
    else:
        return
    text = f'{gap_s:.3g}' if gap_s < 1e3 else f'{gap_s:.0f}'
    raise InputError(f'The poses of the robot {how.format(text)} (poses from {known[0]} to '
                     f'{known[-1]} ns, images from {begin} ns on); both need one clock, '
                     'or state --mount-fact time_offset=SECONDS (camera minus robot).')
