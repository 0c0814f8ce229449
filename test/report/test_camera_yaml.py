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
"""Camera files: exactly what camera_calibration_parsers writes and reads."""

import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_yaml import camera_yaml, read_camera_yaml, write_camera_yaml
import yaml

CAMERA = Camera([[520.123456789012, 0.1 + 0.2, 319.5], [0, 519.0, 1 / 3], [0, 0, 1]],
                [-0.12, 0.05, 1e-05, -2e-17, 0], 640, 480)

TEXT = """\
image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [520.0, 0.0, 319.5, 0.0, 519.0, 239.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.12, 0.05, 1.0e-05, 0.0, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [520.0, 0.0, 319.5, 0.0, 0.0, 519.0, 239.5, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: false
"""


def read(tmp_path, text):
    """Read a camera file with this text."""
    path = tmp_path / 'camera.yaml'
    path.write_text(text)
    return read_camera_yaml(path)


def test_the_text_is_that_of_the_parsers():
    camera = Camera([[520, 0, 319.5], [0, 519, 239.5], [0, 0, 1]], [-0.12, 0.05, 1e-05, 0, 0],
                    640, 480)
    assert camera_yaml(camera, 'front') == TEXT
    with_evidence = camera_yaml(camera, 'front', ['fx 520 +- 0.3\nfy 519', 'a\x00b'])
    assert with_evidence == '# fx 520 +- 0.3\n# fy 519\n# a b\n' + TEXT


def test_round_trip_is_exact(tmp_path):
    path = write_camera_yaml(tmp_path / 'camera.yaml', CAMERA, 'front_left', ['evidence'])
    camera, name = read_camera_yaml(path)
    assert (camera.K == CAMERA.K).all() and (camera.distortion == CAMERA.distortion).all()
    assert (camera.width, camera.height, name) == (640, 480, 'front_left')
    # any YAML reader sees numbers, and P = [K 0]
    document = yaml.safe_load(path.read_text())
    for key in ('camera_matrix', 'distortion_coefficients', 'rectification_matrix',
                'projection_matrix'):
        data = document[key]['data']
        assert all(isinstance(value, float) for value in data)
        assert len(data) == document[key]['rows'] * document[key]['cols']
    P = np.reshape(document['projection_matrix']['data'], (3, 4))
    assert (P[:, :3] == CAMERA.K).all() and not P[:, 3].any()


@pytest.mark.parametrize('name', ['00123', '1e5', 'yes', 'null', '0x1F', 'No', '_', 'cam_0'])
def test_names_that_yaml_would_change(tmp_path, name):
    path = write_camera_yaml(tmp_path / 'camera.yaml', CAMERA, name)
    assert read_camera_yaml(path)[1] == name
    assert yaml.safe_load(path.read_text())['camera_name'] == name


def test_a_name_written_without_quotes_is_kept(tmp_path):
    assert read(tmp_path, TEXT.replace('name: front', 'name: 00123'))[1] == '00123'
    assert read(tmp_path, TEXT.replace('camera_name: front\n', ''))[1] == 'unknown'


def test_impossible_cameras_to_write(tmp_path):
    for name in ('', 'a b', '../x', 'é', 'a\nb'):
        with pytest.raises(ArgumentError, match='name'):
            write_camera_yaml(tmp_path / 'a.yaml', CAMERA, name)
    with pytest.raises(ArgumentError, match='size'):
        write_camera_yaml(tmp_path / 'a.yaml', Camera(np.eye(3)), 'a')
    assert list(tmp_path.iterdir()) == []


def test_what_other_writers_produce(tmp_path):
    # numbers that PyYAML takes for strings, integers, four coefficients, no model
    text = TEXT.replace('1.0e-05', '1e-05').replace('520.0', '520').replace(
        'distortion_model: plumb_bob\n', '')
    camera, _ = read(tmp_path, text)
    assert camera.distortion[2] == 1e-05 and camera.K[0, 0] == 520
    text = TEXT.replace('cols: 5\n  data: [-0.12, 0.05, 1.0e-05, 0.0, 0.0]',
                        'cols: 4\n  data: [-0.12, 0.05, 1.0e-05, 0.0]')
    assert read(tmp_path, text)[0].distortion[0] == -0.12
    block = TEXT.replace('data: [-0.12, 0.05, 1.0e-05, 0.0, 0.0]',
                         'data:\n    - -0.12\n    - 0.05\n    - 1.0e-05\n    - 0\n    - 0')
    assert read(tmp_path, block)[0].distortion[0] == -0.12
    assert read(tmp_path, '\ufeff' + TEXT)[1] == 'front'


@pytest.mark.parametrize('text, words', [
    ('%YAML:1.0\n---\nM: 1', 'OpenCV FileStorage .*selfcal convert'),
    ('camera_matrix: !!opencv-matrix\n  rows: 3', 'OpenCV FileStorage'),
    ('cam0:\n  camera_model: pinhole\n  intrinsics: [1, 2, 3, 4]\n', 'Kalibr .*selfcal convert'),
    ('image_width: 3\n', 'lacks image_height, camera_matrix'),
    ('', 'no keys'), ('- 1\n', 'no keys'), ('a: [1, 2', 'not valid YAML'),
    ('!!python/object/apply:os.system [ls]', 'not valid YAML'),
    ('a: !!timestamp x', 'not valid YAML'), ('a: !!int x', 'not valid YAML'),
    ('[' * 3000, 'not valid YAML'),
    (TEXT.replace('-0.12, 0.05,', '-0.12 0.05'), 'commas'),
    (TEXT.replace('[-0.12, 0.05, 1.0e-05, 0.0, 0.0]', '[-0.12 0.05 1 0 0]'), 'with commas'),
    (TEXT.replace('[-0.12, 0.05, 1.0e-05, 0.0, 0.0]', '-0.12 0.05 1 0 0'), 'with commas'),
    (TEXT.replace('-0.12', '.nan'), 'not a number'),
    (TEXT.replace('-0.12', 'nan'), 'not finite'),
    (TEXT.replace('cols: 5', 'cols: 4'), '1xn'),
    (TEXT.replace('cols: 4', 'cols: 3'), '3x4'),
    (TEXT.replace('rows: 3\n  cols: 3', 'lines: 3\n  cols: 3'), 'rows, cols and data'),
    (TEXT.replace('width: 640', 'width: -1'), 'positive integer'),
    (TEXT.replace('520.0', '0.0'), 'not calibrated'),
    (TEXT.replace('520.0', '-520.0'), 'positive focal'),
    (TEXT.replace('plumb_bob', 'magic'), "'magic' is not supported; plumb_bob, rational"),
    (TEXT.replace('plumb_bob', 'equidistant').replace('0.0, 0.0]', '0.0, 0.1]', 1),
     'equidistant has 4 coefficients, not 5'),
    (TEXT.replace('plumb_bob', 'equidistant').replace('cols: 5', 'cols: 3', 1).replace(
        ', 0.0, 0.0]', ']', 1), 'equidistant has 4 coefficients, not 3'),
    ('a' * 1_000_001, 'too large'),
])
def test_wrong_files(tmp_path, text, words):
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path)) and len(str(caught.value)) < 600


def test_missing_and_binary_files(tmp_path):
    for path, words in ((tmp_path / 'missing.yaml', 'cannot be read'), (tmp_path, 'is a folder')):
        with pytest.raises(InputError, match=words):
            read_camera_yaml(path)
    (tmp_path / 'binary.yaml').write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match='not text'):
        read_camera_yaml(tmp_path / 'binary.yaml')
