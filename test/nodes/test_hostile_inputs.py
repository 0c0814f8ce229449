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
"""Messages, files and arguments that no sound program sends: they cost themselves, not a node."""

import sys
from types import ModuleType, SimpleNamespace

import cv2
from msg_adapters.camera_info import camera_info_message
from msg_adapters.clouds import cloud_message
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import transform_message
from msg_adapters.stamps import header_message
from msg_adapters.tracks import LARGEST_SIDE_PX, tracks_from_message
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.camera_info_input import CameraInfoInput
from selfcal_ros.nodes.camera_info_node import CameraInfoPublisher
from selfcal_ros.nodes.feature_tracker_node import FeatureTrackerNode
from selfcal_ros.nodes.launch_arguments import launch_problem, shared_topic_problem
from selfcal_ros.nodes.launch_hooks import look_at_arguments
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.nodes.player_node import BagPlayer
from selfcal_ros.nodes.rig_inputs import RigInputs
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.values.transform_tree import TransformTree
from sensor_msgs.msg import CompressedImage, Image

TYPES = rclpy_types()
START_NS = 1_700_000_000_000_000_000


def tracks_of(stamp_ns=START_NS, size=(640, 480), kind='u2', x=None):
    """Build tracks whose size has a type of its own."""
    points = np.zeros(30, [('x', 'f8'), ('y', 'f8'), ('id', 'u4'), ('image_width', kind),
                           ('image_height', kind)])
    points['id'] = np.arange(30)
    points['x'], points['y'] = np.random.default_rng(0).uniform(0, 400, (2, 30))
    if x is not None:
        points['x'][7] = x
    points['image_width'], points['image_height'] = size
    return cloud_message(points, header_message(stamp_ns, 'camera', TYPES), TYPES)


@pytest.mark.parametrize('wrong, words', [
    ({'x': 2e6}, 'Point 7 .* 2e\\+06 pixels off the image'),
    ({'x': -1e300}, 'off the image'),
    *(({'kind': 'f8', 'size': (size, size)}, 'must be integers')
      for size in (np.nan, np.inf, 1e30, 0.5, 640)),
    ({'kind': 'u4', 'size': (2 ** 32 - 1, 480)}, 'cannot be 4294967295 x 480'),
    ({'kind': 'i2', 'size': (640, -480)}, 'cannot be 640 x -480')])
def test_tracks_that_no_image_has_are_dropped_with_a_reason(graph, wrong, words):
    with pytest.raises(InputError, match=words):
        tracks_from_message(tracks_of(**wrong))
    assert len(tracks_from_message(tracks_of(x=-5e5, kind='u4')).track) == 30
    graph = graph()
    node = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
    node._on_tracks(tracks_of(), {})
    for k in range(1, 4):
        node._on_tracks(tracks_of(START_NS + k * 10 ** 8, **wrong), {})
    assert node._session.snapshot().frames == 1
    node._session.request()


def test_an_image_that_tracks_cannot_tell_of_is_dropped(graph):
    node = graph('-p', 'lazy:=false').add(FeatureTrackerNode())
    wide = np.zeros((64, LARGEST_SIDE_PX + 1), np.uint8)
    message = CompressedImage(header=header_message(START_NS, 'camera', TYPES), format='png')
    message.data.frombytes(cv2.imencode('.png', wide)[1].tobytes())
    listened = []
    node.listeners.append(SimpleNamespace(announce=lambda *image: listened.append(image)))
    node._follow(message)
    assert not listened


class Heard:
    """What a node has logged."""

    def __init__(self, graph):
        self._messages = graph.listen(Log, '/rosout')

    def count(self, words):
        return sum(words in one.msg for one in self._messages)


def test_a_file_that_goes_away_leaves_its_calibration_in_force_and_the_log_says_so(
        graph, tmp_path):
    path = write_camera_yaml(tmp_path / 'served.yaml', Camera(
        np.array([[520.0, 0, 320], [0, 520, 240], [0, 0, 1]]), [0.0] * 5, 640, 480), 'camera')
    graph = graph('-p', f'camera_info_url:={path}')
    heard = Heard(graph)
    node = graph.add(CameraInfoPublisher())
    path.unlink()
    graph.wait_for(lambda: heard.count('does not exist: the last calibration stays in force'))
    assert node._camera is not None and not heard.count('K is zero')


def test_a_gap_that_no_recording_has_is_not_waited_for(graph, tmp_path):
    year_ns = 365 * 86400 * 10 ** 9
    stamps = [START_NS + k * 50_000_000 + year_ns * (k > 2) for k in range(6)]
    write_image_bag(tmp_path / 'bag', [
        Frame(k, stamp, np.full((48, 64), 20 * k, np.uint8), 'camera')
        for k, stamp in enumerate(stamps)])
    graph = graph('-p', f'bag:={tmp_path / "bag"}')
    heard = Heard(graph)
    images = graph.listen(Image, 'image')
    player = graph.add(BagPlayer())
    graph.wait_for(player.finished.done)
    graph.wait_for(lambda: len(images) == 6)
    graph.wait_for(lambda: heard.count('the next image is 31536000 s later') == 1)


def test_the_home_folder_is_found_by_launch_files_and_by_nodes(graph, monkeypatch, tmp_path):
    monkeypatch.setenv('HOME', str(tmp_path))
    for name in ('cube.cao', 'lid.stl'):
        (tmp_path / name).touch()
    assert launch_problem({'model': '~/cube.cao, ~/lid.stl'}) == ''
    assert launch_problem({'model': f'{tmp_path}/cube.cao,{tmp_path}/lid.stl'}) == ''
    assert launch_problem({'model': '~/cube.cao,~/nut.cao'}) == (
        f'model:={tmp_path}/nut.cao: there is no such file or folder.')
    assert 'empty place' in launch_problem({'model': '~/cube.cao,,'})
    write_image_bag(tmp_path / 'bag', [Frame(0, START_NS, np.zeros((48, 64), np.uint8), 'c')])
    assert launch_problem({'bag': '~/bag'}) == ''
    graph('-p', 'bag:=~/bag').add(BagPlayer())


def test_several_cameras_share_no_topic_and_no_service():
    for name in ('image', 'camera_info', 'driver_camera_info', 'set_camera_info_service'):
        values = {name: '/left/set_camera_info'}
        assert shared_topic_problem(['left', 'right'], values) == (
            f'{name}:=/left/set_camera_info: 2 cameras cannot share it; name it relative to the '
            'namespace of each, such as set_camera_info.')
        assert shared_topic_problem(['left', 'left'], values) == ''
        assert shared_topic_problem(['left', 'right'], {name: 'set_camera_info'}) == ''


def test_a_launch_file_finds_the_home_folder_of_its_parameters(monkeypatch, tmp_path):
    class Action:
        def __init__(self, function):
            self.look = function

    class Configuration:
        def __init__(self, name):
            self._name = name

        def perform(self, context):
            return context.launch_configurations[self._name]

    for name, values in (('launch', {}), ('launch.actions', {'OpaqueFunction': Action}),
                         ('launch.substitutions', {'LaunchConfiguration': Configuration})):
        module = ModuleType(name)
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'own.yaml').touch()
    given = {'params_file': '~/own.yaml', 'set_camera_info_service': '/left/set_camera_info'}
    context = SimpleNamespace(launch_configurations=given)
    look = look_at_arguments(['params_file', 'set_camera_info_service']).look
    look(context)
    assert given['params_file'] == str(tmp_path / 'own.yaml')


@pytest.mark.parametrize('name', ['my odom', '/1st/odom', '/odom//x'])
def test_poses_on_a_topic_that_cannot_be_are_refused(graph, name):
    graph('-p', f"robot:='{name}'")
    with pytest.raises(ArgumentError, match=f"robot cannot be '{name}': .*; name a topic, such"):
        CalibratorNode('planar_calibrator', PlanarCalibratorParameters)


def test_a_bad_static_transform_costs_the_cameras_of_a_rig_nothing():
    said, looked = [], []
    logger = SimpleNamespace(warning=lambda text, **_: said.append(text))
    inputs = RigInputs.__new__(RigInputs)
    inputs._node = SimpleNamespace(get_logger=lambda: logger)
    inputs._tree = TransformTree()
    inputs._look = lambda: looked.append(inputs._tree.frames)
    sent = [transform_message(np.eye(4), header_message(0, 'base', TYPES), name, TYPES)
            for name in ('left', 'gripper', 'right')]
    sent[1].transform.rotation.w = 0.0
    inputs._on_static(SimpleNamespace(transforms=sent))
    assert looked == [['base', 'left', 'right']]
    assert said[0].startswith('/tf_static: gripper in base at 0.000 s: The quaternion')


def test_a_camera_that_zooms_does_not_fill_the_log(graph, capfd):
    taken = []
    heard = CameraInfoInput(graph().probe, 'camera_info', taken.append)
    for k in range(100):
        heard._hear(camera_info_message(Camera(np.diag([500.0 + k, 500.0 + k, 1.0]), (), 640, 480),
                                        header_message(k, 'eye', TYPES), TYPES))
    assert len(taken) == 100 and taken[-1].K[0, 0] == 599
    assert 1 <= capfd.readouterr().err.count('calibration for 640x480 pixels') < 10
