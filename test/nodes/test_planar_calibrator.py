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
"""planar_calibrator: a CameraInfo for every tracks message, better as the drive goes on."""

import json
import re

from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.clouds import points_from_cloud
from msg_adapters.message_types import rclpy_types
from msg_adapters.poses import pose_matrix
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_message
from nav_msgs.msg import Path
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.report.camera_yaml import read_camera_yaml
from selfcal_ros.synthetic.hard_scenes import one_curve, vehicle
from selfcal_ros.synthetic.special_scenes import drive
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

STEP_NS = 200_000_000
START_NS = 1_700_000_000_123_456_789
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: The scene's views are few and far apart: every one is a keyframe.
OPTIONS = ('-p', 'keyframe_parallax:=0.001', '-p', 'first_estimate:=12', '-p', 'idle_s:=0.5',
           '-p', 'distortion:=none')


class Drive:
    """A calibrator, and a drive that is fed to it message by message."""

    def __init__(self, graph, sequence=None):
        self.graph = graph
        self.sequence = sequence or drive(np.random.default_rng(11), noise_px=0.1, views=20,
                                          tracks=400)
        node = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
        self.publisher = graph.probe.create_publisher(PointCloud2, 'tracks', 10)
        self.infos = graph.listen(CameraInfo, 'camera_info')
        self.results = graph.listen(String, 'planar_calibrator/result', LATCHED)
        self.diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
        self.structures = graph.listen(PointCloud2, 'structure', LATCHED)
        self.paths = graph.listen(Path, 'camera_path', LATCHED)
        self.markers = graph.listen(MarkerArray, 'planar_calibrator/markers', LATCHED)
        graph.wait_for(lambda: self.publisher.get_subscription_count() > 0)
        graph.wait_for(lambda: graph.probe.count_publishers('camera_info') > 0)
        graph.meet(node)

    def publish(self, frames, start_ns=START_NS):
        """Publish the tracks of frames; returns the headers."""
        headers = []
        camera, types = self.sequence.camera, rclpy_types()
        for frame in frames:
            mask = self.sequence.tracks.frame == frame
            headers.append(header_message(start_ns + int(frame) * STEP_NS, 'cam_optical', types))
            known = len(self.infos)
            self.publisher.publish(tracks_message(
                self.sequence.tracks.track[mask], self.sequence.tracks.xy[mask],
                (camera.width, camera.height), headers[-1], types))
            self.graph.wait_for(lambda: len(self.infos) > known, what='camera_info')
        return headers

    def calibrated(self):
        """Wait for a calibration."""
        self.graph.wait_for(lambda: any(json.loads(r.data)['status'] == 'calibrated'
                                        for r in self.results), 60, 'calibration')
        return [json.loads(r.data) for r in self.results
                if json.loads(r.data)['status'] == 'calibrated'][-1]


@pytest.fixture
def on_the_road(graph):
    return Drive(graph(*OPTIONS))


@pytest.mark.long
def test_a_hint_is_not_saved_and_the_answer_tells_it(graph, tmp_path):
    curve = vehicle(np.random.default_rng(1), one_curve(6, 6), count=60)
    bend = Drive(graph('-p', 'keyframe_parallax:=0.001', '-p', 'first_estimate:=6', '-p',
                       'distortion:=radial2'), curve)
    bend.publish(range(6))
    bend.graph.wait_for(lambda: any(json.loads(r.data)['status'] == 'hint' for r in bend.results),
                        60, 'hint')
    answer = bend.graph.call('planar_calibrator/save')
    assert not answer.success
    assert answer.message.startswith('there is no calibration yet: The camera turned by ')
    assert 'which suggests a focal length of' in answer.message
    assert not (tmp_path / 'ros_home' / 'camera_info').exists()
    # what is only suggested is served to nobody
    bend.publish([5], START_NS + STEP_NS)
    assert not bend.infos[-1].k.any()


def test_a_drive_is_calibrated_and_every_image_gets_its_camera_info(on_the_road, tmp_path):
    truth = on_the_road.sequence.camera
    headers = on_the_road.publish(range(11))
    assert [info.header for info in on_the_road.infos] == headers
    assert all(not info.k.any() and not info.p.any() for info in on_the_road.infos)
    assert {(info.width, info.height) for info in on_the_road.infos} == {(640, 480)}
    answer = on_the_road.graph.call('planar_calibrator/save')
    assert not answer.success and 'no calibration' in answer.message
    on_the_road.publish(range(11, 20))
    on_the_road.calibrated()
    # all that was gathered is used once nothing more comes, or on demand
    while not on_the_road.graph.call('planar_calibrator/calibrate').success:
        on_the_road.graph.spin_for(0.1)
    on_the_road.graph.wait_for(lambda: json.loads(on_the_road.results[-1].data)['frames']['count']
                               == 20, 60, 'estimate from everything')
    result = on_the_road.calibrated()
    for name, true in zip(('fx', 'fy', 'cx', 'cy'), truth.parameters):
        assert abs(result['camera'][name] - true) < 4 * result['sigma'][name], name
    headers = on_the_road.publish([19], START_NS + STEP_NS)
    info = on_the_road.infos[-1]
    assert info.header == headers[0]
    assert info.k[0] == result['camera']['fx'] and info.p[0] == info.k[0] and info.r[0] == 1
    assert info.distortion_model == 'plumb_bob'
    # written where camera drivers look, only when asked to
    path = tmp_path / 'ros_home' / 'camera_info' / 'camera.yaml'
    assert not path.exists()
    assert on_the_road.graph.call('planar_calibrator/save').success
    assert read_camera_yaml(path)[0].K[0, 0] == info.k[0]
    seen = len(on_the_road.diagnostics)
    on_the_road.graph.wait_for(lambda: len(on_the_road.diagnostics) > seen)
    status = on_the_road.diagnostics[-1].status[0]
    assert status.level == b'\x00' and status.hardware_id == 'camera'
    values = {v.key: v.value for v in status.values}
    assert float(values['fx']) == pytest.approx(info.k[0], 1e-4)
    assert values['calibration file'] == str(path)
    assert values['saved'] == 'True' and re.fullmatch(r'\d\d:\d\d:\d\d', values['saved at'])


def test_the_scene_is_published_in_steps_and_upright_and_cleared_on_reset(on_the_road):
    on_the_road.publish(range(20))
    on_the_road.calibrated()
    graph, sequence = on_the_road.graph, on_the_road.sequence
    graph.wait_for(lambda: on_the_road.markers and on_the_road.structures and on_the_road.paths)
    cloud, path = on_the_road.structures[-1], on_the_road.paths[-1]
    assert cloud.header.frame_id == path.header.frame_id == 'calibration_world_unscaled'
    assert cloud.header.stamp == path.poses[-1].header.stamp
    used = [(pose.header.stamp.sec * 10 ** 9 + pose.header.stamp.nanosec - START_NS) // STEP_NS
            for pose in path.poses]
    poses = np.array([pose_matrix(pose) for pose in path.poses])
    centres = poses[:, :3, 3]
    assert np.median(np.linalg.norm(np.diff(centres, axis=0), axis=1)) == pytest.approx(1)
    # z is up: the cameras' y axes point down, and the path keeps its height
    assert (poses[:, 2, 1] < -0.5).all() and np.ptp(centres[:, 2]) < 0.01 * len(centres)
    # the path is that of the scene, in its own unit
    true = sequence.cam_from_world[used]
    true = -np.einsum('vji,vj->vi', true[:, :, :3], true[:, :, 3])
    apart = np.linalg.norm(true[:, None] - true[None], axis=-1)
    found = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    step = np.median(np.linalg.norm(np.diff(true, axis=0), axis=1))
    assert np.allclose(found, apart / step, atol=0.02 * found.max())
    assert len(points_from_cloud(cloud)) > 300
    assert {marker.ns for marker in on_the_road.markers[-1].markers} == {
        'camera_path', 'camera_frustum', 'structure'}
    assert all(marker.color.a > 0 for marker in on_the_road.markers[-1].markers)
    assert graph.call('planar_calibrator/reset').success
    graph.wait_for(lambda: on_the_road.structures[-1].width == 0
                   and not on_the_road.paths[-1].poses
                   and on_the_road.markers[-1].markers[0].action == Marker.DELETEALL)
    # who comes late must not see what is void
    late = graph.listen(PointCloud2, 'structure', LATCHED)
    graph.wait_for(lambda: late)
    assert late[0].width == 0


@pytest.mark.long
@pytest.mark.parametrize('step_ns', [-250_000_000, 3600 * 10 ** 9])
def test_a_step_of_the_clock_leaves_the_calibration_in_force(on_the_road, step_ns):
    on_the_road.publish(range(20))
    result = on_the_road.calibrated()
    newest = START_NS + 19 * STEP_NS
    headers = on_the_road.publish([0], newest + step_ns)
    assert on_the_road.infos[-1].header == headers[0]
    # estimates go on meanwhile
    assert on_the_road.infos[-1].k[0] == pytest.approx(result['camera']['fx'], rel=0.02)
    assert json.loads(on_the_road.results[-1].data)['status'] == 'calibrated'
    assert on_the_road.graph.call('planar_calibrator/save').success


def test_reset_forgets_and_says_so(on_the_road):
    on_the_road.publish(range(4))
    assert on_the_road.graph.call('planar_calibrator/reset').success
    answer = on_the_road.graph.call('planar_calibrator/calibrate')
    assert not answer.success and '0 views' in answer.message


def test_a_message_that_is_no_tracks_still_gets_its_camera_info(on_the_road):
    msg = PointCloud2()
    msg.header.stamp.sec = 7
    on_the_road.publisher.publish(msg)
    on_the_road.graph.wait_for(lambda: on_the_road.infos)
    assert on_the_road.infos[-1].header == msg.header
