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
"""`selfcal calibrate --views` and `--motion repeated`: done, refused, or used wrongly."""

import json

import numpy as np

from selfcal_ros.synthetic.few_view_scenes import cut_camera, equal_objects, general_views
from test_support.command_line import selfcal, SIZE

CAMERA = cut_camera()


def test_four_of_many_views_calibrate():
    tracks = general_views(np.random.default_rng(1), CAMERA, 7).tracks
    tracks.to_csv('tracks.csv')
    assert selfcal('calibrate', 'tracks.csv', '--motion', 'general', '--views', 4, '--json',
                   'result.json', *SIZE) == 0
    result = json.loads(open('result.json', encoding='utf-8').read())
    assert len(result['frames']['used']) == 4
    assert abs(result['camera']['fx'] - 700) < 4 * result['sigma']['fx']


def test_equal_objects_calibrate_or_are_refused(capsys):
    turns = ((0, 0, 0), (0, 0, 0), (25, 35, 10))
    equal_objects(np.random.default_rng(1), CAMERA, turns).to_csv('objects.csv')
    assert selfcal('calibrate', 'objects.csv', '--motion', 'repeated', '--parallel-objects',
                   0, 1, '--json', 'result.json', *SIZE) == 0
    assert 'Every object counts as a view' in capsys.readouterr().out
    result = json.loads(open('result.json', encoding='utf-8').read())
    assert abs(result['camera']['fx'] - 700) < 4 * result['sigma']['fx']
    equal_objects(np.random.default_rng(1), CAMERA, turns[:2]).to_csv('objects.csv')
    assert selfcal('calibrate', 'objects.csv', '--motion', 'repeated', *SIZE, '--force') == 1


def test_wrong_uses_are_told(tmp_path, capsys):
    general_views(np.random.default_rng(1), CAMERA).tracks.to_csv('tracks.csv')
    assert selfcal('calibrate', 'tracks.csv', '--views', 4, *SIZE) == 2
    assert '--views needs --motion general' in capsys.readouterr().err
    assert selfcal('calibrate', 'tracks.csv', '--motion', 'general', '--views', 3, *SIZE) == 2
    assert 'at least 4' in capsys.readouterr().err
    assert selfcal('calibrate', 'tracks.csv', '--parallel-objects', 0, 1, *SIZE) == 2
    assert '--motion repeated' in capsys.readouterr().err
    (tmp_path / 'images').mkdir()
    assert selfcal('calibrate', tmp_path / 'images', '--motion', 'repeated') == 2
    assert 'give tracks.csv' in capsys.readouterr().err
