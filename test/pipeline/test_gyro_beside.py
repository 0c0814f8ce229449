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
"""A gyro beside the images: from a topic of Imu and from a table, and what is refused."""

from msg_adapters.message_types import rosbags_types
from msg_adapters.stamps import header_message
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from selfcal_ros.calibration.mount import MountFacts
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.robot.pose_checks import PoseReading
from selfcal_ros.pipeline.robot.robot_mount import read_robot
from selfcal_ros.pipeline.robot.robot_source import RobotSource

START_NS, STEP_NS = 1_700_000_000_123_456_789, 5_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = rosbags_types(STORE)
RATES = np.random.default_rng(4).normal(size=(30, 3))


def of(name, **fields):
    package, kind = name.split('/')
    return TYPES._builder(package, kind)(**fields)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('gyro') / 'drive'
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        def write(topic, kind, stamp, message, made={}):
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(made[topic], stamp, STORE.serialize_cdr(message, kind))

        for k, rate in enumerate(RATES):
            stamp = START_NS + k * STEP_NS
            header = header_message(stamp, 'imu', TYPES)
            for topic, known in (('/imu', 0.0), ('/compass', -1.0)):
                write(topic, 'sensor_msgs/msg/Imu', stamp, of(
                    'sensor_msgs/Imu', header=header,
                    orientation=of('geometry_msgs/Quaternion', x=0.0, y=0.0, z=0.0, w=1.0),
                    orientation_covariance=np.zeros(9),
                    angular_velocity=of('geometry_msgs/Vector3', x=rate[0], y=rate[1],
                                        z=rate[2]),
                    angular_velocity_covariance=np.full(9, known),
                    linear_acceleration=of('geometry_msgs/Vector3', x=0.0, y=0.0, z=9.8),
                    linear_acceleration_covariance=np.zeros(9)))
            if k % 10 == 0:
                write('/image', 'sensor_msgs/msg/Image', stamp, of(
                    'sensor_msgs/Image', header=header, height=24, width=32, step=32,
                    is_bigendian=0, encoding='mono8', data=np.full(24 * 32, k, np.uint8)))
    return path


def read(path, text, facts=MountFacts(), **reading):
    return read_robot(path, RobotSource.parse(text, PoseReading(**reading)), facts).poses


def test_a_topic_of_imu_tells_the_rates(bag):
    rates = read(bag, '/imu')
    np.testing.assert_array_equal(rates.rate_rad_s, RATES)
    np.testing.assert_array_equal(rates.stamps_ns, START_NS + STEP_NS * np.arange(30))
    assert rates.frame == 'imu' and read(bag, 'imu', body_frame='base').frame == 'base'


def test_a_table_tells_them_too(bag, tmp_path):
    table = tmp_path / 'imu.csv'
    rows = [f'{START_NS + k * STEP_NS},{x!r},{y!r},{z!r},0,0,9.8'
            for k, (x, y, z) in enumerate(RATES.tolist())]
    table.write_text('\n'.join(['stamp_ns,gyro_x,gyro_y,gyro_z,a_x,a_y,a_z', *rows]))
    np.testing.assert_array_equal(read(bag, str(table)).rate_rad_s, RATES)
    table.write_text(table.read_text().replace('stamp_ns', 'frame'))
    with pytest.raises(InputError, match='stamp_ns'):
        read(bag, str(table))


def test_what_a_gyro_has_not_is_refused(bag):
    with pytest.raises(InputError, match='no angular velocity'):
        read(bag, '/compass')
    with pytest.raises(ArgumentError, match='--robot-sigma'):
        read(bag, '/imu', sigma_position_m=0.1)
    with pytest.raises(ArgumentError, match='--mount-fact'):
        read(bag, '/imu', MountFacts(z=(0.5, 0.01)))
