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
"""The line delay of a rolling shutter in camera files, and who reads it there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.calibration_file import CalibrationFile
from selfcal_ros.report.camera_files.known_camera import read_known
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.report.shutter_comment import shutter_comment, stored_line_delay

READOUT = RowReadout(-4.25e-5, 3e-7, 'estimated', 0.61, 0.004, 480)
CAMERA = Camera([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]], (), 640, 480)


@pytest.mark.parametrize('lines', ['rows', 'columns'])
def test_what_is_written_is_read_again(tmp_path, lines):
    path = write_camera_yaml(tmp_path / 'camera.yaml', CAMERA, 'camera',
                             shutter_comment(replace(READOUT, lines=lines)))
    stored = read_known(path)
    assert stored.line_delay_s == pytest.approx(-4.25e-5, rel=1e-6) and stored.lines == lines
    assert np.array_equal(stored.camera.K, CAMERA.K)


def test_a_global_shutter_and_a_recording_without_stamps_tell_no_line_delay(tmp_path):
    assert shutter_comment(None) == []
    unstamped = replace(READOUT, line_delay_s=None, sigma_s=None)
    path = write_camera_yaml(tmp_path / 'camera.yaml', CAMERA, 'camera',
                             shutter_comment(unstamped))
    assert 'all rows in 0.61 +- 0.004 intervals' in path.read_text(encoding='utf-8')
    assert read_known(path).line_delay_s is None


@pytest.mark.parametrize('text', [
    '', '# rolling shutter: line_delay nan s +- 1 s, by rows (held)',
    '# rolling shutter: line_delay soon s +- 1 s, by rows (held)',
    '# rolling shutter: line_delay 1e-5 s +- 1 s, by chance', 'line_delay 1e-5 s by rows'])
def test_a_comment_that_says_something_else_is_none(text):
    assert stored_line_delay(text) is None


def test_the_camera_file_of_a_calibrator_tells_it(tmp_path):
    calibration = SimpleNamespace(
        camera=CAMERA, covariance=np.full((0, 0), np.nan), shutter=READOUT, frames=(0, 1),
        software='selfcal', sigma={'fx': 1.0, 'fy': 1.0, 'cx': 1.0, 'cy': 1.0})
    path = CalibrationFile('camera', str(tmp_path / 'camera.yaml')).write(calibration)
    assert read_known(path).line_delay_s == pytest.approx(-4.25e-5, rel=1e-6)
