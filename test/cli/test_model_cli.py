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
"""selfcal model, as a user calls it."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.geometry.polygon import newell_normal
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.synthetic.objects import tracked_object
from selfcal_ros.synthetic.recordings import write_image_folder
from test_support.command_line import selfcal


def _two_images():
    """Write two images of a box that was pushed, and the camera's file."""
    recording = tracked_object(2, 'box', 'translation', background=False)
    poses = recording.cam_from_world.copy()
    poses[:, :, 3] *= 0.7
    poses[1] = poses[0]
    poses[1, :, 3] += [-0.06, 0.01, 0.02]
    recording = replace(recording, cam_from_world=poses)
    write_image_folder(recording, 'box')
    write_camera_yaml('camera.yaml', recording.camera, 'camera')
    return recording


def test_a_model_and_a_drawing_are_written(capsys):
    _two_images()
    assert selfcal('model', 'box', '--camera', 'camera.yaml', '--length', '0.1', '--output',
                   'it.cao', '--obj', 'it.obj') == 0
    said = capsys.readouterr().out
    assert 'Model of 7 vertices, 9 lines and 3 faces' in said and '--init "' in said
    assert 'Written: it.cao, it.obj.' in said
    edges = read_model('it.cao').edges()
    lengths = np.sort(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1))
    np.testing.assert_allclose(lengths, np.repeat([0.06, 0.08, 0.1], 3), rtol=0.015)
    assert Path('it.obj').read_text().startswith('# metres')
    # what was said is where the tracker begins, in no more digits than a start needs
    start = said.split('--init "')[1].split('"')[0]
    assert 'e-' not in start and all(len(word.lstrip('-')) <= 6 for word in start.split())
    # the faces look at the camera that saw them
    model = read_model('it.cao')
    place = model.vertices + [float(word) for word in start.split()[:3]]
    for face in model.faces:
        corners = place[list(face.indices)]
        assert newell_normal(corners) @ corners[0] < 0
    assert selfcal('track', 'box', '--model', 'it.cao', '--camera', 'camera.yaml', '--init',
                   start) == 0


def test_no_object_is_status_1_with_a_reason(capsys):
    recording = _two_images()
    grey = np.full((recording.camera.height, recording.camera.width), 90, np.uint8)
    Path('empty').mkdir()
    for k in range(3):
        cv2.imwrite(f'empty/{k}.png', grey)
    assert selfcal('model', 'empty', '--camera', 'camera.yaml', '--length', '0.1') == 1
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.startswith('No model: ')
    assert heard.err.count('\n') == 1 and not Path('object.cao').exists()


@pytest.mark.parametrize('words, says', [
    ([], '(--baseline)'), (['--length', '0.1', '--baseline', '1'], 'state one of them'),
    (['--length', '-1'], 'more than 0'), (['--length', '1e12'], 'less than a million metres'),
    (['--length', '0.1', '--images', '0', '7'], 'no image 7'),
    (['--length', '0.1', '--images', '1', '1'], 'different'),
    (['--length', '0.1', '--between', 'a', 'b'], "no vertex 'a'"),
    (['--length', '0.1', '--output', 'it.stl'], '.cao or .yaml'),
    (['--length', '0.1', '--obj', 'it.ply'], '.obj'),
    (['--length', '0.1', '--vertices', 'none.yaml'], 'none.yaml')])
def test_wrong_arguments_are_status_2_with_a_sentence(words, says, capsys):
    _two_images()
    assert selfcal('model', 'box', '--camera', 'camera.yaml', *words) == 2
    heard = capsys.readouterr()
    assert says in heard.err and heard.err.count('\n') == 1
