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
"""A bent board is in result.json and in the figures; a flat one only in the file."""

import numpy as np
import pytest
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.board_figure import board_figure
from selfcal_ros.report.result_json import result_to_dict
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.tracks import Tracks

CAMERA = Camera([[800, 0, 410], [0, 800, 290], [0, 0, 1]], (), 800, 600)


def calibrated(bow_m):
    """A board of 8 x 6 corners 25 mm apart, bent along, from eight sides."""
    y, x = 0.025 * np.mgrid[:6, :8].reshape(2, -1)
    flat = np.column_stack([x, y, np.zeros(48)])
    middle, rng = flat.mean(axis=0), np.random.default_rng(1)
    bent = flat - middle + bow_m * ((flat[:, :1] - middle[0]) / 0.0875)**2 * [0, 0, 1]
    xy = [CAMERA.project(bent @ rotation_matrix(turn).T + [0, 0, 0.3])
          + rng.normal(0, 0.1, (48, 2)) for turn in 0.5 * np.array([
              [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0.7, 0.7, 0], [0.7, -0.7, 0],
              [-0.7, 0.7, 0.5], [0, 0, 1]])]
    tracks = Tracks(np.repeat(np.arange(8), 48), np.tile(np.arange(48), 8), np.concatenate(xy),
                    (800, 600))
    return calibrate_known_object(tracks, KnownObject(np.arange(48), flat), facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, distortion='none'))


def test_a_bent_board_is_written_and_drawn():
    result = calibrated(0.001)
    board = result_to_dict(result)['board']
    assert board['bent'] and 'limit_m' not in board
    assert board['bend_m']['value'] == pytest.approx(0.001, abs=4 * board['bend_m']['sigma'])
    along = board['unknowns_m']['bow_x']
    assert abs(along['value']) == pytest.approx(0.001, abs=4 * along['sigma'])
    drawing = board_figure(result)
    assert 'bends by 0.99' in drawing.caption and drawing.svgs()[0].count(b'<path') > 10


def test_a_flat_board_says_what_would_have_shown():
    result = calibrated(0.0)
    board = result_to_dict(result)['board']
    assert not board['bent'] and 0 < board['limit_m'] < 0.001
    assert board_figure(result) is None
