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
"""The lens on the command line: how it is stated, and files of cameras that cannot be used."""

from pathlib import Path

import numpy as np
import pytest
from selfcal_ros.cli.facts import LENSES
from selfcal_ros.cli.main import build_parser, main
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.lenses.catalogue import LENS_CHOICES
from selfcal_ros.report.camera_files.formats import write_camera
from selfcal_ros.report.camera_files.known_camera import read_known_camera
from selfcal_ros.report.camera_yaml import camera_yaml

K = np.array([[260.0, 0, 320], [0, 260, 240], [0, 0, 1]])
FISHEYE = Camera(K, [-0.03, 0.01, -0.01, 0.002], 640, 480, 'equidistant')
CUBE = ['--model', 'cube.cao', '--init', '0 0 1 0 0 0']


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work in a folder with camera files that nobody can use."""
    monkeypatch.chdir(tmp_path)
    text = camera_yaml(FISHEYE, 'front')
    short = text.replace('cols: 4\n  data: [-0.03, 0.01, -0.01, 0.002]',
                         'cols: 3\n  data: [-0.03, 0.01, -0.01]')
    assert short != text
    Path('short.yaml').write_text(short, encoding='utf-8')
    for name, d, model in (('barrel', [-0.95], 'plumb_bob'), ('fold', [-0.3], 'equidistant')):
        Path(f'{name}.yaml').write_text(camera_yaml(Camera(K, d, 640, 480, model), name),
                                        encoding='utf-8')
    Path('good.yaml').write_text(text, encoding='utf-8')


def test_the_lens_is_stated_by_either_name():
    from selfcal_ros.cli.facts import facts_from
    assert LENSES == ('auto', *LENS_CHOICES)
    parser = build_parser('calibrate')
    for option in ('--lens', '--distortion'):
        for name in LENSES:
            facts = facts_from(parser.parse_args(['calibrate', 'bag', option, name]))
            assert facts.distortion == name and facts.lens_population
    plain = facts_from(parser.parse_args(['calibrate', 'bag', '--no-lens-population']))
    assert plain.distortion == 'auto' and not plain.lens_population


@pytest.mark.parametrize('arguments', [
    ['track', 'bag', *CUBE, '--camera'], ['model', 'bag', '--length', '1', '--camera'],
    ['calibrate', 'bag', '--track', *CUBE, '--camera'], ['compare', 'good.yaml'],
    ['convert', '--to', 'kalibr', '--force', 'out.yaml']], ids=lambda one: one[0])
def test_a_fisheye_with_three_coefficients_is_status_2_in_one_sentence(capsys, arguments):
    verb, *rest = arguments
    files = ['short.yaml', 'out.yaml'] if verb == 'convert' else [*rest, 'short.yaml']
    Path('bag').mkdir()
    Path('cube.cao').write_text('V1\n4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1\n0 1\n0\n0\n0\n0\n')
    options = ['--to', 'kalibr'] if verb == 'convert' else []
    assert main([verb, *files, *options]) == 2
    heard = capsys.readouterr()
    assert heard.out == '' and heard.err.count('\n') == 1
    assert 'short.yaml: The distortion model equidistant has 4 coefficients, not 3.' in heard.err


@pytest.mark.parametrize('name, angle', [('barrel', 31), ('fold', 60)])
def test_a_lens_that_folds_inside_the_image_is_not_taken_as_known(capsys, name, angle):
    Path('cube.cao').write_text('V1\n')
    assert main(['track', 'bag', *CUBE, '--camera', f'{name}.yaml']) == 2
    heard = capsys.readouterr().err
    assert heard.count('\n') == 1 and f'{name}.yaml: the distortion folds' in heard
    assert f'{angle} degrees from the axis, inside the image' in heard


def test_a_known_camera_is_read_from_the_files_of_others():
    assert read_known_camera('good.yaml').model == 'equidistant'
    for model, d in (('ucm', [1.3, -0.1, 0, 0, 0]), ('double_sphere', [-0.2, 0.6])):
        camera = Camera(K, d, 640, 480, model)
        write_camera('chain.yaml', 'kalibr', camera)
        assert np.array_equal(read_known_camera('chain.yaml').parameters, camera.parameters)
    text = Path('chain.yaml').read_text(encoding='utf-8')
    Path('chain.yaml').write_text(text + text.replace('cam0', 'cam1'), encoding='utf-8')
    with pytest.raises(InputError, match='holds 2 cameras.*cam0, cam1'):
        read_known_camera('chain.yaml')


def test_the_black_rim_of_a_fisheye_is_no_fold():
    """A polynomial that turns at 95 degrees, outside of the circle but inside the image."""
    k1 = -1 / (3 * np.radians(95)**2)
    rim = Camera(np.diag([150.0, 150, 1]) + np.array([[0, 0, 320], [0, 0, 240], [0, 0, 0]]),
                 [k1], 640, 480, 'equidistant')
    Path('rim.yaml').write_text(camera_yaml(rim, 'rim'), encoding='utf-8')
    assert np.isnan(rim.rays([[0.0, 0.0]])).all()
    assert read_known_camera('rim.yaml').model == 'equidistant'


def test_calibrations_of_two_families_are_compared_in_pixels(capsys):
    """The unified and the extended model are one lens where beta is 1, at another scale."""
    xi = 0.9
    eucm = Camera(K, [xi / (1 + xi), 1], 640, 480, 'eucm')
    matrix = K.copy()
    matrix[[0, 1], [0, 1]] *= 1 + xi
    write_camera('eucm.yaml', 'kalibr', eucm)
    write_camera('ucm.yaml', 'kalibr', Camera(matrix, [xi], 640, 480, 'ucm'))
    assert main(['compare', 'eucm.yaml', 'ucm.yaml']) == 0
    said = capsys.readouterr().out
    assert 'the same, but for rounding' in said and 'focal lengths are those on the axis' in said
    row = next(line for line in said.splitlines() if line.split()[:1] == ['fx'])
    assert row.split()[1:3] == ['260', '260'] and 'alpha' not in said
