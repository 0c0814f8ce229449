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
"""rorapid_tracker with several cameras: instants, places from a file or TF, and what is said."""

from importlib.util import find_spec

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from msg_adapters.camera_info import camera_info_message
from msg_adapters.image import image_message
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import pose_matrix, transform_message
from msg_adapters.stamps import header_message, stamp_ns
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.nodes import rig_inputs
from selfcal_ros.nodes.quality_of_service import LATCHED
from selfcal_ros.nodes.object_tracker_node import ObjectTrackerNode
from selfcal_ros.report.camera_files.kalibr_chain import kalibr_text
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic.objects import pose_errors
from selfcal_ros.synthetic.several_cameras import object_before_cameras, turned_camera
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from test_support.diagnostics_table import not_written
from test_support.node_interfaces import has, written

VIEWS, NAMES = 12, ('left', 'right')


@pytest.fixture(scope='module')
def rig():
    """Render a few images of two cameras, once."""
    recordings, cameras = object_before_cameras(VIEWS, 'l_block', seed=61, size=(320, 240),
                                                supersampling=2)
    return recordings, cameras, [[image for image, _ in one.frames()] for one in recordings]


def chain(path, cameras):
    text = ''
    for k, (one, name) in enumerate(zip(cameras, NAMES)):
        text += kalibr_text(one.camera, topic=f'/{name}/image').replace('cam0:', f'cam{k}:', 1)
    T = np.linalg.inv(cameras[1].T_rig_camera)
    rows = ''.join(f'  - [{", ".join(f"{x:.12g}" for x in row)}]\n' for row in T)
    path.write_text(text + f'  T_cn_cnm1:\n{rows}')
    return path


class Station:
    """Feeds a node with the images of two cameras, and hears what it says."""

    def __init__(self, graph, rig):
        self.graph, (self.recordings, self.cameras, self.images) = graph, rig
        self.types, probe = rclpy_types(), graph.probe
        self.poses = graph.listen(PoseWithCovarianceStamped, 'pose')
        self.states = graph.listen(String, 'rorapid_tracker/state', LATCHED)
        self.diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
        self.drawn = graph.listen(Image, 'rorapid_tracker/right/overlay', 1)
        self.image = [probe.create_publisher(Image, f'{name}/image', 10) for name in NAMES]
        self.info = [probe.create_publisher(CameraInfo, f'{name}/camera_info', 10)
                     for name in NAMES]

    def add_node(self):
        node = self.graph.add(ObjectTrackerNode())
        self.graph.wait_for(lambda: all(one.get_subscription_count() for one in (
            *self.image, *self.info)), what='subscriptions of the node')
        self.graph.wait_for(lambda: self.graph.probe.count_publishers('pose') > 0)
        return node

    def header(self, k, which):
        stamp = int(self.recordings[0].stamps_ns[k]) + 400_000 * which
        return header_message(stamp, f'{NAMES[which]}_optical_frame', self.types)

    def send(self, k, which):
        self.image[which].publish(image_message(self.images[which][k], self.header(k, which),
                                                self.types))

    def send_infos(self):
        for which, (publisher, one) in enumerate(zip(self.info, self.cameras)):
            publisher.publish(camera_info_message(one.camera, self.header(0, which), self.types))

    def wait_for_pose(self, count):
        self.graph.wait_for(lambda: len(self.poses) >= count, what=f'pose {count}')

    def errors(self):
        stamps = list(self.recordings[0].stamps_ns)
        truth, found = self.recordings[0], []
        for msg in self.poses:
            # an instant has the stamp of whichever camera was first
            k = int(np.abs(np.array(stamps) - stamp_ns(msg.header.stamp)).argmin())
            assert msg.header.frame_id == 'left_optical_frame'
            pose = pose_matrix(msg)
            found.append(pose_errors(pose[:3, :3], pose[:3, 3], truth.rotations[k],
                                     truth.translations[k]))
        return np.array(found)

    @property
    def status(self):
        return {one.key: one.value for one in self.diagnostics[-1].status[0].values}


@pytest.fixture
def station(graph, rig, tmp_path):
    """Start a node that knows the model and the start."""
    truth = rig[0][0]
    model = write_model(truth.model, tmp_path / 'l.yaml')
    start = tmp_path / 'start.pos'
    start.write_text(' '.join(map(str, [*truth.translations[0],
                                        *rotation_vector(truth.rotations[0])])))

    def make(*parameters):
        words = [word for parameter in (f'model:={model}', f'start_pose:={start}', *parameters)
                 for word in ('-p', parameter)]
        return Station(graph(*words), rig)

    return make


def test_one_pose_of_both_cameras_and_of_one_where_the_other_is_silent(station, rig, tmp_path):
    station = station('cameras:=left,right',
                      f'rig_file:={chain(tmp_path / "camchain.yaml", rig[1])}')
    station.add_node()
    for k in range(6):
        station.send(k, k % 2)
        station.send(k, 1 - k % 2)
        station.wait_for_pose(k + 1)
    assert station.states[-1].data.startswith('tracking')
    station.graph.wait_for(lambda: station.diagnostics and 'seen by right' in station.status)
    assert station.status['seen by left'] == station.status['seen by right'] == 'True'
    assert 'distances between the cameras' in station.status['size of the object']
    assert not not_written(station.status)
    station.graph.wait_for(lambda: station.drawn, what='overlay of the right camera')
    # the right one falls silent: it is waited for by 0.1 s of stamps, and then no longer
    for k in range(6, VIEWS):
        station.send(k, 0)
    station.graph.wait_for(lambda: stamp_ns(station.poses[-1].header.stamp) == int(
        station.recordings[0].stamps_ns[VIEWS - 1]), what='the newest image of the left one')
    angle, share = station.errors().T
    assert np.rad2deg(angle.max()) < 0.5 and share.max() < 0.005


class Transforms:
    """Stands for tf2_msgs/TFMessage where that is not installed."""

    def __init__(self, transforms):
        self.transforms = transforms


def test_places_come_from_tf_and_calibrations_from_camera_info(station, rig, monkeypatch):
    monkeypatch.setattr(rig_inputs, 'transform_type', lambda _: String)
    station = station('cameras:=left,right')
    node = station.add_node()
    station.send_infos()
    station.graph.wait_for(lambda: station.diagnostics and any(
        'TF has no static frame' in one.status[0].message for one in station.diagnostics))
    base = turned_camera(rig[1][1], 25.0).T_rig_camera
    for one, name in zip(rig[1], NAMES):
        header = header_message(0, 'base_link', station.types)
        node._inputs._on_static(Transforms([transform_message(
            (base @ one.T_rig_camera)[:3], header, f'{name}_optical_frame', station.types)]))
    for k in range(4):
        station.send(k, 0)
        station.send(k, 1)
        station.wait_for_pose(k + 1)
    angle, share = station.errors().T
    assert np.rad2deg(angle.max()) < 0.5 and share.max() < 0.005


def test_frames_have_a_slash_or_none_and_change_with_a_driver_that_comes_again(
        station, rig, monkeypatch):
    monkeypatch.setattr(rig_inputs, 'transform_type', lambda _: String)
    station = station('cameras:=left,right')
    node = station.add_node()
    base = turned_camera(rig[1][1], 25.0).T_rig_camera
    for one, name in zip(rig[1], NAMES):
        for frame in (f'{name}_optical_frame', f'{name}_again'):
            node._inputs._on_static(Transforms([transform_message(
                (base @ one.T_rig_camera)[:3], header_message(0, 'base_link', station.types),
                frame, station.types)]))
    made = station.header
    for k, frame in enumerate(['/{}_optical_frame'] * 2 + ['{}_again'] * 2):
        station.header = lambda k, which, frame=frame: header_message(
            stamp_ns(made(k, which).stamp), frame.format(NAMES[which]), station.types)
        if k == 0:
            station.send_infos()
            station.graph.wait_for(lambda: not node._inputs.problem, what='the places')
        station.send(k, 0)
        station.send(k, 1)
        station.wait_for_pose(k + 1)
    assert [one.header.frame_id for one in station.poses] == [
        '/left_optical_frame'] * 2 + ['left_again'] * 2


def test_images_without_stamps_are_named(station, rig, tmp_path):
    """They only counted as images that come too late."""
    station = station('cameras:=left,right',
                      f'rig_file:={chain(tmp_path / "chain.yaml", rig[1])}')
    node = station.add_node()
    station.send_infos()
    made = station.header
    station.header = lambda k, which: header_message(0, made(k, which).frame_id, station.types)
    station.send(0, 0)
    station.send(0, 1)
    station.graph.wait_for(lambda: 'left and right have no stamp' in node._inputs.problem)
    assert node._inputs.values['images too late'] == 0
    station.header = made
    station.send(0, 0)
    station.send(0, 1)
    station.wait_for_pose(1)
    assert 'stamp' not in node._inputs.problem


@pytest.mark.skipif(find_spec('tf2_msgs') is None, reason='tf2_msgs is not installed')
def test_places_come_from_a_publisher_of_tf_that_spoke_before(station, rig):
    from tf2_msgs.msg import TFMessage
    station = station('cameras:=left,right', 'publish_tf:=true')
    base = turned_camera(rig[1][1], 25.0).T_rig_camera
    header = header_message(0, 'base_link', station.types)
    station.graph.probe.create_publisher(TFMessage, '/tf_static', LATCHED).publish(
        TFMessage(transforms=[transform_message(
            (base @ one.T_rig_camera)[:3], header, f'{name}_optical_frame', station.types)
            for one, name in zip(rig[1], NAMES)]))
    sent = station.graph.listen(TFMessage, '/tf', 100)
    station.add_node()

    def lacks_infos():
        said = station.diagnostics
        return said and 'no camera_info' in said[-1].status[0].message
    station.graph.wait_for(lacks_infos, what='word that TF came and camera_info is missing')
    station.send_infos()
    station.graph.wait_for(lambda: not lacks_infos(), what='word that all is there')
    for k in range(4):
        station.send(k, 0)
        station.send(k, 1)
        station.wait_for_pose(k + 1)
    angle, share = station.errors().T
    assert np.rad2deg(angle.max()) < 0.5 and share.max() < 0.005
    station.graph.wait_for(lambda: len(sent) >= 4, what='the object in TF')
    for pose, message in zip(station.poses, sent):
        one, = message.transforms
        assert one.header == pose.header
        at, moved = pose.pose.pose.position, one.transform.translation
        assert (at.x, at.y, at.z) == (moved.x, moved.y, moved.z)


@pytest.mark.skipif(find_spec('tf2_msgs') is not None, reason='tf2_msgs is installed')
def test_places_without_a_file_need_the_messages_of_tf(station):
    station('cameras:=left,right')
    with pytest.raises(InputError, match='cameras needs the package tf2_msgs'):
        ObjectTrackerNode()


def test_topics_of_one_camera_are_those_of_each_with_its_name(station, rig, tmp_path):
    station = station('cameras:=left,right',
                      f'rig_file:={chain(tmp_path / "camchain.yaml", rig[1])}')
    expected = set()
    for way, topic, kind in written('rorapid_tracker'):
        words = topic.strip('/').split('/')
        if words[0] in ('image', 'camera_info') or words[-1] == 'overlay':
            at = topic.replace('/image', '/%/image', 1).replace('/camera_info', '/%/camera_info')
            at = at.replace('/overlay', '/%/overlay')
            expected |= {(way, at.replace('%', name), kind) for name in NAMES}
        elif topic not in ('/tf', '/depth', '/rorapid_tracker/camera_info'):
            expected.add((way, topic, kind))
    assert has(station.add_node()) == expected


def test_a_wrong_transform_makes_it_degraded_and_is_in_the_diagnostics(station, rig, tmp_path):
    wrong = [rig[1][0], turned_camera(rig[1][1], 2.0)]
    station = station('cameras:=left,right',
                      f'rig_file:={chain(tmp_path / "camchain.yaml", wrong)}')
    station.add_node()
    for k in range(VIEWS):
        station.send(k, 0)
        station.send(k, 1)
        station.wait_for_pose(k + 1)
    assert 'degraded' in station.states[-1].data
    station.graph.wait_for(lambda: any(
        'contradict each other' in one.status[0].message or 'elsewhere' in one.status[0].message
        for one in station.diagnostics))


@pytest.mark.parametrize('parameters, error, sentence', (
    (('cameras:=left',), ArgumentError, 'two or more cameras'),
    (('cameras:=left,left',), ArgumentError, 'two or more cameras'),
    (('rig_file:=a.yaml',), ArgumentError, 'rig_file needs the parameter cameras'),
    (('cameras:=left,right', 'depth:=true'), ArgumentError, 'depth is for a single camera'),
    (('cameras:=left,right', 'rig_file:=/nowhere.yaml'), InputError, 'nowhere'),
    (('cameras:=left,right', 'rig_sigma:=1 2 3'), ArgumentError, 'must be degrees and metres'),
    (('cameras:=left,right', 'motion:=translation'), ArgumentError, 'need motion general')))
def test_parameters_that_do_not_fit_are_one_sentence(station, parameters, error, sentence):
    station(*parameters)
    with pytest.raises(error, match=sentence):
        ObjectTrackerNode()
