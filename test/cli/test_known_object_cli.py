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
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.cli import main as command
from selfcal_ros.features.tsai_grid import TsaiGrid
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.camera_yaml import read_camera_yaml
from selfcal_ros.synthetic.calibration_grid import grid_scene, view_of_grid
from selfcal_ros.synthetic.render import Renderer
from selfcal_ros.values.tracks import Tracks

CAMERA = Camera([[640, 0, 320], [0, 640, 240], [0, 0, 1]], [-0.1, 0, 0, 0], 640, 480)
GRID = TsaiGrid(3, 3, 0.04, 0.03, 0.03)
WHAT = 'tsai:3x3:0.04:0.03:0.03'


@pytest.fixture(scope='module')
def pictures(tmp_path_factory):
    """Write two images of a grid, and one of nothing."""
    folder = tmp_path_factory.mktemp('pictures')
    renderer = Renderer(grid_scene(3, 3, 0.04, 0.03, 0.03), CAMERA, 2, 120)
    for k, turn in enumerate(([0.4, 0.1, 0], [0.3, -0.2, 0.2])):
        pose = view_of_grid(GRID.known.points, 0.6, turn)
        cv2.imwrite(str(folder / f'{k}.png'),
                    renderer.render(pose, np.random.default_rng(k), 2.0))
    cv2.imwrite(str(folder / '2.png'), np.full((480, 640), 120, np.uint8))
    return folder


@pytest.fixture
def tables():
    """Write points.csv and tracks.csv of a cube's corners and more, without a picture."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.3, 0.3, (30, 3))
    lines = ['point,X,Y,Z'] + [f'{k},{x!r},{y!r},{z!r}'
                               for k, (x, y, z) in enumerate(points.tolist())]
    Path('points.csv').write_text('\n'.join(lines) + '\n', encoding='utf-8')
    xy = [CAMERA.project(points @ rotation_matrix(turn).T + [0, 0, 1.2])
          for turn in np.array([[0, 0, 0], [0, 0.6, 0]])]
    xy = np.concatenate(xy) + 0.1 * rng.standard_normal((60, 2))
    Tracks(np.repeat([0, 1], 30), np.tile(np.arange(30), 2), xy).to_csv('tracks.csv')


def selfcal(*arguments):
    """Run the command in this process; returns the exit status."""
    try:
        return command.main(['calibrate', *map(str, arguments)])
    except SystemExit as stop:
        return stop.code


@pytest.mark.long
def test_pictures_of_a_grid_give_the_camera(pictures, capsys):
    status = selfcal(pictures, '--motion', 'known-object', '--object', WHAT,
                     '--distortion', 'radial1', '--json', 'r.json', '--report', 'r.html')
    said = capsys.readouterr().out
    assert status == 0, said
    assert 'Calibrated from 2 views of a known object' in said
    assert 'found anew in 2 of 3 images' in said
    assert 'It was not found in 1 image: 2.png.' in said
    camera, _ = read_camera_yaml('camera.yaml')
    content = json.loads(Path('r.json').read_text(encoding='utf-8'))
    assert content['motion'] == 'known-object' and content['frames']['used'] == [0, 1]
    assert camera.K[0, 0] == pytest.approx(640, rel=0.005)
    assert abs(camera.distortion[0] + 0.1) < 0.02
    assert '<html' in Path('r.html').read_text(encoding='utf-8')


def test_one_view_suffices_and_object_alone_says_the_motion(pictures, capsys):
    assert selfcal(pictures, '--object', WHAT, '--max-keyframes', 1, '--quiet') == 0
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err == ''
    assert Path('camera.yaml').exists()


def test_tables_give_the_camera(tables, capsys):
    assert selfcal('tracks.csv', '--motion', 'known-object', '--object', 'points.csv',
                   '--image-size', 640, 480, '--json', 'r.json') == 0, capsys.readouterr().out
    content = json.loads(Path('r.json').read_text(encoding='utf-8'))
    for name, true in (('fx', 640), ('cx', 320), ('cy', 240)):
        assert abs(content['camera'][name] - true) < 4 * content['sigma'][name]


def test_what_cannot_be_calibrated_is_status_1_with_a_reason(tables, capsys):
    text = Path('points.csv').read_text(encoding='utf-8').splitlines()
    other = [f'{int(line.split(",")[0]) + 500},' + line.split(',', 1)[1] for line in text[1:]]
    Path('other.csv').write_text('\n'.join(text[:1] + other), encoding='utf-8')
    assert selfcal('tracks.csv', '--object', 'other.csv', '--image-size', 640, 480,
                   '--json', 'r.json') == 1
    said = capsys.readouterr().out
    assert said.startswith('Not calibrated: ') and 'two files do not match' in said
    assert not Path('camera.yaml').exists()
    content = json.loads(Path('r.json').read_text(encoding='utf-8'))
    assert content['status'] == 'not_calibrated' and content['motion'] == 'known-object'


@pytest.mark.parametrize('arguments, words', [
    (['--motion', 'known-object'], 'needs --object'),
    (['--motion', 'planar', '--object', WHAT], 'exclude each other'),
    (['--object', 'sphere:3'], 'unknown'),
    (['--object', 'nowhere.csv'], 'cannot be read'),
    (['--object', 'points.csv'], 'give a table of tracks'),
    (['--object', WHAT, '--max-keyframes', '0'], 'at least 1'),
    (['--object', WHAT, '--ply', 'a.ply'], 'leave it out'),
    (['--object', 'chessboard:11x7:0.03'], 'in none of the 3 images'),
    (['--object', WHAT, '--image-size', '320', '240'], 'correct the image size'),
])
def test_a_wrong_input_is_status_2_in_one_sentence(pictures, tables, capsys, arguments, words):
    before = sorted(Path().iterdir())
    assert selfcal(pictures, *arguments) == 2
    heard = capsys.readouterr()
    assert heard.out == ''
    assert words in heard.err and heard.err.count('\n') == 1
    assert sorted(Path().iterdir()) == before
