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
"""One bad pose or transform of the robot costs itself alone, and is told."""

from msg_adapters.message_types import rosbags_types
from msg_adapters.poses import pose_message, transform_message
from msg_adapters.stamps import header_message
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.robot.live_robot import LiveRobot
from selfcal_ros.pipeline.robot.pose_topics import read_pose_topic, read_transforms
from selfcal_ros.pipeline.robot.robot_source import RobotSource

START_NS, STEP_NS, COUNT = 1_700_000_000_000_000_000, 50_000_000, 10
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = rosbags_types(STORE)


def pose_at(x):
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def one_tf(x, stamp, parent, child, w=None):
    found = transform_message(pose_at(x), header_message(stamp, parent, TYPES), child, TYPES)
    if w is not None:
        found.transform.rotation.w = w
    return found


def tf(*transforms):
    return TYPES._builder('tf2_msgs', 'TFMessage')(transforms=list(transforms))


def odometry(x, stamp):
    pose = pose_message(pose_at(0), TYPES)
    pose.position.x = x
    return TYPES._builder('nav_msgs', 'Odometry')(
        header=header_message(stamp, 'odom', TYPES), child_frame_id='base_link',
        pose=TYPES.PoseWithCovariance(pose=pose))


def written(path, topic, kind, messages):
    """Write a bag of one topic."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, kind, typestore=STORE)
        for k, message in enumerate(messages):
            writer.write(connection, START_NS + k * STEP_NS, STORE.serialize_cdr(message, kind))
    return path


def bag_of_odometry(path, bad):
    return written(path, '/odom', 'nav_msgs/msg/Odometry', [
        odometry(*bad.get(k, (k / 10, START_NS + k * STEP_NS))) for k in range(COUNT)])


def bag_of_transforms(path, beside):
    """Write odom → base_link, and with each what stands beside it."""
    return written(path, '/tf', 'tf2_msgs/msg/TFMessage', [
        tf(*beside(k, START_NS + k * STEP_NS),
           one_tf(k / 10, START_NS + k * STEP_NS, 'odom', 'base_link'))
        for k in range(COUNT)])


def test_poses_of_no_use_in_a_bag_are_left_out_and_told(tmp_path, caplog):
    path = bag_of_odometry(tmp_path / 'bag', {4: (np.nan, START_NS + 4 * STEP_NS), 6: (0.6, 0)})
    found = read_pose_topic(path, '/odom')
    assert np.allclose(found.position[:, 0], [k / 10 for k in range(COUNT) if k not in (4, 6)])
    said, = (record.getMessage() for record in caplog.records)
    assert said.startswith(f'poses on /odom of {path}: 2 left out, the first at 1700000000.200 s')
    assert 'not finite' in said


def test_a_bag_with_one_pose_of_use_is_refused(tmp_path):
    path = bag_of_odometry(tmp_path / 'bag', {
        k: (np.nan, START_NS + k * STEP_NS) for k in range(1, COUNT)})
    with pytest.raises(InputError, match='holds 1 poses of use, and two are needed at least; 9 '
                       'left out, the first at 1700000000.050 s: .* not finite'):
        read_pose_topic(path, '/odom')
    path = bag_of_odometry(tmp_path / 'unstamped', {k: (k, 0) for k in range(COUNT)})
    with pytest.raises(InputError, match='must fill the header'):
        read_pose_topic(path, '/odom')


def test_transforms_of_other_frames_spoil_none_of_the_chain(tmp_path, caplog):
    def beside(k, stamp):
        yield one_tf(k, stamp, ('map', 'odom')[k % 2], 'person')
        if k == 5:
            yield one_tf(1, stamp, 'map', 'dog', w=0.0)
            yield one_tf(7, stamp + 1, 'odom', 'base_link', w=np.nan)
            yield one_tf(7, 0, 'odom', 'base_link')

    path = bag_of_transforms(tmp_path / 'bag', beside)
    found = read_transforms(path, 'odom', 'base_link')
    assert np.allclose(found.position[:, 0], np.arange(COUNT) / 10)
    said, = (record.getMessage() for record in caplog.records)
    assert said.startswith(f'transforms of {path}: 3 left out, the first dog in map at '
                           '1700000000.250 s: The quaternion')
    with pytest.raises(InputError, match='person has two parents'):
        read_transforms(path, 'base_link', 'person')
    # what a user may name is listed for all that
    with pytest.raises(InputError, match=r'frames base_link, dog, map, odom, person'):
        read_pose_topic(path, '/odom')


def test_a_chain_without_a_transform_of_use_is_refused_with_the_reason(tmp_path):
    path = bag_of_transforms(tmp_path / 'bag', lambda k, stamp: [
        one_tf(k, stamp, 'base_link', 'tip', w=0.0)])
    with pytest.raises(InputError) as caught:
        read_transforms(path, 'odom', 'tip')
    assert str(caught.value).startswith(f'{path}: TF has no frame tip; it has base_link, odom; of '
                                        'the transforms 10 left out, the first tip in base_link')


def test_a_bad_transform_costs_a_live_message_none_of_the_others():
    robot = LiveRobot(RobotSource.parse('/tf:odom:base_link'))
    for k in range(1, COUNT + 1):
        robot.add_transforms(tf(one_tf(1, k * STEP_NS, 'base_link', 'wheel', w=0.0),
                                one_tf(k / 10, k * STEP_NS, 'odom', 'base_link')), False)
    assert len(robot) == robot.dropped == COUNT
    assert robot.why_dropped.startswith('wheel in base_link at 0.500 s: The quaternion')
    robot.add_transforms(tf(one_tf(7, 0, 'odom', 'base_link')), False)
    assert len(robot) == COUNT and robot.dropped == COUNT + 1
    assert np.allclose(robot.snapshot().poses().position[:, 0], np.arange(1, COUNT + 1) / 10)
