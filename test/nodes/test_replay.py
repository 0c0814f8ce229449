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
"""The recorded drive through three processes over DDS gives what the bag itself gives."""

from pathlib import Path

import pytest

from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.nodes.replay_supervisor import replay
from selfcal_ros.pipeline.feature_session import read_tracks
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.report.camera_yaml import read_camera_yaml

BAG = Path(__file__).resolve().parents[2] / 'bags' / 'agv_drive'


@pytest.mark.ros
def test_nodes_and_command_line_agree_within_the_stated_sigma(ros, tmp_path, monkeypatch):
    # ROS runs here, in the domain that it began in
    monkeypatch.delenv('ROS_DOMAIN_ID')
    result, infos = replay(BAG, tmp_path)
    assert result['status'] == 'calibrated', result['reason']
    reading = read_tracks(BAG)
    straight = calibrate(reading.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    assert straight, straight
    values = dict(zip(straight.sigma, straight.camera.parameters))
    for name in ('fx', 'fy', 'cx', 'cy'):
        sigma = (result['sigma'][name] ** 2 + straight.sigma[name] ** 2) ** 0.5
        assert abs(result['camera'][name] - values[name]) < 3 * sigma, name
    # one CameraInfo an image, zeros first, then better and better
    with open_source(BAG) as source:
        stamps = [frame.stamp_ns for frame in source]
    heard = [stamp for stamp, _ in infos]
    assert len(set(heard)) == len(heard)
    # a busy machine may drop images, never invent them
    assert len(heard) > 0.7 * len(stamps) and set(heard) <= set(stamps)
    known = [focal > 0 for _, focal in infos]
    assert not known[0] and known == sorted(known)
    assert abs(read_camera_yaml(tmp_path / 'camera.yaml')[0].K[0, 0]
               - result['camera']['fx']) < 1e-9
