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
"""affine_calibrator: the calibrator of planar_calibrator, for motion that keeps to no plane."""

from pathlib import Path

import pytest

from selfcal_ros.cli.demo import read_truth
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.parameters import AffineCalibratorParameters
from selfcal_ros.nodes.replay_supervisor import replay
from selfcal_ros.report.camera_yaml import read_camera_yaml

BAG = Path(__file__).resolve().parents[2] / 'bags' / 'arm_move'


@pytest.mark.long
@pytest.mark.ros
def test_the_recorded_moves_through_three_processes_give_the_true_camera(tmp_path):
    result, infos = replay(BAG, tmp_path, rate=2.0, calibrator='affine_calibrator')
    assert result['status'] == 'calibrated', result['reason']
    assert result['motion'] == 'general'
    truth = read_truth(BAG)
    assert abs(result['camera']['fx'] - truth['fx']) < 0.001 * truth['fx']
    for name in ('cx', 'cy'):
        assert abs(result['camera'][name] - truth[name]) < 1
    for name in ('fx', 'cx', 'cy'):
        assert abs(result['camera'][name] - truth[name]) < 4 * result['sigma'][name]
    # zeros until there is a calibration, which then stays; when that is, is up to the machine
    known = [focal > 0 for _, focal in infos]
    assert not known[0] and known == sorted(known)
    assert read_camera_yaml(tmp_path / 'camera.yaml')[0].K[0, 0] == result['camera']['fx']


def test_it_has_the_services_of_its_sister_under_its_own_name(graph):
    graph = graph()
    node = graph.add(CalibratorNode('affine_calibrator', AffineCalibratorParameters))
    assert node.parameters.motion == 'general'
    for service in ('calibrate', 'save'):
        assert not graph.call(f'affine_calibrator/{service}').success
    assert graph.call('affine_calibrator/reset').success
