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
"""Every example runs, on the recordings of the repository, and prints what is true."""

import json
import os
from pathlib import Path
import shutil
import subprocess
import sys

import numpy as np
import pytest
from selfcal_ros.cli.main import main as selfcal
from selfcal_ros.report.camera_yaml import read_camera_yaml
from selfcal_ros.synthetic.special_scenes import drive

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES, BAGS = ROOT / 'examples', ROOT / 'bags'
# the processes that an example starts find the sources, too
ENVIRONMENT = {**os.environ, 'PYTHONPATH': os.pathsep.join(
    filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))}


def run(name, *arguments, cwd):
    done = subprocess.run([sys.executable, EXAMPLES / name, *map(str, arguments)], cwd=cwd,
                          capture_output=True, text=True, timeout=240, env=ENVIRONMENT)
    assert not done.stderr, done.stderr
    return done.returncode, done.stdout


def test_the_page_names_every_example_and_there_are_five():
    text = (EXAMPLES / 'README.md').read_text(encoding='utf-8')
    names = {path.name for path in EXAMPLES.glob('*.py')}
    assert len(names) == 5
    assert all(f'`{name}`' in text for name in names)


def test_a_recording_is_calibrated_to_the_truth(tmp_path):
    status, said = run('calibrate_recording.py', BAGS / 'arm_move', 'camera.yaml', cwd=tmp_path)
    assert status == 0
    camera, _ = read_camera_yaml(tmp_path / 'camera.yaml')
    truth = json.loads((BAGS / 'arm_move.truth.json').read_text(encoding='utf-8'))
    assert abs(camera.K[0, 0] / truth['K'][0][0] - 1) < 0.002
    assert 'half the width of the image is 34' in said and 'estimated' in said


def test_a_recording_without_motion_is_refused_in_words(tmp_path):
    still = tmp_path / 'tracks.csv'
    still.write_text('frame,track,x,y\n' + ''.join(
        f'{frame},{track},{10 * track},{7 * track % 50}\n' for frame in range(3)
        for track in range(30)), encoding='utf-8')
    status, said = run('calibrate_recording.py', still, 'camera.yaml', cwd=tmp_path)
    assert status == 1
    assert said.startswith('Not calibrated: ')


def test_a_result_is_read_and_judged(tmp_path):
    drive(np.random.default_rng(3), noise_px=0.1, views=10, tracks=300).tracks.to_csv(
        tmp_path / 'tracks.csv')
    assert selfcal(['calibrate', str(tmp_path / 'tracks.csv'), '--image-size', '640', '480',
                    '--json', str(tmp_path / 'result.json'),
                    '--output', str(tmp_path / 'camera.yaml')]) == 0
    status, said = run('read_result.py', 'result.json', '--least-sigma', 5, cwd=tmp_path)
    assert status == 0
    assert 'fx    estimated' in said and 'skew  held' in said
    assert run('read_result.py', 'result.json', '--least-sigma', 1e-6, cwd=tmp_path)[0] == 1


def test_an_object_is_followed_to_its_true_place(tmp_path):
    start = (BAGS / 'tracked_object.pos').read_text(encoding='utf-8').splitlines()[1].split()
    status, said = run('track_object.py', BAGS / 'tracked_object',
                       BAGS / 'tracked_object.model.yaml', BAGS / 'tracked_object.camera.yaml',
                       '--start', *start, cwd=tmp_path)
    assert status == 0
    lines = said.splitlines()
    truth = json.loads((BAGS / 'tracked_object.truth.json').read_text(encoding='utf-8'))
    poses = np.array(truth['cam_from_object'])
    assert len(lines) == len(poses)
    last = np.array(lines[-1].split(':')[1].split()[:3], float)
    assert np.linalg.norm(last - poses[-1, :, 3]) < 0.005


@pytest.mark.long
def test_many_recordings_are_calibrated_together(tmp_path):
    # tracks stand for bags, which the first example reads: two of them would be followed here
    drive(np.random.default_rng(3), noise_px=0.1, views=10, tracks=300).tracks.to_csv(
        tmp_path / 'drive.csv')
    shutil.copy(tmp_path / 'drive.csv', tmp_path / 'again.csv')
    (tmp_path / 'broken.mcap').write_bytes(b'no bag')
    status, said = run('many_recordings.py', 'drive.csv', 'again.csv', 'broken.mcap', cwd=tmp_path)
    assert status == 0
    assert 'broken.mcap: ' in said
    # a copy counts once
    assert 'together: fx 5' in said and '1 of 1 recordings' in said
