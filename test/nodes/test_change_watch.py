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
"""A calibrator whose camera is zoomed on the way: it warns, keeps its calibration, and obeys."""

from dataclasses import replace
import json
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.diagnostics import WARN
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_message
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from selfcal_ros.calibration.monitoring.camera_change import MonitorSettings
from selfcal_ros.calibration.monitoring.mount_monitor import MountChange
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.change_watch import ChangeWatch
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.pipeline.monitoring import MonitoringSnapshot, MountSnapshot
from selfcal_ros.synthetic.scenes import observe
from selfcal_ros.synthetic.special_scenes import drive
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import String
from test_support.diagnostics_table import not_written

START_NS, STEP_NS = 1_700_000_000_000_000_000, 200_000_000
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: Calibrated once, with the first sixteen views; every view is a keyframe.
OPTIONS = ('-p', 'keyframe_parallax:=0.001', '-p', 'first_estimate:=16', '-p',
           'max_keyframes:=16', '-p', 'idle_s:=600.0', '-p', 'silence_s:=600.0', '-p',
           'distortion:=none')
ZOOMED_AT, VIEWS = 34, 70


class ZoomedDrive:
    """A calibrator in an executor, and the tracks of a drive with a zoom on the way."""

    def __init__(self, graph):
        self.graph = graph
        rng = np.random.default_rng(21)
        sequence = drive(rng, 0.0, VIEWS, 2200)
        self.before = sequence.camera
        values = self.before.parameters
        values[:2] *= 1.02
        self.after = Camera.from_parameters(values, 640, 480)
        seen = np.zeros((VIEWS, len(sequence.points)), bool)
        seen[sequence.tracks.frame, sequence.tracks.track] = True
        self.tracks = [observe(rng, self.after if k >= ZOOMED_AT else self.before,
                               sequence.cam_from_world[k:k + 1], sequence.points, 0.1, True,
                               seen[k:k + 1]).tracks for k in range(VIEWS)]
        self.node = graph.add(CalibratorNode('planar_calibrator', PlanarCalibratorParameters))
        self.publisher = graph.probe.create_publisher(PointCloud2, 'tracks', 100)
        self.infos = graph.listen(CameraInfo, 'camera_info', 100)
        self.results = graph.listen(String, 'planar_calibrator/result', LATCHED)
        self.diagnostics = graph.listen(DiagnosticArray, '/diagnostics')
        graph.wait_for(lambda: self.publisher.get_subscription_count() > 0)
        graph.wait_for(lambda: graph.probe.count_publishers('camera_info') > 0)

    def publish(self, views):
        for view in views:
            known = len(self.infos)
            self.publisher.publish(tracks_message(
                self.tracks[view].track, self.tracks[view].xy, (640, 480),
                header_message(START_NS + view * STEP_NS, 'cam_optical', rclpy_types()),
                rclpy_types()))
            self.graph.wait_for(lambda: len(self.infos) > known, what='camera_info')

    def calibrations(self):
        return [result for result in (json.loads(r.data) for r in self.results)
                if result['status'] == 'calibrated']

    def status(self):
        """Level, message and values of the newest diagnostic."""
        status = self.diagnostics[-1].status[0]
        return status.level, status.message, {v.key: v.value for v in status.values}

    def wait_for_status(self, condition, what):
        self.graph.wait_for(lambda: self.diagnostics and condition(*self.status()), 60, what)
        return self.status()


@pytest.fixture
def zoomed(graph):
    return ZoomedDrive(graph(*OPTIONS))


@pytest.mark.long
def test_a_zoom_warns_and_replaces_nothing_until_it_is_told_to(zoomed):
    zoomed.publish(range(16))
    zoomed.graph.wait_for(zoomed.calibrations, 60, 'calibration')
    first = zoomed.infos[-1].k[0] or zoomed.calibrations()[0]['camera']['fx']
    # two windows of the camera as it was, then two with the zoom in them
    zoomed.publish(range(16, ZOOMED_AT))
    level, message, values = zoomed.wait_for_status(
        lambda level, message, values: int(values.get('monitor windows', 0)) >= 1, 'a window')
    assert level == b'\x00' and message == 'calibrated'
    assert float(values['monitor statistic']) < float(values['monitor threshold'])
    zoomed.publish(range(ZOOMED_AT, 60))
    level, message, values = zoomed.wait_for_status(
        lambda level, message, values: level == b'\x01', 'the alarm')
    assert 'the camera has changed' in message and 'focal length' in message
    assert '~/calibrate' in message and '~/reset' in message
    change, sigma = (float(values[f'change of focal length px{s}']) for s in ('', ' sigma'))
    assert abs(change - 10.4) < 4 * sigma
    assert not not_written(values)
    # the calibration stands, and so does the warning
    assert len(zoomed.calibrations()) == 1
    zoomed.publish(range(60, VIEWS))
    assert zoomed.infos[-1].k[0] == first
    # told to, the node calibrates from what came since
    answer = zoomed.graph.call('planar_calibrator/calibrate')
    assert answer.success, answer.message
    zoomed.graph.wait_for(lambda: len(zoomed.calibrations()) == 2, 60, 'calibration anew')
    result = zoomed.calibrations()[-1]
    assert abs(result['camera']['fx'] - zoomed.after.K[0, 0]) < 4 * result['sigma']['fx']
    level, message, _ = zoomed.wait_for_status(
        lambda level, message, values: level == b'\x00', 'the end of the warning')
    assert message == 'calibrated'


@pytest.mark.long
def test_reset_ends_the_watch(zoomed):
    zoomed.publish(range(16))
    zoomed.graph.wait_for(zoomed.calibrations, 60, 'calibration')
    zoomed.publish(range(16, 26))
    zoomed.wait_for_status(lambda level, message, values:
                           int(values.get('monitor windows', 0)) >= 1, 'a window')
    assert zoomed.graph.call('planar_calibrator/reset').success
    zoomed.wait_for_status(lambda level, message, values:
                           int(values['monitor windows']) == 0, 'forgotten')


@pytest.mark.long
def test_the_monitor_is_switched_and_set_while_the_node_runs(zoomed):
    def change(**values):
        assert zoomed.graph.set_parameters('planar_calibrator', **values) == ['']

    zoomed.publish(range(16))
    zoomed.graph.wait_for(zoomed.calibrations, 60, 'calibration')
    change(monitor=False)
    zoomed.wait_for_status(lambda level, message, values: 'monitor windows' not in values, 'off')
    zoomed.publish(range(16, 26))
    assert 'monitor windows' not in zoomed.status()[2]
    change(monitor=True)
    zoomed.publish(range(26, ZOOMED_AT))
    # it watches the calibration that there is
    zoomed.publish(range(ZOOMED_AT, 60))
    zoomed.wait_for_status(lambda level, message, values: level == b'\x01', 'the alarm')
    # another threshold does not take back what was noticed
    change(false_alarm_keyframes=1e5)
    zoomed.wait_for_status(lambda level, message, values: level == b'\x01', 'the alarm still')
    # without a monitor there is no alarm, and estimates go on from what came since: it is told
    said = []
    zoomed.node._watch._logger = SimpleNamespace(warning=said.append)
    change(monitor=False)
    assert 'replace the calibration' in said[0]
    zoomed.publish(range(60, VIEWS))
    change(first_estimate=6)
    change(idle_s=0.1)
    zoomed.graph.wait_for(lambda: len(zoomed.calibrations()) > 1, 60, 'calibration anew')
    result = zoomed.calibrations()[-1]
    assert abs(result['camera']['fx'] - zoomed.after.K[0, 0]) < 4 * result['sigma']['fx']


def test_a_knock_is_told_with_its_axis_and_what_it_asks_the_robot_for():
    asked = []
    watch = ChangeWatch(SimpleNamespace(keyframes=[]), None, MonitorSettings(),
                        lambda: asked.append(1))
    sigma = np.radians([0.04, 0.04, 0.2])
    knocked = MountChange(np.radians([0.01, 0.5, -0.3]), np.diag(sigma**2), 3, 11, 27, 80.0, 33.5)
    state = MonitoringSnapshot(windows=4, threshold=35.0, change=knocked,
                               mount=MountSnapshot(3, 1, 'no poses', 80.0, 33.5))
    watch._monitoring = SimpleNamespace(snapshot=lambda: state, next_request=lambda ask: ask())
    level, message, values = watch.judge(b'\x00', 'calibrated', {})
    assert level == WARN and 'pitch +0.500 ± 0.040 degrees' in message
    assert 'yaw' not in message and 'roll' not in message and '~/calibrate' in message
    assert values['change of pitch deg'] == pytest.approx(0.5)
    assert values['change of yaw deg sigma'] == pytest.approx(0.2)
    assert values['mount monitor windows'] == 3
    assert values['mount monitor last skipped'] == 'no poses'
    assert watch.next_job() is None and asked
    state = replace(state, change=None)
    assert watch.judge(b'\x00', 'calibrated', {})[:2] == (b'\x00', 'calibrated')
