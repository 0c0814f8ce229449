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
"""Poses of the robot while they come: bounded memory, wrong stamps, frames that are not there."""

from dataclasses import replace

from msg_adapters.message_types import rosbags_types
from msg_adapters.poses import pose_message, transform_message
from msg_adapters.stamps import header_message
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores
from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.robot.live_robot import LiveRobot
from selfcal_ros.pipeline.robot.pose_buffer import PoseBuffer
from selfcal_ros.pipeline.robot.robot_source import RobotSource

STEP_NS = 10_000_000
TYPES = rosbags_types(get_typestore(Stores.ROS2_JAZZY))


def pose_at(x):
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def filled(stamps, most=1000):
    buffer = PoseBuffer(most)
    for stamp in stamps:
        buffer.add(stamp, pose_at(stamp))
    return buffer


def test_memory_is_bounded_and_poses_near_images_stay():
    buffer, image = PoseBuffer(1000), 50 * STEP_NS
    most = 0
    for k in range(20_000):
        buffer.add(k * STEP_NS, pose_at(k))
        if buffer.is_full:
            buffer.thin([image])
        most = max(most, len(buffer))
    assert most <= 1001
    stamps, poses = buffer.arrays()
    near = np.abs(stamps - image) <= 50 * STEP_NS
    assert near.sum() == 101 and (poses[near, 0, 3] == np.arange(101)).all()
    # the newest are whole, too: an image may be on its way
    assert (np.diff(stamps[-70:]) == STEP_NS).all()


def test_memory_is_bounded_where_images_are_everywhere():
    buffer = PoseBuffer(1000)
    for k in range(5000):
        buffer.add(k * STEP_NS, pose_at(k))
        if buffer.is_full:
            buffer.thin(range(0, 5000 * STEP_NS, 10 * STEP_NS))
    assert 700 <= len(buffer) <= 1001 and buffer.arrays()[0][-1] == 4999 * STEP_NS


def test_a_stray_stamp_costs_nothing_and_a_clock_set_back_begins_again():
    ahead = filled([*range(0, 10**9, STEP_NS), 10**15, *range(10**9, 2 * 10**9, STEP_NS)])
    assert (ahead.arrays()[0] == np.arange(0, 2 * 10**9, STEP_NS)).all()
    behind = filled([*range(10**12, 10**12 + 10**9, STEP_NS), 5, 10**12 + 10**9])
    assert len(behind) == 101 and not behind.set_back
    again = filled([*range(10**12, 10**12 + 10**9, STEP_NS), *range(0, 10**9, STEP_NS)])
    assert again.set_back == 1 and (again.arrays()[0] == np.arange(0, 10**9, STEP_NS)).all()
    late = filled([0, 2 * STEP_NS, STEP_NS])
    assert late.arrays()[0].tolist() == [0, STEP_NS, 2 * STEP_NS]


def tf(x, stamp, parent, child):
    kind = TYPES._builder('tf2_msgs', 'TFMessage')
    return kind(transforms=[transform_message(
        pose_at(x), header_message(stamp, parent, TYPES), child, TYPES)])


def test_a_chain_of_live_transforms_is_composed_in_whatever_order_it_comes():
    robot = LiveRobot(RobotSource.parse('/tf:odom:tip'))
    assert robot.snapshot() is None
    robot.add_transforms(tf(0.5, 0, 'base', 'lift'), True)
    robot.add_transforms(tf(9.0, 0, 'base', 'laser'), True)
    for k in range(1, 11):
        robot.add_transforms(tf(0.25, k * STEP_NS, 'lift', 'tip'), False)
        robot.add_transforms(tf(k / 100, k * STEP_NS, 'odom', 'base'), False)
        robot.add_transforms(tf(k, k * STEP_NS, 'wheel', 'hub'), False)
    poses = robot.snapshot().poses()
    assert (poses.kind, poses.body_frame, len(poses)) == ('odometry', 'tip', 10)
    assert np.allclose(poses.position[:, 0], np.arange(1, 11) / 100 + 0.75)
    # what is not on the way is not gathered
    assert len(robot) == 21
    with pytest.raises(InputError, match='no frame map; it has base, hub, laser, lift, odom'):
        other = LiveRobot(RobotSource.parse('/tf:map:base'))
        for message in (tf(0.5, 5, 'base', 'lift'), tf(1, 5, 'base', 'laser'),
                        tf(1, 5, 'odom', 'base'), tf(1, 5, 'wheel', 'hub')):
            other.add_transforms(message, False)
        other.snapshot().poses()


def test_poses_that_are_no_poses_are_dropped_and_told():
    robot = LiveRobot(RobotSource.parse('/pose'))

    def add(pose, stamp, **changes):
        header = header_message(stamp, 'map', TYPES)
        message = TYPES.PoseStamped(header=header, pose=pose_message(pose, TYPES))
        for name, value in changes.items():
            setattr(message.pose.orientation, name, value)
        robot.add(message, 'geometry_msgs/msg/PoseStamped')

    add(pose_at(1), STEP_NS)
    assert robot.snapshot() is None
    add(pose_at(2), 0)
    assert robot.dropped == 1 and 'no stamp' in robot.why_dropped
    add(pose_at(2), 2 * STEP_NS, w=2.0)
    assert robot.dropped == 2 and 'length 2' in robot.why_dropped
    add(pose_at(2), 2 * STEP_NS, x=float('nan'))
    assert robot.dropped == 3 and 'not finite' in robot.why_dropped
    add(pose_at(2), 2 * STEP_NS)
    poses = robot.snapshot().poses()
    assert (poses.kind, poses.world_frame, len(poses)) == ('absolute', 'map', 2)


def test_a_stretch_of_what_is_known_has_the_same_poses():
    robot = LiveRobot(RobotSource.parse('/tf:odom:tip'))
    robot.add_transforms(tf(0.5, 0, 'base', 'tip'), True)
    stamps = [10**18 + k * 10**8 for k in range(100)]
    for k, stamp in enumerate(stamps):
        robot.add_transforms(tf(k / 100, stamp, 'odom', 'base'), False)
    whole = robot.snapshot()
    part = whole.between(stamps[40], stamps[50]).poses()
    # with a second to both sides, for clocks that differ
    assert stamps[30] < part.stamps_ns[0] <= stamps[32] and part.stamps_ns[-1] < stamps[60]
    same = np.isin(whole.poses().stamps_ns, part.stamps_ns)
    assert np.allclose(part.position, whole.poses().position[same])
    poses = replace(whole, read=whole.poses())
    assert len(poses.between(stamps[40], stamps[50]).poses()) == len(part)
    # of a time that nobody told of, two poses far away
    assert len(poses.between(2 * 10**18, 2 * 10**18 + 1).poses()) == 2
