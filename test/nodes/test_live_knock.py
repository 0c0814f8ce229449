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
"""A camera that is knocked on its robot, live: nodes in processes of their own, over DDS."""

import json

from bench.mounts.mount_worlds import odometry
from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import pose_message
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_message
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from selfcal_ros.calibration.mount import mount_rotation
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.special_scenes import drive
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import String

START_NS, STEP_NS = 1_700_000_000_123_456_789, 200_000_000
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: Calibrated once, with the first views; every view is a keyframe.
CALIBRATED, KNOCKED_AT, VIEWS = 30, 46, 94
KNOCK_DEG = np.array([0.0, 0.5, 0.0])


def robot(sequence):
    """Odometry of a robot whose camera is knocked at a view."""
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = mount_rotation(0, np.radians(20), np.radians(5)), (0.3, 0.1, 0.6)
    knocked = mount.copy()
    knocked[:3, :3] = rotation_matrix(np.radians(KNOCK_DEG)) @ mount[:3, :3]
    cameras = np.broadcast_to(np.eye(4), (VIEWS, 4, 4)).copy()
    cameras[:, :3] = sequence.cam_from_world
    late = (np.arange(VIEWS) >= KNOCKED_AT)[:, None, None]
    body = np.linalg.inv(np.where(late, knocked, mount) @ cameras)
    return odometry(np.random.default_rng(3), body[:, :3, :3], body[:, :3, 3],
                    (0.005, 0.001, 0.002), stamps_ns=START_NS + np.arange(VIEWS) * STEP_NS)


class Drive:
    """A calibrator in a process of its own, and a robot that tells it what it sees and does."""

    def __init__(self, graph, launch):
        self.sequence = drive(np.random.default_rng(31), 0.1, VIEWS, 3000)
        self.poses, self.graph, self.types = robot(self.sequence), graph, rclpy_types()
        self.infos = graph.listen(CameraInfo, 'camera_info')
        self.results = graph.listen(String, 'planar_calibrator/result', LATCHED)
        self.diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
        self.tracks = graph.probe.create_publisher(PointCloud2, 'tracks', 10)
        self.odom = graph.probe.create_publisher(Odometry, '/odom', 100)
        # no machine is too slow: neither an estimate nor a warning waits for a clock
        launch('planar_calibrator', '-p', 'keyframe_parallax:=0.001', '-p',
               f'first_estimate:={CALIBRATED}', '-p', f'max_keyframes:={CALIBRATED}', '-p',
               'idle_s:=600.0', '-p', 'silence_s:=600.0', '-p', 'distortion:=none', '-p',
               'robot:=/odom', '-p', 'mount_facts:=time_offset=0 z=0.6:0.01')
        graph.wait_for(lambda: self.odom.get_subscription_count()
                       and self.tracks.get_subscription_count())
        graph.wait_for(lambda: graph.probe.count_publishers('camera_info'))
        graph.spin_for(0.3)

    def publish(self, views):
        """Send odometry and tracks of some views; each is answered before the next."""
        for view in views:
            stamp, body, known = START_NS + view * STEP_NS, np.eye(4), len(self.infos)
            body[:3, :3], body[:3, 3] = self.poses.rotation[view], self.poses.position[view]
            message = Odometry(header=header_message(stamp, 'odom', self.types),
                               child_frame_id='base_link')
            message.pose.pose = pose_message(body, self.types)
            self.odom.publish(message)
            mask = self.sequence.tracks.frame == view
            self.tracks.publish(tracks_message(
                self.sequence.tracks.track[mask], self.sequence.tracks.xy[mask], (640, 480),
                header_message(stamp, 'eye', self.types), self.types))
            self.graph.wait_for(lambda: len(self.infos) > known, what='camera_info')

    def status(self):
        """Level, message and values of the newest diagnostic."""
        status = self.diagnostics[-1].status[0]
        return status.level, status.message, {v.key: v.value for v in status.values}

    def wait_for_status(self, condition, what):
        self.graph.wait_for(lambda: self.diagnostics and condition(*self.status()), 60, what)
        return self.status()


@pytest.mark.long
@pytest.mark.ros
def test_a_knock_of_half_a_degree_raises_the_diagnostics(graph, launch):
    robot = Drive(graph(), launch)
    robot.publish(range(CALIBRATED))
    robot.graph.wait_for(lambda: robot.results and 'mount' in json.loads(robot.results[-1].data),
                         60, 'mount')
    robot.publish(range(CALIBRATED, KNOCKED_AT))
    level, message, values = robot.wait_for_status(
        lambda level, message, values: int(values.get('mount monitor windows', 0)) >= 1,
        'a window of the mount')
    assert level == b'\x00' and message == 'calibrated', message
    assert float(values['mount monitor statistic']) < float(values['mount monitor threshold'])
    robot.publish(range(KNOCKED_AT, VIEWS))
    level, message, values = robot.wait_for_status(
        lambda level, message, values: level == b'\x01', 'the alarm')
    assert 'pitch' in message and '~/calibrate' in message
    for name, wanted in zip(('roll', 'pitch', 'yaw'), KNOCK_DEG):
        change, sigma = (float(values[f'change of {name} deg{end}']) for end in ('', ' sigma'))
        assert abs(change - wanted) < 4 * sigma and sigma < 0.2
