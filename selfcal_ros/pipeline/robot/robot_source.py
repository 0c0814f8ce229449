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
"""What a user may name for the poses of the robot, and the poses that it stands for."""

from __future__ import annotations

from dataclasses import dataclass, field
import os
from pathlib import Path
import re
from typing import TYPE_CHECKING

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.robot.pose_checks import PoseReading
from selfcal_ros.values.angular_rates import AngularRates
from selfcal_ros.values.body_poses import BodyPoses

if TYPE_CHECKING:
    from selfcal_ros.pipeline.frame_source import FrameSource

#: Names of images that are their instants: nanoseconds, microseconds, or seconds with a point.
_INSTANT = re.compile(r'^(?:(\d{16,20})|(\d{9,11})[._](\d{1,9}))$')
#: Who leaves TF's frames out is told this.
_TF_FORM = '/tf:FIXED:BODY, such as /tf:odom:base_link'


@dataclass(frozen=True)
class RobotSource:
    """
    Where the poses of the robot are.

    Parameters
    ----------
    table : Path or None
        A CSV file.
    topic : str
        Of the bag that holds the images.
    frames : (str, str) or None
        The fixed frame and that of the body, for transforms.
    reading : PoseReading

    """

    table: Path | None = None
    topic: str = ''
    frames: tuple[str, str] | None = None
    reading: PoseReading = field(default_factory=PoseReading)

    @staticmethod
    def parse(text: str, reading: PoseReading = PoseReading()) -> RobotSource:
        """
        Read `poses.csv`, `/odom`, `/some/pose_topic` or `/tf:FIXED:BODY`.

        Raises
        ------
        ArgumentError
            If it is none of these.

        """
        if text.lower().endswith('.csv'):
            return RobotSource(table=Path(text), reading=reading)
        head, *frames = text.split(':')
        if head in ('/tf', 'tf'):
            if len(frames) != 2 or not all(frames):
                raise ArgumentError(f'TF needs the names of two frames: {_TF_FORM}; got {text}.')
            world, body = (name.lstrip('/') for name in frames)
            if world == body:
                raise ArgumentError(f'The frame {world} does not move in itself; name two: '
                                    f'{_TF_FORM}.')
            return RobotSource(topic='/tf', frames=(world, body), reading=reading)
        if frames or not text.strip() or os.path.isfile(text):
            raise ArgumentError(f'--robot takes poses.csv, a topic of the bag such as /odom, or '
                                f'{_TF_FORM}; got {text!r:.60}.')
        return RobotSource(topic=text, reading=reading)

    def __str__(self) -> str:
        """Name it as a user does."""
        if self.table is not None:
            return str(self.table)
        return ':'.join((self.topic, *(self.frames or ())))


def robot_poses(robot: RobotSource, images: FrameSource) -> BodyPoses | AngularRates:
    """
    Read the poses of the robot that belong to a recording, or what its gyro measured.

    Parameters
    ----------
    robot : RobotSource
    images : FrameSource
        The recording, open.

    Raises
    ------
    InputError
        If they cannot be used; the sentence says what to do.

    """
    if robot.table is not None:
        from selfcal_ros.pipeline.robot.pose_table import read_pose_table
        names = getattr(images, 'names', None)
        poses: BodyPoses | AngularRates = read_pose_table(robot.table, names,
                                                          by_stamp=has_clock(images))
    elif images.kind != 'bag':
        raise InputError(f'{images.path} is no bag, so it has no topic {robot.topic}; give '
                         '--robot a table of poses, poses.csv.')
    elif robot.frames is not None:
        from selfcal_ros.pipeline.robot.pose_topics import read_transforms
        poses = read_transforms(images.path, *robot.frames)
    else:
        from selfcal_ros.pipeline.robot.pose_topics import read_pose_topic
        from selfcal_ros.pipeline.robot.rate_topics import read_rate_topic
        rates = read_rate_topic(images.path, robot.topic)
        poses = read_pose_topic(images.path, robot.topic) if rates is None else rates
    if isinstance(poses, AngularRates):
        return robot.reading.named(poses)
    return robot.reading.applied(poses, str(robot))


def has_clock(images: FrameSource) -> bool:
    """Tell whether the images of a recording say when they were taken."""
    return images.has_own_clock or instants_by_name(images) is not None


def instants_by_name(images: FrameSource) -> dict[int, int] | None:
    """Return the instants of images (ns) whose file names are instants, by frame."""
    names = getattr(images, 'names', None)
    found = [_INSTANT.match(Path(name).stem) for name in names or ()]
    if not found or not all(found):
        return None
    return {k: _instant(match) for k, match in enumerate(found) if match}


def _instant(match: re.Match[str]) -> int:
    """Return nanoseconds; whole numbers of 16 digits are microseconds."""
    whole, seconds, fraction = match.groups()
    if whole:
        return int(whole) * (1000 if len(whole) < 18 else 1)
    return int(seconds) * 10**9 + int(fraction.ljust(9, '0'))
