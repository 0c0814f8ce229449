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
"""The robot on the command line: where its poses are, and what is known of the mount."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from selfcal_ros.cli.parsing import output_path, text
from selfcal_ros.errors import ArgumentError

if TYPE_CHECKING:
    from selfcal_ros.calibration.mount import MountFacts
    from selfcal_ros.pipeline.robot.robot_source import RobotSource


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the robot to `selfcal calibrate`."""
    group = parser.add_argument_group(
        'the camera on the robot', 'Poses of the robot beside the images tell where the camera '
        'sits on it, the scale in metres, and how far the two clocks are apart.')
    group.add_argument('--robot', metavar='POSES',
                       help='poses.csv (its header says what: stamp_ns, frame or image; '
                            'tx,ty,tz with qw,qx,qy,qz or rx,ry,rz; or x,y,theta), or of the '
                            'same bag a topic of Odometry or poses, such as /odom, or '
                            '/tf:FIXED:BODY, such as /tf:odom:base_link; a gyro, too (a topic '
                            'of Imu, or gyro_x,gyro_y,gyro_z), tells the turn of the camera')
    group.add_argument('--robot-kind', choices=('absolute', 'odometry'),
                       help='whether each pose errs by itself, or the way from one to the next '
                            '(default: odometry for Odometry, x,y,theta and TF from odom)')
    group.add_argument('--robot-sigma', metavar='M:DEGREES',
                       help='standard deviation of a pose, such as 0.001:0.05; of odometry, after '
                            'one metre, and after turning by one radian, such as 0.02:1.5 '
                            '(default: found from the misfit)')
    group.add_argument('--robot-unit', type=float, metavar='METRES',
                       help='metres in a unit of the positions: 0.001 for millimetres')
    group.add_argument('--robot-frame', type=text, metavar='FRAME',
                       help='name of the frame whose poses these are (default: what messages '
                            'call it, else base_link)')
    group.add_argument('--mount-fact', action='append', default=[], metavar='NAME=VALUE:SIGMA',
                       help='a known part of the mount: x, y, z (metres), roll, pitch, yaw '
                            '(degrees), scale (of odometry), time_offset (seconds); z=0.52:0.01 '
                            'is known to a centimetre, roll=0 exactly; may be repeated')


def add_mount_outputs(group: argparse._ActionsContainer) -> None:
    """Add the files of the mount to the outputs of `selfcal calibrate`."""
    group.add_argument('--mount-output', type=output_path, metavar='FILE',
                       help='where the camera is on the robot: .urdf (a joint), .yaml '
                            '(parameters of static_transform_publisher), .launch.py (as MoveIt '
                            'writes it) or .calib (easy_handeye2); where it is not known, the '
                            'exit status is 1')
    group.add_argument('--camera-frame', type=text, metavar='FRAME',
                       help='frame of the camera in that file (default: that of the images, or '
                            'camera_optical_frame)')


def robot_from(args: argparse.Namespace) -> tuple[RobotSource | None, MountFacts]:
    """
    Return where the poses of the robot are, and what is known of the mount.

    Raises
    ------
    ArgumentError
        If an option is impossible, or stands without --robot.

    """
    if args.robot is None:
        given = [name for name in ('robot_kind', 'robot_sigma', 'robot_unit', 'robot_frame',
                                   'mount_fact', 'mount_output', 'camera_frame')
                 if getattr(args, name) not in (None, [])]
        if given:
            raise ArgumentError(f'--{given[0].replace("_", "-")} needs the poses of a robot: '
                                '--robot poses.csv, or a topic of the bag.')
        from selfcal_ros.calibration.mount import MountFacts
        return None, MountFacts()
    if args.track:
        raise ArgumentError('--robot is for images of a scene or of an --object; --track follows '
                            'an object that moves. Leave one of them out.')
    if args.motion == 'repeated':
        raise ArgumentError('--robot needs an image for every view, and equal objects are in '
                            'one; leave it out.')
    from selfcal_ros.pipeline.robot.pose_checks import PoseReading
    from selfcal_ros.pipeline.robot.robot_source import RobotSource
    from selfcal_ros.pipeline.robot.stated import mount_facts, stated_sigmas
    if args.mount_output is not None:
        from selfcal_ros.report.mounts.transform_files import kind_of_name
        kind_of_name(args.mount_output)
    position, rotation = stated_sigmas(args.robot_sigma)
    reading = PoseReading(args.robot_kind, position, rotation, args.robot_unit, args.robot_frame)
    return RobotSource.parse(args.robot, reading), mount_facts(args.mount_fact)
