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
"""rorapid_tracker: poses with the stamps of the images; bad input is told, and it goes on."""

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from msg_adapters.camera_info import camera_info_message
from msg_adapters.image import image_message
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import pose_covariance, pose_matrix, pose_with_covariance_message
from msg_adapters.stamps import header_message, stamp_ns
import numpy as np
import pytest
from rclpy.qos import QoSProfile
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.nodes.interfaces import INTERFACES
from selfcal_ros.nodes.quality_of_service import LATCHED
from selfcal_ros.nodes.object_tracker_node import ObjectTrackerNode, tracker_options
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.report.shutter_comment import shutter_comment
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic.depth_scenes import depth_of
from selfcal_ros.synthetic.objects import perturbed, pose_errors, tracked_object
from selfcal_ros.synthetic.several_objects import objects_beside
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from test_support.diagnostics_table import not_written
from visualization_msgs.msg import MarkerArray

VIEWS = 12
FRAME = 'left_optical_frame'
OFFSET_NS = 10 ** 9


@pytest.fixture(scope='module')
def recording():
    """Render a few images of a cube, once."""
    made = tracked_object(VIEWS, 'cube', size=(320, 240), rate_hz=30.0)
    return made, [image for image, _ in made.frames()]


@pytest.fixture
def model(recording, tmp_path):
    return write_model(recording[0].model, tmp_path / 'cube.yaml')


class Station:
    """Feeds a node with images and what else it takes, and hears what it says."""

    def __init__(self, graph, recording):
        self.graph, (self.recording, self.images) = graph, recording
        self.types = rclpy_types()
        probe = graph.probe
        # before the node: what comes first is not lost
        self.poses = graph.listen(PoseWithCovarianceStamped, 'pose')
        self.states = graph.listen(String, 'rorapid_tracker/state', LATCHED)
        self.diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
        self.image = probe.create_publisher(Image, 'image', 10)
        self.info = probe.create_publisher(CameraInfo, 'camera_info', 10)
        self.start = probe.create_publisher(PoseWithCovarianceStamped, 'initialpose', 10)

    def add_node(self):
        node = self.graph.add(ObjectTrackerNode())
        self.graph.wait_for(lambda: all(p.get_subscription_count() for p in (
            self.image, self.info, self.start)), what='subscriptions of the node')
        self.graph.wait_for(lambda: self.graph.probe.count_publishers('pose') > 0)
        return node

    def header(self, index, frame=FRAME):
        return header_message(int(self.recording.stamps_ns[index]), frame, self.types)

    def send(self, index, image=None, header=None):
        picture = self.images[index] if image is None else image
        self.image.publish(image_message(picture, header or self.header(index), self.types))

    def send_info(self, camera=None):
        self.info.publish(camera_info_message(camera or self.recording.camera, self.header(0),
                                              self.types))

    def send_start(self, pose=None, frame=FRAME):
        if pose is None:
            R, t = perturbed(self.recording.rotations[0], self.recording.translations[0],
                             np.random.default_rng(1), 0.03, 0.003)
            pose = np.column_stack([R, t])
        self.start.publish(pose_with_covariance_message(
            pose, np.eye(6), self.header(0, frame), self.types))

    def track(self, indices):
        """Send images one after the other, each when the pose of the last has come."""
        for index in indices:
            known = len(self.poses)
            self.send(index)
            self.graph.wait_for(lambda: len(self.poses) > known, what=f'pose of image {index}')

    def last_error(self):
        """Compare the last pose with the truth at its stamp."""
        msg = self.poses[-1]
        index = list(self.recording.stamps_ns).index(stamp_ns(msg.header.stamp))
        pose = pose_matrix(msg)
        return pose_errors(pose[:3, :3], pose[:3, 3], self.recording.rotations[index],
                           self.recording.translations[index])


@pytest.fixture
def station(graph, recording, model):
    """Start a node that knows the model, and nothing else unless told."""
    def make(*parameters):
        words = [word for parameter in (f'model:={model}', *parameters)
                 for word in ('-p', parameter)]
        return Station(graph(*words), recording)

    return make


def test_poses_are_true_and_carry_the_header_of_their_image(station):
    station = station()
    station.add_node()
    station.send_info()
    station.send_start()
    markers = station.graph.listen(MarkerArray, 'rorapid_tracker/markers')
    overlays = station.graph.listen(Image, 'rorapid_tracker/overlay', QoSProfile(depth=1))
    station.graph.spin_for(0.3)
    station.track(range(VIEWS))
    assert [msg.header for msg in station.poses[-3:]] == [station.header(k) for k in (-3, -2, -1)]
    angle, share = station.last_error()
    assert np.rad2deg(angle) < 0.5 and share < 0.01
    covariance = pose_covariance(station.poses[-1])
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert np.sqrt(covariance[:3, :3].trace()) < 0.01
    station.graph.wait_for(lambda: overlays and markers)
    assert (overlays[-1].encoding, overlays[-1].width) == ('bgr8', 320)
    assert markers[-1].markers[0].header.frame_id == FRAME
    assert station.states[-1].data.startswith('tracking')


def test_files_and_parameters_start_it_without_any_message(station, recording, tmp_path):
    camera = write_camera_yaml(tmp_path / 'camera.yaml', recording[0].camera, 'front')
    pose = tmp_path / 'start.pos'
    pose.write_text(' '.join(map(str, [*recording[0].translations[0],
                                       *rotation_vector(recording[0].rotations[0])])))
    station = station(f'camera_file:={camera}', f'start_pose:={pose}', 'camera_name:=front')
    station.add_node()
    station.track(range(3))
    assert station.last_error()[1] < 0.01
    station.graph.wait_for(lambda: any('found' in str(msg) or msg.status[0].message == 'tracking'
                                       for msg in station.diagnostics), what='diagnostics')
    status = station.diagnostics[-1].status[0]
    assert not not_written(one.key for one in status.values)
    assert status.hardware_id == 'front'


def test_lines_are_read_as_the_parameters_say_or_else_the_camera_file(graph, recording, model,
                                                                      tmp_path):
    readout = RowReadout(-4e-5, 1e-7, 'estimated', 0.6, 0.01, 320, 'columns')
    camera = write_camera_yaml(tmp_path / 'camera.yaml', recording[0].camera, 'front',
                               shutter_comment(readout))
    graph('-p', f'model:={model}', '-p', f'camera_file:={camera}')
    node = ObjectTrackerNode()
    asked = tracker_options(node.parameters, node._file_lines)
    stated = tracker_options(replace(node.parameters, line_delay_s=2e-5), node._file_lines)
    node.destroy_node()
    assert (asked.line_delay_s, asked.lines) == (pytest.approx(-4e-5), 'columns')
    assert (stated.line_delay_s, stated.lines) == (2e-5, 'rows')


def test_reset_stops_and_start_begins_again(station):
    station = station()
    station.add_node()
    assert not station.graph.call('rorapid_tracker/start').success
    station.send_info()
    station.send_start()
    station.graph.spin_for(0.2)
    station.track(range(3))
    assert station.graph.call('rorapid_tracker/reset').success
    count = len(station.poses)
    station.send(3)
    station.graph.spin_for(0.3)
    assert len(station.poses) == count
    assert station.graph.call('rorapid_tracker/start').success
    station.track(range(3))
    assert station.last_error()[1] < 0.01


def test_bad_input_is_told_in_a_sentence_and_the_node_goes_on(station):
    station = station()
    node = station.add_node()
    said = []
    node.get_logger().warning = lambda text, **_: said.append(text)
    node.get_logger = lambda logger=node.get_logger(): logger

    def hear(words, action):
        before = len(station.poses)
        said.clear()
        action()
        station.graph.wait_for(lambda: any(words in text for text in said), 5.0, words)
        assert len(station.poses) == before

    size = station.recording.camera
    hear('no calibration of the camera yet', lambda: station.send(0))
    half = Camera(size.K, size.distortion, 160, 120)
    station.send_info(half)
    station.graph.spin_for(0.2)
    hear('no start pose yet', lambda: station.send(0))

    def broken():
        msg = pose_with_covariance_message(np.eye(3, 4), np.eye(6), station.header(0),
                                           station.types)
        msg.pose.pose.position.x = float('nan')
        station.start.publish(msg)

    hear('not finite', broken)
    hear('behind the camera', lambda: station.send_start(np.column_stack([np.eye(3), [0, 0, -1]])))
    hear('frame', lambda: station.send_start(frame='map'))
    station.send_start()
    station.graph.spin_for(0.2)
    hear('calibration for 160x120', lambda: station.send(0))
    station.send_info()
    station.graph.spin_for(0.2)
    hear('1x1', lambda: station.send(0, np.zeros((1, 1), np.uint8)))
    station.track(range(4))
    hear('older', lambda: station.send(1))
    black = np.zeros_like(station.images[0])
    for k in range(4, 9):
        station.send(k, black)
        station.graph.spin_for(0.05)
    station.graph.wait_for(lambda: station.states and station.states[-1].data.startswith('lost'))
    uncalibrated = CameraInfo(width=320, height=240)
    hear('not calibrated', lambda: station.info.publish(uncalibrated))
    # and it goes on
    station.graph.call('rorapid_tracker/start')
    jump = int(station.recording.stamps_ns[-1]) + OFFSET_NS
    for k in range(3):
        station.send(k, header=header_message(jump + k * 33_333_333, FRAME, station.types))
        station.graph.spin_for(0.1)
    station.graph.wait_for(lambda: station.states[-1].data.startswith('tracking'))


def test_a_start_in_another_frame_that_came_before_any_image_is_dropped(station):
    station = station()
    node, said = station.add_node(), []
    node.get_logger().warning = lambda text, **_: said.append(text)
    node.get_logger = lambda logger=node.get_logger(): logger
    station.send_info()
    station.send_start(frame='map')
    station.graph.spin_for(0.2)
    station.send(0)
    station.graph.wait_for(lambda: any("'map'" in text and repr(FRAME) in text for text in said),
                           5.0, 'a warning that names both frames')
    station.graph.wait_for(lambda: any('no start pose yet' in text for text in said), 5.0,
                           'images without a start')
    assert not station.poses
    station.send_start()
    station.graph.spin_for(0.2)
    station.track(range(3))


def test_a_loss_is_told_gives_no_pose_and_ends_where_the_object_is_back(station):
    station = station()
    station.add_node()
    station.send_info()
    station.send_start()
    station.graph.spin_for(0.3)
    station.track(range(5))
    # the lens is covered
    for k in range(5, 10):
        station.send(k, np.zeros_like(station.images[0]))
        station.graph.spin_for(0.05)
    station.graph.wait_for(lambda: station.states[-1].data.startswith('lost: '), what='the loss')
    station.graph.wait_for(lambda: any(one.status[0].level == b'\x02'
                                       for one in station.diagnostics), what='ERROR')
    assert station.diagnostics[-1].status[0].message
    before = len(station.poses)
    station.send(10, np.zeros_like(station.images[0]))
    station.graph.spin_for(0.3)
    assert len(station.poses) == before
    # and uncovered: it is found again without being told where
    after = int(station.recording.stamps_ns[10])
    for k in range(1, 40):
        station.send(4, header=header_message(after + k * 33_333_333, FRAME, station.types))
        station.graph.spin_for(0.05)
        if len(station.poses) > before and station.states[-1].data.startswith('tracking'):
            break
    pose = pose_matrix(station.poses[-1])
    angle, share = pose_errors(pose[:3, :3], pose[:3, 3], station.recording.rotations[4],
                               station.recording.translations[4])
    assert np.rad2deg(angle) < 1 and share < 0.02


@pytest.mark.parametrize('parameters, error, words', [
    ([], ArgumentError, 'needs the shape'),
    (['model:=/nowhere.cao'], InputError, 'nowhere.cao'),
    (['model:=MODEL', 'start_pose:=1 2 3'], ArgumentError, 'six finite numbers'),
    (['model:=MODEL', 'start_pose:=0 0 nan 0 0 0'], ArgumentError, 'six finite numbers'),
    (['model:=MODEL', 'start_pose:=0 0 -1 0 0 0'], InputError, 'behind the camera'),
    (['model:=MODEL', 'camera_file:=/nowhere.yaml'], InputError, 'nowhere.yaml'),
    (['model:=MODEL', 'motion:=sideways'], ArgumentError, 'motion'),
    (['model:=MODEL', 'plane_axis:=1 2'], ArgumentError, 'plane_axis'),
    (['model:=BROKEN'], InputError, 'point')])
def test_a_node_that_cannot_work_says_why(graph, model, tmp_path, parameters, error, words):
    broken = tmp_path / 'broken.cao'
    broken.write_text('V1\n3\n0 0 0\n1 0 0\n0 1 0\n0\n0\n1\n3 0 1 7\n0\n0\n', encoding='utf-8')
    words_given = [word.replace('MODEL', str(model)).replace('BROKEN', str(broken))
                   for parameter in parameters for word in ('-p', parameter)]
    graph(*words_given)
    with pytest.raises(error, match=words):
        ObjectTrackerNode()


def test_interface_is_what_is_written(graph, model):
    from test_support.node_interfaces import has, written
    node = graph('-p', f'model:={model}', '-p', 'camera_model:=zoom', '-p',
                 'depth:=true').add(ObjectTrackerNode())
    expected = {end for end in written('rorapid_tracker') if end[1] != '/tf'}
    assert has(node) == expected
    assert any(end.name == '/tf' for end in INTERFACES['rorapid_tracker'])


def test_a_refused_setting_changes_nothing_and_the_next_camera_info_counts(station, monkeypatch):
    station = station('camera_model:=zoom')
    station.add_node()
    station.send_info()
    station.send_start()
    station.graph.spin_for(0.3)
    cameras = station.graph.listen(CameraInfo, 'rorapid_tracker/camera_info')
    station.track(range(3))
    monkeypatch.setattr('selfcal_ros.rorapid.visibility.visible_model.MAX_TESTS', 2000)
    refused, = station.graph.set_parameters('rorapid_tracker', control_points_per_line=200)
    assert 'too many to be tested' in refused
    K = station.recording.camera.K.copy()
    K[0, 2] += 5
    station.send_info(Camera(K, station.recording.camera.distortion, 320, 240))
    station.graph.spin_for(0.3)
    cameras.clear()
    station.track(range(3, 5))
    station.graph.wait_for(lambda: cameras)
    assert cameras[-1].k[2] == K[0, 2]
    # the pose is that of the camera in the header: five pixels further to the left
    pose, index = pose_matrix(station.poses[-1]), 4
    true = station.recording.translations[index]
    shift = 5 * true[2] / K[0, 0]
    assert abs(pose[0, 3] - (true[0] - shift)) < 0.3 * shift


def test_two_objects_have_topics_of_their_own(graph, tmp_path):
    made = objects_beside(('cube', 'l_block'), 4, size=(320, 240), supersampling=2)
    paths = [write_model(one.model, tmp_path / f'{name}.yaml')
             for one, name in zip(made.objects, ('cube', 'bracket'))]
    camera_file = write_camera_yaml(tmp_path / 'camera.yaml', made.objects[0].camera, 'camera')
    start = ' '.join(f'{x:.6f}' for x in (*made.objects[0].translations[0],
                                          *rotation_vector(made.objects[0].rotations[0])))
    graph = graph('-p', f'model:={paths[0]},{paths[1]}', '-p', f'start_pose:="{start};"',
                  '-p', f'camera_file:={camera_file}')
    probe, types = graph.probe, rclpy_types()
    poses = {name: graph.listen(PoseWithCovarianceStamped, f'{name}/pose')
             for name in ('cube', 'bracket')}
    states = graph.listen(String, 'rorapid_tracker/bracket/state', LATCHED)
    diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
    images = probe.create_publisher(Image, 'image', 10)
    begin = probe.create_publisher(PoseWithCovarianceStamped, 'bracket/initialpose', 10)
    graph.add(ObjectTrackerNode())
    graph.wait_for(lambda: images.get_subscription_count() and begin.get_subscription_count())

    def send(index, frame):
        header = header_message(int(made.objects[0].stamps_ns[index]), FRAME, types)
        images.publish(image_message(frame, header, types))

    frames = made.frames()
    send(0, frames[0])
    graph.wait_for(lambda: poses['cube'], what='pose of the cube')
    assert not poses['bracket']
    pose = np.column_stack([made.objects[1].rotations[1], made.objects[1].translations[1]])
    begin.publish(pose_with_covariance_message(
        pose, np.eye(6), header_message(0, FRAME, types), types))
    graph.spin_for(0.3)
    for index in (1, 2, 3):
        known = [len(poses[name]) for name in poses]
        send(index, frames[index])
        graph.wait_for(lambda: [len(poses[name]) for name in poses] > known and all(
            len(heard) > k for heard, k in zip(poses.values(), known)), what='both poses')
    for one, heard in zip(made.objects, poses.values()):
        pose = pose_matrix(heard[-1])
        angle, share = pose_errors(pose[:3, :3], pose[:3, 3], one.rotations[3],
                                   one.translations[3])
        assert np.rad2deg(angle) < 1.5 and share < 0.02
        assert stamp_ns(heard[-1].header.stamp) == one.stamps_ns[3]
    assert states[-1].data.startswith('tracking')
    graph.wait_for(lambda: diagnostics, what='diagnostics')
    assert {status.name for status in diagnostics[-1].status} == {
        'rorapid_tracker: tracking cube', 'rorapid_tracker: tracking bracket'}


def test_depth_images_tell_the_size_of_the_object(station):
    station = station('depth:=true')
    depth = station.graph.probe.create_publisher(Image, 'depth', 10)
    station.add_node()
    station.graph.wait_for(depth.get_subscription_count)
    station.send_info()
    station.send_start()
    station.graph.spin_for(0.3)
    made = station.recording
    corners = made.model.vertices[made.model.triangles] / 1.04
    station.send(0)
    station.graph.wait_for(lambda: station.poses, what='a pose without any depth')
    for index in range(1, VIEWS):
        pose = made.cam_from_world[index].copy()
        pose[:, 3] /= 1.04
        seen = depth_of(corners, pose, made.camera, np.random.default_rng(index), 1.5)
        depth.publish(image_message(np.rint(1000 * seen).astype(np.uint16), station.header(index),
                                    station.types, '16UC1'))
        station.graph.spin_for(0.05)
        station.track([index])
    station.graph.wait_for(lambda: 'too large' in station.states[-1].data, what='the finding')
    assert 'The depth images say that the model is 4.' in station.states[-1].data
