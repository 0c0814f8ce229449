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
"""`selfcal calibrate` on many recordings."""

import json
from pathlib import Path
import shutil
import sys

import numpy as np
import pytest
from selfcal_ros.cli.force import output_folder
from selfcal_ros.report.camera_yaml import read_camera_yaml
from selfcal_ros.synthetic.special_scenes import drive, pure_translation
from test_support.command_line import selfcal, SIZE


@pytest.mark.long
def test_many_recordings_have_a_line_and_a_file_each_and_one_joint_result(capsys, driven):
    Path('drives').mkdir()
    for number in range(3):
        drive(np.random.default_rng(number), 0.2, 12, 250, 12).tracks.to_csv(
            f'drives/d{number}.csv')
    Path('drives/broken.csv').write_text('frame,track,x,y\n0,1,nan,2\n', encoding='utf-8')
    pure_translation(np.random.default_rng(1)).tracks.to_csv('drives/straight.csv')
    assert selfcal('calibrate', 'drives', *SIZE, '--output-dir', 'out', '--poses-format',
                   'tum') == 0
    said = capsys.readouterr().out
    for words in ('d0.csv', 'straight.csv', 'not calibrated: ', 'broken.csv, line 2',
                  '3 of 4 recordings calibrate', 'The recordings agree'):
        assert words in said
    joint = json.loads(Path('out/camera.json').read_text(encoding='utf-8'))
    assert abs(joint['camera']['fx'] - 520) < 4 * joint['sigma']['fx']
    assert read_camera_yaml('out/camera.yaml')[0].K[0, 0] == joint['camera']['fx']
    assert sorted(p.name for p in Path('out/recordings').iterdir()) == [
        *(f'd{k}.{end}' for k in range(3) for end in ('json', 'tum', 'yaml')), 'straight.json']
    assert np.loadtxt('out/recordings/d1.tum').shape == (12, 8)
    page = Path('out/summary.html').read_text(encoding='utf-8')
    assert 'data:image/svg+xml' in page and 'http://' not in page and 'straight.csv' in page
    assert Path('out/summary.png').read_bytes().startswith(b'\x89PNG')
    content = json.loads(Path('out/summary.json').read_text(encoding='utf-8'))
    assert len(content['cameras'][0]['recordings']) == 4 and len(content['failures']) == 1
    assert content['cameras'][0]['joint'] == joint


@pytest.mark.long
def test_no_file_takes_the_place_of_another(capsys, driven):
    for number, folder in enumerate(('one', 'two')):
        Path(folder).mkdir()
        drive(np.random.default_rng(number), 0.2, 12, 150, 12).tracks.to_csv(
            f'{folder}/drive.csv')
    inputs = ('calibrate', 'one/drive.csv', 'two/drive.csv', *SIZE, '--lens', 'none')
    assert selfcal(*inputs, '--output-dir', 'out') == 0
    # numbered as the inputs are, whichever was ready first
    for number, folder in enumerate(('one', 'two')):
        found = Path('out/recordings', f'drive{"_2" * number}.yaml').read_text(encoding='utf-8')
        assert f'{folder}/drive.csv' in found
    assert selfcal(*inputs, '--output-dir', 'other', '--camera-name', 'summary') == 2
    assert 'give the camera another' in capsys.readouterr().err


@pytest.mark.long
def test_a_copy_of_a_recording_counts_once(capsys, driven):
    drive(np.random.default_rng(0), 0.2, 12, 150, 12).tracks.to_csv('a.csv')
    shutil.copy('a.csv', 'b.csv')
    assert selfcal('calibrate', 'a.csv', 'b.csv', *SIZE, '--lens', 'none', '--output-dir',
                   'out') == 0
    assert 'b.csv holds the same as a.csv' in capsys.readouterr().out
    joint, one = (json.loads(Path(name).read_text(encoding='utf-8'))
                  for name in ('out/camera.json', 'out/recordings/a.json'))
    assert np.isclose(joint['sigma']['fx'], one['sigma']['fx'], rtol=0.01)


@pytest.mark.long
def test_many_recordings_none_of_which_can_be_used(capsys):
    for name in ('a', 'b'):
        Path(f'{name}.csv').write_text('frame,track,x,y\n0,1,nan,2\n', encoding='utf-8')
    assert selfcal('calibrate', 'a.csv', 'b.csv', '--quiet') == 2
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.count('\n') == 2
    for options, words in ((['--output', 'c.yaml'], '--output is for a single'),
                           (['--poses', 'p.tum'], '--poses-format writes the poses of each'),
                           (['--track', '--model', 'm.cao'], '--track takes a single'),
                           (['--jobs', '0'], 'give 1 or more'), (['--scheduler', 'x'], 'dask')):
        assert selfcal('calibrate', 'a.csv', 'b.csv', *options) == 2
        assert words in capsys.readouterr().err
    assert selfcal('calibrate', 'a.csv', '--output-dir', 'x') == 2
    assert '--output-dir is for many' in capsys.readouterr().err


def test_a_run_that_is_refused_leaves_no_folder(capsys, monkeypatch):
    for name in ('a.csv', 'b.csv', 'a.png', 'b.png'):
        Path(name).touch()
    monkeypatch.setitem(sys.modules, 'dask.distributed', None)
    for inputs, options, words in (
            (['a.csv', 'b.csv'], ['--engine', 'dask'], 'needs Dask'),
            (['a.csv', 'b.csv'], ['--scheduler', 'tcp://x:1', '--output-dir', 'new/one'], 'dask'),
            (['a.png', 'b.png'], [], 'a.png and 1 more are single images; give the folder, .,'),
            (['a.csv', 'b.csv'], ['--output-dir', 'a.csv'], 'a.csv is a file; name a folder')):
        assert selfcal('calibrate', *inputs, *options) == 2
        heard = capsys.readouterr()
        assert words in heard.err and heard.err.count('\n') == 1 and not heard.out
    assert sorted(path.name for path in Path().iterdir()) == ['a.csv', 'a.png', 'b.csv', 'b.png']


@pytest.mark.long
def test_of_two_runs_into_one_folder_the_second_is_refused(capsys):
    for name in ('a.csv', 'b.csv'):
        Path(name).write_text('frame,track,x,y\n0,1,nan,2\n', encoding='utf-8')
    with output_folder(Path('out')):
        for more in ([], ['--force']):
            assert selfcal('calibrate', 'a.csv', 'b.csv', '--output-dir', 'out', *more) == 2
            assert 'Another run is writing to out; name another' in capsys.readouterr().err
    assert selfcal('calibrate', 'a.csv', 'b.csv', '--output-dir', 'out', '-q') == 2
    assert 'a.csv, line 2' in capsys.readouterr().err
