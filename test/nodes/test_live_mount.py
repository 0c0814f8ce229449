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
"""A calibrator that hears the robot, too: where the camera sits, live, with poses that lie."""

from dataclasses import replace
from importlib.util import find_spec
import json

from bench.mounts.mount_worlds import odometry
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import pose_message, transform_message
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_message
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from selfcal_ros.calibration.mount import Mount, mount_rotation, NAMES
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.nodes import mount_publisher
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.synthetic.special_scenes import drive
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import String
from test_support.diagnostics_table import not_written

START_NS, STEP_NS = 1_700_000_000_123_456_789, 200_000_000
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
VIEWS = 20
needs_tf = pytest.mark.skipif(find_spec('tf2_msgs') is None, reason='tf2_msgs is not installed')


def robot_of(sequence, rng):
    """Return the mount that a drive may have, and its odometry, message by message."""
    cameras = np.broadcast_to(np.eye(4), (VIEWS, 4, 4)).copy()
    cameras[:, :3] = sequence.cam_from_world
    cameras = np.linalg.inv(cameras)
    mount = np.eye(4)
    # the scene's camera is pitched by 20 degrees; beside, it looks 5 degrees to the left
    mount[:3, :3], mount[:3, 3] = mount_rotation(0, np.radians(20), np.radians(5)), (0.3, 0.1, 0.6)
    body = cameras @ np.linalg.inv(mount)
    poses = odometry(rng, body[:, :3, :3], body[:, :3, 3], (1e-3, 1e-3, 1e-3),
                     frames=np.arange(VIEWS))
    return mount, poses


def pose_of(rotation, position):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


class Wheels:
    """Odometry on a topic of its own."""

    parameters = 'robot:=/wheels/odom',

    def __init__(self, probe):
        self._types = rclpy_types()
        self._publisher = probe.create_publisher(Odometry, '/wheels/odom', 100)
        self.get_subscription_count = self._publisher.get_subscription_count

    def send(self, pose, stamp, x=None):
        message = Odometry(header=header_message(stamp, 'odom', self._types),
                           child_frame_id='base_link')
        message.pose.pose = pose_message(pose, self._types)
        if x is not None:
            message.pose.pose.position.x = x
        self._publisher.publish(message)


class Tree:
    """The same in TF, with a joint of the robot between."""

    parameters = 'robot:=/tf:odom:base_link', 'robot_kind:=odometry', 'publish_tf:=true'

    def __init__(self, probe):
        from tf2_msgs.msg import TFMessage
        self._kind, self._types = TFMessage, rclpy_types()
        self._publisher = probe.create_publisher(TFMessage, '/tf', 100)
        self.get_subscription_count = self._publisher.get_subscription_count
        self._joint = pose_of(np.eye(3), [0.2, 0.0, 0.1])
        probe.create_publisher(TFMessage, '/tf_static', LATCHED).publish(TFMessage(transforms=[
            self._transform(self._joint, 0, 'lift', 'base_link')]))

    def _transform(self, pose, stamp, parent, child):
        return transform_message(pose, header_message(stamp, parent, self._types), child,
                                 self._types)

    def send(self, pose, stamp, x=None):
        sent = self._transform(pose @ np.linalg.inv(self._joint), stamp, 'odom', 'lift')
        if x is not None:
            sent.transform.translation.x = x
        self._publisher.publish(self._kind(transforms=[sent]))


@pytest.mark.long
@pytest.mark.ros
@pytest.mark.parametrize('source', [Wheels, pytest.param(Tree, marks=needs_tf)])
def test_odometry_and_tracks_through_a_process_give_the_mount(graph, launch, source):
    sequence = drive(np.random.default_rng(11), noise_px=0.1, views=VIEWS, tracks=300)
    mount, poses = robot_of(sequence, np.random.default_rng(3))
    graph, types = graph(), rclpy_types()
    infos = graph.listen(CameraInfo, 'camera_info')
    results = graph.listen(String, 'planar_calibrator/result', LATCHED)
    diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
    tracks = graph.probe.create_publisher(PointCloud2, 'tracks', 10)
    odom = source(graph.probe)
    own = [word for parameter in source.parameters for word in ('-p', parameter)]
    launch('planar_calibrator', '-p', 'keyframe_parallax:=0.001', '-p', 'first_estimate:=20',
           '-p', 'idle_s:=0.5', '-p', 'distortion:=none', *own, '-p',
           'mount_facts:=time_offset=0 z=0.6:0.01')
    graph.wait_for(lambda: odom.get_subscription_count() and tracks.get_subscription_count())
    graph.wait_for(lambda: graph.probe.count_publishers('camera_info'))

    def dropped(before=1):
        told = diagnostics[-before].status[0].values if len(diagnostics) >= before else ()
        return sum(int(one.value) for one in told if one.key == 'robot poses dropped')

    def poses_arrive():
        odom.send(np.eye(4), START_NS, x=float('nan'))
        return dropped() > 0

    graph.wait_for(poses_arrive, what='a pose')
    for view in range(VIEWS):
        stamp = START_NS + view * STEP_NS
        odom.send(np.eye(4), START_NS, x=float('nan'))
        odom.send(pose_of(poses.rotation[view], poses.position[view]), stamp)
        odom.send(np.eye(4), START_NS - 10 * 10**9)
        if view == VIEWS - 1:
            # poses come three at a time, and wait in turn with tracks: until no more are taken
            told = len(diagnostics)
            graph.wait_for(lambda: len(diagnostics) > told + 1 and dropped() == dropped(before=2),
                           what='all poses')
        mask, known = sequence.tracks.frame == view, len(infos)
        tracks.publish(tracks_message(
            sequence.tracks.track[mask], sequence.tracks.xy[mask], (640, 480),
            header_message(stamp, 'eye', types), types))
        graph.wait_for(lambda: len(infos) > known, what='camera_info')
    graph.wait_for(lambda: results and 'mount' in json.loads(results[-1].data), 60, 'mount')
    found = json.loads(results[-1].data)['mount']
    assert found['frame'] == 'base_link', found
    errors = np.concatenate([
        np.array(found['T_body_camera'])[:3, 3] - mount[:3, 3],
        rotation_vector(np.array(found['T_body_camera'])[:3, :3] @ mount[:3, :3].T)])
    sigma = np.array([found['sigma'][name] for name in NAMES[:6]])
    assert (np.abs(errors) < 4 * sigma).all() and sigma[[0, 1]].max() < 0.03
    assert sigma[3:].max() < np.radians(0.5), found
    # who comes late gets it, too
    late = graph.listen(TransformStamped, 'planar_calibrator/mount', LATCHED)
    graph.wait_for(lambda: late, what='the latched mount')
    assert (late[0].header.frame_id, late[0].child_frame_id) == ('base_link', 'eye')
    assert late[0].transform.translation.z == pytest.approx(0.6, abs=0.03)
    if source is Tree:
        from tf2_msgs.msg import TFMessage
        static = graph.listen(TFMessage, '/tf_static', QoSProfile(
            depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        graph.wait_for(lambda: len(static) >= 2, what='the joint and the mount on /tf_static')
        graph.spin_for(0.3)
        sent = [one for message in static for one in message.transforms]
        assert [one for one in sent if one.child_frame_id == 'eye'] == [late[0]] and len(sent) == 2
    seen = len(diagnostics)
    graph.wait_for(lambda: len(diagnostics) > seen)
    values = {v.key: v.value for v in diagnostics[-1].status[0].values}
    assert int(values['robot poses dropped']) >= VIEWS
    assert 'not finite' in values['robot poses last dropped']
    assert found['camera_frame'] == 'eye' and not not_written(values)
    assert float(values['mount x']) == pytest.approx(found['T_body_camera'][0][3], abs=1e-4)


def test_a_topic_that_is_not_there_lists_those_that_are(graph):
    graph = graph('-p', 'robot:=/odometry')
    graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
    diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
    graph.probe.create_publisher(Odometry, '/wheels/odom', 10)
    graph.probe.create_publisher(PoseStamped, '/mocap', 10)
    graph.wait_for(lambda: any('poses are on /mocap, /wheels/odom' in one.status[0].message
                               for one in diagnostics))
    assert 'no poses on /odometry yet' in diagnostics[-1].status[0].message


def test_poses_are_heard_however_their_publisher_sends_when_it_comes_again(graph):
    graph = graph('-p', 'robot:=/odom')
    node = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
    # a viewer that is there before the publisher tells nothing of how it will send
    graph.probe.create_subscription(Odometry, '/odom', lambda msg: None, 10)
    graph.wait_for(lambda: graph.probe.count_subscribers('/odom') > 0)
    graph.spin_for(0.3)
    robot = node._robot.robot
    for turn, reliability in enumerate((ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE,
                                        ReliabilityPolicy.BEST_EFFORT)):
        publisher = graph.probe.create_publisher(
            Odometry, '/odom', QoSProfile(depth=10, reliability=reliability))
        message = Odometry(child_frame_id='base_link', header=header_message(
            START_NS + turn * STEP_NS, 'odom', rclpy_types()))
        message.pose.pose.orientation.w = 1.0

        def is_heard():
            publisher.publish(message)
            return len(robot) > turn

        graph.wait_for(is_heard, what=f'a pose of publisher {turn}')
        graph.probe.destroy_publisher(publisher)
    assert robot.dropped == 0


@pytest.mark.parametrize('given, words', [
    (('robot_sigma:=0.1:1.0',), 'robot_sigma needs the poses of a robot'),
    (('robot:=/odom', 'robot_sigma:="0.1"'), 'metres and degrees'),
    (('robot:=/odom', 'mount_facts:=height=1'), 'NAME=VALUE:SIGMA'),
    (('robot:=poses.csv',), 'takes a topic'), (('robot:=/tf:odom',), '/tf:FIXED:BODY'),
    *(((f'{name}:={value}',), f'{name} needs the poses of a robot') for name, value in (
        ('publish_tf', 'true'), ('robot_unit', '0.001'), ('robot_kind', 'odometry'),
        ('camera_frame', 'cam')))])
def test_parameters_that_cannot_be_are_refused(graph, given, words):
    graph(*(word for one in given for word in ('-p', one)))
    with pytest.raises(ArgumentError, match=words):
        CalibratorNode('planar_calibrator', PlanarCalibratorParameters)


@pytest.mark.skipif(find_spec('tf2_msgs') is not None, reason='tf2_msgs is installed')
def test_tf_without_its_messages_is_refused_at_run_time(graph):
    graph = graph('-p', 'robot:=/odom')
    graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
    refused, = graph.set_parameters('planar_calibrator', publish_tf=True)
    assert refused.startswith('publish_tf needs the package tf2_msgs')


class Recorder:
    """A node that only remembers what is published where."""

    def __init__(self):
        self.sent = {}

    def create_publisher(self, kind, topic, qos):
        self.sent[topic] = messages = []
        return type('Publisher', (), {'publish': lambda _, message: messages.append(message)})()

    def get_clock(self):
        return type('Clock', (), {'now': lambda _: type('Now', (), {'nanoseconds': 7})()})()


class Transforms:
    """Stands for tf2_msgs/TFMessage where that is not installed."""

    def __init__(self, transforms):
        self.transforms = transforms


def a_mount(x, z_known=True):
    status = dict.fromkeys(NAMES, 'estimated')
    pose = np.eye(4)
    pose[:3, 3] = x, 0, 0.5
    if not z_known:
        status['z'], pose[2, 3] = 'unobservable', np.nan
    covariance = np.diag([1e-4] * 8)
    if not z_known:
        covariance[2, 2] = np.inf
    return Mount('base_link', pose, covariance, status, 1.0, 0.0, {}, 20, 0, 1e-3, 1e-3)


def test_the_log_has_a_mount_in_a_line():
    line = mount_publisher.mount_line(a_mount(0.3, z_known=False))
    assert line.startswith('The camera on base_link, from 20 poses') and '\n' not in line
    odd = mount_publisher.mount_line(a_mount(0.3), [
        Finding('metre_of_odometry'),
        Finding('mount_upside_down', body='base_link', roll_deg=180.0)])
    assert odd.endswith('turns to the left must be positive.') and 'wheels' not in odd
    assert 'leaves z open' in line and 'x 0.300 ± 0.010 m' in line and 'yaw' in line
    refused = mount_publisher.mount_line(NoEstimate('body_stood_still', body='base_link'))
    assert refused.startswith('Where the camera sits is not known')


def test_a_mount_goes_to_tf_once_and_again_only_where_it_is_news(monkeypatch):
    monkeypatch.setattr(mount_publisher, 'transform_type', lambda _: Transforms)
    node = Recorder()
    publisher = mount_publisher.MountPublisher(node, True)
    publisher.camera_frame = 'eye'
    publisher.take(a_mount(0.3, z_known=False))
    assert not node.sent['/tf_static'] and publisher.why_not.startswith('z of the mount')
    for x in (0.300, 0.305, 0.295):
        publisher.take(a_mount(x))
    sent, = node.sent['/tf_static']
    assert sent.transforms[0].transform.translation.x == 0.3 and not publisher.why_not
    assert sent.transforms[0].child_frame_id == 'eye' and len(node.sent['~/mount']) == 1
    publisher.take(a_mount(0.35))
    assert len(node.sent['/tf_static']) == len(node.sent['~/mount']) == 2
    # half a turn has the sine of none
    upside_down = a_mount(0.35)
    pose = upside_down.T_body_camera.copy()
    pose[:3, :3] = np.diag([1.0, -1, -1]) @ pose[:3, :3]
    publisher.take(replace(upside_down, T_body_camera=pose))
    assert len(node.sent['/tf_static']) == 3
