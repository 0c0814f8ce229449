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
"""A calibration on its way to drivers and consumers: windows, files, services."""

import json
import shutil

from msg_adapters.camera_info import camera_info_message, image_camera_from_info, ImageWindow
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_message
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.camera_info_node import CameraInfoPublisher
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.report.camera_yaml import read_camera_yaml, write_camera_yaml
from selfcal_ros.synthetic.special_scenes import drive
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import String

TYPES = rclpy_types()
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
OPTIONS = ('-p', 'keyframe_parallax:=0.001', '-p', 'first_estimate:=12', '-p', 'idle_s:=0.3',
           '-p', 'distortion:=none')
CAMERA = Camera(np.array([[520.0, 0, 321.5], [0, 521, 238], [0, 0, 1]]),
                [-0.1, 0.02, 0.001, 0, 0], 640, 480)


def camera_file(tmp_path, camera=CAMERA, name='camera'):
    """Write a file where drivers look."""
    folder = tmp_path / 'ros_home' / 'camera_info'
    folder.mkdir(parents=True, exist_ok=True)
    return write_camera_yaml(folder / f'{name}.yaml', camera, name)


def header(seconds, frame='camera_optical_frame'):
    return header_message(seconds * 10 ** 9 + 7, frame, TYPES)


def exchange(graph, publisher, message, heard):
    """Publish until something new is heard; the first may be lost while the sides connect."""
    for _ in range(100):
        known = len(heard)
        publisher.publish(message)
        try:
            graph.wait_for(lambda: len(heard) > known, 0.3)
            return heard[-1]
        except AssertionError:
            continue
    raise AssertionError('nothing was heard')


class Drive:
    """A calibrator that has been fed with the tracks of a drive, and is calibrated."""

    def __init__(self, graph, window=ImageWindow(), full=(0, 0)):
        self.graph = graph
        self.scene = drive(np.random.default_rng(11), noise_px=0.1, views=20, tracks=300)
        self.node = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
        self.infos = graph.listen(CameraInfo, 'camera_info')
        self.results = graph.listen(String, 'planar_calibrator/result', LATCHED)
        self.driver = graph.probe.create_publisher(CameraInfo, 'driver/camera_info', 10)
        self.tracks = graph.probe.create_publisher(PointCloud2, 'tracks', 10)
        graph.wait_for(lambda: self.driver.get_subscription_count() > 0
                       and self.tracks.get_subscription_count() > 0)
        graph.meet(self.node)
        if not window.is_full:
            self.tell(window, full)
        for frame in range(20):
            self.play(frame)
        graph.wait_for(lambda: any(json.loads(r.data)['status'] == 'calibrated'
                                   for r in self.results), 60, 'calibration')

    def tell(self, window, full):
        """Publish the driver's CameraInfo: no calibration, but a window."""
        self.driver.publish(camera_info_message(None, header(1), TYPES, full, window))
        self.graph.spin_for(0.1)

    def play(self, frame):
        """Publish the tracks of one view; returns its CameraInfo."""
        mask = self.scene.tracks.frame == frame
        message = tracks_message(self.scene.tracks.track[mask], self.scene.tracks.xy[mask],
                                 self.scene.tracks.image_size, header(100 + frame), TYPES)
        return exchange(self.graph, self.tracks, message, self.infos)


def test_binning_and_region_give_the_full_sensor_and_the_image_its_own(graph, tmp_path):
    window = ImageWindow(2, 2, 200, 100, 1280, 960)
    on_road = Drive(graph(*OPTIONS), window, (1600, 1200))
    truth = on_road.scene.camera
    info = on_road.play(19)
    assert (info.width, info.height, info.binning_x, info.roi.x_offset) == (1600, 1200, 2, 200)
    # fx_full = 2 fx, cx_full = 2 cx + offset, as image_geometry has it
    assert info.k[0] == pytest.approx(2 * truth.K[0, 0], rel=0.01)
    assert info.k[2] == pytest.approx(2 * truth.K[0, 2] + 200, abs=20)
    seen = image_camera_from_info(info)
    assert (seen.width, seen.height) == (truth.width, truth.height)
    assert seen.K[0, 0] == pytest.approx(truth.K[0, 0], rel=0.01)
    assert on_road.graph.call('planar_calibrator/save').success
    path = tmp_path / 'ros_home' / 'camera_info' / 'camera.yaml'
    camera, _ = read_camera_yaml(path)
    assert (camera.width, camera.height) == (1600, 1200) and camera.K[0, 0] == info.k[0]
    assert 'binned or cropped to 640x480' in path.read_text(encoding='utf-8')
    # another part of the sensor, of the same size: what was known does not hold for it
    on_road.tell(ImageWindow(2, 2, 0, 0, 1280, 960), (1600, 1200))
    assert not on_road.play(19).k.any()
    on_road.graph.wait_for(
        lambda: 'region of interest' in json.loads(on_road.results[-1].data)['reason'])


@pytest.mark.long
def test_a_driver_that_contradicts_its_images_is_not_believed(graph):
    on_road = Drive(graph(*OPTIONS), ImageWindow(4, 4), (1600, 1200))
    info = on_road.play(19)
    assert (info.width, info.binning_x) == (640, 0)
    assert info.k[0] == pytest.approx(on_road.scene.camera.K[0, 0], rel=0.01)


class Driver(Node):
    """Has a set_camera_info service, as camera drivers do."""

    def __init__(self, name):
        super().__init__(name)
        self.taken, self.takes = [], True
        self.create_service(SetCameraInfo, '~/set_camera_info', self._on_set)

    def _on_set(self, request, response):
        self.taken.append(request.camera_info)
        response.success, response.status_message = self.takes, 'no room'
        return response


class Logged:
    """What was logged so far."""

    def __init__(self, capfd):
        self._capfd, self._text = capfd, ''

    def count(self, words):
        self._text += self._capfd.readouterr().err
        return self._text.count(words)


@pytest.mark.long
def test_a_missing_set_camera_info_service_costs_a_warning_and_a_driver_is_served(
        graph, tmp_path, capfd):
    graph = graph(*OPTIONS, '-p', 'set_camera_info_service:=camera/set_camera_info')
    logged = Logged(capfd)
    graph.add(Driver('another'))
    on_road = Drive(graph)
    # the file is written, whatever becomes of the upload
    for _ in range(2):
        answer = graph.call('planar_calibrator/save')
        assert answer.success and '/camera/set_camera_info is not there' in answer.message
    assert 'services of this type: /another/set_camera_info' in answer.message
    assert (tmp_path / 'ros_home/camera_info/camera.yaml').is_file()
    graph.wait_for(lambda: logged.count('camera/set_camera_info is not there') == 1)
    # a driver that comes late
    driver = graph.add(Driver('camera'))
    graph.wait_for(lambda: 'sent to /camera' in graph.call('planar_calibrator/save').message)
    graph.wait_for(lambda: logged.count('has taken the calibration'))
    assert driver.taken[-1].k[0] == on_road.play(19).k[0]
    assert (driver.taken[-1].width, driver.taken[-1].height) == (640, 480)
    assert logged.count('is not there') == 1, 'once, not at each save'
    driver.takes = False
    assert graph.call('planar_calibrator/save').success
    graph.wait_for(lambda: logged.count('refused the calibration: no room'))


@pytest.mark.long
def test_a_file_that_cannot_be_written_loses_nothing(graph, tmp_path, capfd):
    graph = graph(*OPTIONS, '-p', f'output:={tmp_path}/folder/camera.yaml', '-p',
                  'auto_save:=true')
    on_road = Drive(graph)
    # the folder goes, and cannot be made again
    shutil.rmtree(tmp_path / 'folder')
    (tmp_path / 'folder').write_text('no folder', encoding='utf-8')
    logged = Logged(capfd)
    answer = graph.call('planar_calibrator/save')
    assert not answer.success and 'cannot be made' in answer.message
    assert on_road.play(19).k[0] == json.loads(on_road.results[-1].data)['camera']['fx']
    assert not logged.count('Traceback')


def test_a_file_is_served_with_the_stamp_and_the_window_of_the_driver(graph, tmp_path):
    camera_file(tmp_path)
    graph = graph()
    infos = graph.listen(CameraInfo, 'camera_info')
    driver = graph.probe.create_publisher(CameraInfo, 'driver/camera_info', 10)
    graph.add(CameraInfoPublisher())
    window = ImageWindow(2, 2, 64, 32, 320, 240)
    message = camera_info_message(None, header(5, 'left_optical_frame'), TYPES, (640, 480), window)
    info = exchange(graph, driver, message, infos)
    assert info.header == message.header and info.roi == message.roi and info.binning_y == 2
    assert np.array_equal(info.k, CAMERA.K.ravel()) and np.array_equal(info.d, CAMERA.distortion)
    assert (info.width, info.height) == (640, 480)


@pytest.mark.parametrize('model, d', [
    ('equidistant', [-0.02, 0.006, -0.004, 5e-4]),
    ('rational_polynomial', [0.78, 0.07, 1e-3, -2e-3, 0.001, 1.11, 0.24, 0.002])])
def test_wide_lenses_are_served_and_set(graph, tmp_path, model, d):
    camera = Camera(CAMERA.K, d, 640, 480, model)
    camera_file(tmp_path, camera)
    graph = graph()
    infos = graph.listen(CameraInfo, 'camera_info')
    driver = graph.probe.create_publisher(CameraInfo, 'driver/camera_info', 10)
    graph.add(CameraInfoPublisher())
    message = camera_info_message(None, header(5), TYPES, (640, 480))
    served = exchange(graph, driver, message, infos)
    assert served.distortion_model == model and list(served.d) == d
    client = graph.probe.create_client(SetCameraInfo, 'camera_info_publisher/set_camera_info')
    graph.wait_for(client.service_is_ready)
    for info, words in ((camera_info_message(camera, header(6), TYPES), 'in force'),
                        (CameraInfo(width=640, height=480, distortion_model=model, d=[*d, 0.1],
                                    k=CAMERA.K.ravel()), f'not {len(d) + 1}')):
        future = client.call_async(SetCameraInfo.Request(camera_info=info))
        graph.wait_for(future.done)
        assert words in future.result().status_message
    assert read_camera_yaml(tmp_path / 'ros_home/camera_info/camera.yaml')[0].model == model


def test_a_size_that_the_file_is_not_for_is_refused_by_zeros(graph, tmp_path):
    camera_file(tmp_path)
    graph = graph('-p', 'source:=image')
    infos = graph.listen(CameraInfo, 'camera_info')
    images = graph.probe.create_publisher(Image, 'image', 5)
    graph.add(CameraInfoPublisher())
    right = exchange(graph, images, Image(header=header(5), width=640, height=480), infos)
    assert right.k[0] == 520 and right.header == header(5)
    wrong = exchange(graph, images, Image(header=header(6), width=320, height=240), infos)
    assert not wrong.k.any() and (wrong.width, wrong.height) == (320, 240)


@pytest.mark.long
def test_a_file_that_comes_later_or_changes_is_followed(graph, tmp_path):
    graph = graph('-p', 'camera_name:=front')
    infos = graph.listen(CameraInfo, 'camera_info')
    driver = graph.probe.create_publisher(CameraInfo, 'driver/camera_info', 10)
    graph.add(CameraInfoPublisher())
    message = camera_info_message(None, header(5), TYPES, (640, 480))
    assert not exchange(graph, driver, message, infos).k.any()

    def focal():
        return exchange(graph, driver, message, infos).k[0]

    camera_file(tmp_path, name='front')
    graph.wait_for(lambda: focal() == 520, what='file')
    (tmp_path / 'ros_home/camera_info/front.yaml').write_text('%YAML:1.0\n', encoding='utf-8')
    graph.spin_for(1.2)
    assert focal() == 520, 'a broken file replaces nothing'
    other = Camera(CAMERA.K @ np.diag([1.1, 1.1, 1]), CAMERA.distortion, 640, 480)
    camera_file(tmp_path, other, 'front')
    graph.wait_for(lambda: focal() == other.K[0, 0], what='changed file')


def test_the_publisher_stands_in_for_a_driver_without_the_service(graph, tmp_path):
    graph = graph()
    infos = graph.listen(CameraInfo, 'camera_info')
    driver = graph.probe.create_publisher(CameraInfo, 'driver/camera_info', 10)
    graph.add(CameraInfoPublisher())
    client = graph.probe.create_client(SetCameraInfo, 'camera_info_publisher/set_camera_info')
    graph.wait_for(client.service_is_ready)

    def set_to(info):
        future = client.call_async(SetCameraInfo.Request(camera_info=info))
        graph.wait_for(future.done)
        return future.result()

    refused = set_to(CameraInfo())
    assert not refused.success and 'no calibration' in refused.status_message
    # a mirrored axis, and a K of another scale
    for place, number in ((0, -520.0), (4, 0.0), (8, 2.0), (6, 1.0)):
        wrong = camera_info_message(CAMERA, header(1), TYPES)
        # some rclpy give a copy of the array, or one that is not to be written
        wrong.k = np.where(np.arange(9) == place, number, wrong.k)
        refused = set_to(wrong)
        assert not refused.success and 'no calibration matrix' in refused.status_message
    assert not (tmp_path / 'ros_home/camera_info/camera.yaml').exists()
    assert set_to(camera_info_message(CAMERA, header(1), TYPES)).success
    message = camera_info_message(None, header(5), TYPES, (640, 480))
    assert exchange(graph, driver, message, infos).k[0] == 520
    camera, name = read_camera_yaml(tmp_path / 'ros_home/camera_info/camera.yaml')
    assert name == 'camera' and np.array_equal(camera.K, CAMERA.K)


@pytest.mark.parametrize('model, d', [('double_sphere', [0.5, -0.2]),
                                      ('rational_polynomial', list(np.linspace(-0.1, 0.1, 14)))])
def test_what_is_not_understood_is_served_and_set_all_the_same(graph, tmp_path, model, d):
    # the right camera of a stereo pair, of a lens that we do not know
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    P = np.column_stack([0.9 * CAMERA.K, [-52.0, 0, 0]])
    given = CameraInfo(width=640, height=480, distortion_model=model, d=d, k=CAMERA.K.ravel(),
                       r=R.ravel(), p=P.ravel())
    graph = graph()
    infos = graph.listen(CameraInfo, 'camera_info')
    driver = graph.probe.create_publisher(CameraInfo, 'driver/camera_info', 10)
    node = graph.add(CameraInfoPublisher())
    client = graph.probe.create_client(SetCameraInfo, 'camera_info_publisher/set_camera_info')
    graph.wait_for(client.service_is_ready)
    future = client.call_async(SetCameraInfo.Request(camera_info=given))
    graph.wait_for(future.done)
    assert future.result().success, future.result().status_message
    message = camera_info_message(None, header(5), TYPES, (640, 480))
    # from memory, and from the file
    for _ in range(2):
        served = exchange(graph, driver, message, infos)
        assert served.distortion_model == model and list(served.d) == d
        assert np.array_equal(served.r, R.ravel()) and np.array_equal(served.p, P.ravel())
        node._camera = node._modified_ns = None
        node._look()
