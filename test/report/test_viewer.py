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
"""The optional viewer."""

from dataclasses import replace

import numpy as np
import pytest

from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.errors import ArgumentError
from selfcal_ros.report import viewer
from selfcal_ros.synthetic.special_scenes import drive


@pytest.fixture(scope='module')
def made():
    scene = drive(np.random.default_rng(11), noise_px=0.1, views=12, tracks=300)
    result = calibrate(scene.tracks, motion='planar', facts=CameraFacts(
        aspect_ratio=1.0, skew=0.0, distortion='none'))
    assert result, result
    return result, scene.tracks


def test_without_rerun_the_sentence_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(__import__('sys').modules, 'rerun', None)
    with pytest.raises(ArgumentError, match='pip install'):
        viewer.load_rerun()


def test_a_camera_that_only_rotates_has_nothing_to_show(made):
    result, tracks = made
    with pytest.raises(ArgumentError, match='only rotates'):
        viewer.view(replace(result, motion='rotation'), tracks)


def test_a_recording_is_written(made, tmp_path):
    pytest.importorskip('rerun')
    result, tracks = made
    viewer.view(result, tracks, recording=tmp_path / 'scene.rrd')
    content = (tmp_path / 'scene.rrd').read_bytes()
    for name in (b'structure', b'world/camera'):
        assert name in content
