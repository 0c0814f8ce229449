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
from pathlib import Path

import numpy as np
import pytest

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.model import (
    Cylinder, Polygon, read_model, WireframeModel, write_model)

TETRAHEDRON = """V1
# 3D points
4            # Number of points
0 0 0        // point with index 0

  1.0 0 0    first remark, without any sign
0 1e0 0 # another
0 0 +1.
# 3D lines
{lines}
# faces from lines
{faces_from_lines}
# faces from points
{faces}
"""
SIX_LINES = '6\n0 1\n0 2 name=left\n0 3\n1 2\n2 3 name="the long one"\n1 3'


def _write(tmp_path, text, name='object.cao'):
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def _tetrahedron(lines='0', faces_from_lines='0', faces='0'):
    return TETRAHEDRON.format(lines=lines, faces_from_lines=faces_from_lines, faces=faces)


def _pairs(model):
    return {frozenset(pair) for pair in model.lines.tolist()}


def _shared(name):
    for parent in Path(__file__).resolve().parents:
        if (parent / 'shared' / 'data' / name).is_file():
            return parent / 'shared' / 'data' / name
    pytest.skip(f'the model shared/data/{name} is not beside the repository')


def test_faces_from_points_give_every_edge_once(tmp_path):
    model = read_model(_write(tmp_path, _tetrahedron(
        faces='4\n3 0 1 2 name=bottom # remark\n3 0\n1 3\n3 0 2 3\n3 1 2 3 useLod=true')))
    assert len(model.lines) == 6 == len(_pairs(model))
    assert [face.name for face in model.faces] == ['bottom', '', '', '']
    assert [face.min_area_px2 for face in model.faces] == [0, 0, 0, 2500]
    assert all(len(sides) == 2 for sides in model.line_faces)
    assert not model.internal.any()
    np.testing.assert_allclose(model.diameter_m, np.sqrt(3))
    assert model.name == 'object'


def test_faces_from_lines_are_chained_in_any_order_and_direction(tmp_path):
    # lines 5 = 1-3, 4 = 2-3, 3 = 1-2 bound the slanted face; 0, 3, 1 the bottom
    model = read_model(_write(tmp_path, _tetrahedron(SIX_LINES, '2\n3 5 4 3 name=slope\n3 1 0 3')))
    assert [set(face.indices) for face in model.faces] == [{1, 2, 3}, {0, 1, 2}]
    assert model.faces[0].name == 'slope'
    assert model.line_names == ('', 'left', '', '', 'the long one', '')
    assert model.line_faces[3] == (0, 1) and model.line_faces[2] == ()
    assert model.internal.tolist() == [False, False, True, False, False, False]


def test_lines_are_taken_without_faces_and_with_thresholds(tmp_path):
    model = read_model(_write(tmp_path, _tetrahedron(
        '3\n0 1 minLineLengthThreshold=20 useLod=true\n0 2 useLod=true\n'
        '0 3 minLineLengthThresh=20 useLod=false name=off')))
    assert model.lines.tolist() == [[0, 1], [0, 2], [0, 3]]
    assert model.line_min_length_px.tolist() == [20, 50, 0]
    assert model.line_names == ('', '', 'off')


def test_cylinders_and_circles(tmp_path):
    text = _tetrahedron('1\n0 1') + ('# cylinders\n2\n0 3 0.25 name=pipe\n1 2 .1\n# circles\n'
                                     '1\n0.5 0 1 2 name="rim"\n')
    model = read_model(_write(tmp_path, text))
    pipe, second = model.cylinders
    assert pipe.name == 'pipe' and pipe.radius_m == 0.25 and second.radius_m == 0.1
    np.testing.assert_allclose([pipe.start, pipe.end], [[0, 0, 0], [0, 0, 1]])
    rim, = model.conics
    assert rim.name == 'rim'
    points = rim.points(np.linspace(0, 6, 20))
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.5)
    np.testing.assert_allclose(points[:, 2], 0, atol=1e-15)


def test_old_files_end_before_the_cylinders(tmp_path):
    assert len(read_model(_write(tmp_path, _tetrahedron(faces='1\n3 0 1 2'))).lines) == 3


def test_version_2_has_image_coordinates_behind_the_points(tmp_path):
    text = 'V2\n2\n0 0 0 100 200\n1 0 0 7 8\n1\n0 1\n0\n0\n'
    np.testing.assert_allclose(read_model(_write(tmp_path, text)).vertices[1], [1, 0, 0])


def test_a_face_of_two_points_is_a_line(tmp_path):
    model = read_model(_write(tmp_path, _tetrahedron(faces='1\n2 0 3 name=rod')))
    assert model.lines.tolist() == [[0, 3]] and not model.faces and model.line_names == ('rod',)


def test_the_diagonal_of_a_triangulated_square_is_no_edge(tmp_path):
    text = 'V1\n4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n{}\n0\n2\n3 0 1 2\n3 0 2 3\n'
    assert frozenset((0, 2)) not in _pairs(read_model(_write(tmp_path, text.format('0'))))
    # unless it is asked for
    assert frozenset((0, 2)) in _pairs(read_model(_write(tmp_path, text.format('1\n2 0'))))


def test_loaded_files_are_placed_by_nested_transforms(tmp_path):
    part = 'V1\n2\n0 0 0\n1 0 0\n1\n0 1 name=arm\n0\n0\n'
    _write(tmp_path, part, 'parts/inner/arm.cao')
    _write(tmp_path, 'V1\nload("inner/arm.cao", tu=[0; 0; 90 deg], t=[0; 0; 2])\n',
           'parts/pair.cao')
    path = _write(tmp_path, 'V1\n# all\nload("parts/pair.cao", t=[5; 0.0; 0], '
                  'R=[1;0;0;0;0;-1;0;1;0]) # remark = here\nload("parts/inner/arm.cao", '
                  'tu=[0.1 rad; 0.2; -0.3])\n2\n0 0 0\n0 0 9\n1\n1 0\n0\n0\n')
    model = read_model(path)
    about_x = rotation_matrix([np.pi / 2, 0, 0])
    expected = [about_x @ [0, 0, 2] + [5, 0, 0], about_x @ [0, 1, 2] + [5, 0, 0], [0, 0, 0],
                rotation_matrix([0.1, 0.2, -0.3])[:, 0], [0, 0, 0], [0, 0, 9]]
    np.testing.assert_allclose(model.vertices, expected, atol=1e-12)
    assert model.lines.tolist() == [[0, 1], [2, 3], [5, 4]]
    assert model.line_names == ('arm', 'arm', '')


@pytest.mark.parametrize('text, says', [
    ('', 'the version'),
    ('hello\n', 'version'),
    ('V1\n2\n0 0 0\n', 'ends'),
    ('V1\n1\n0 zero 0\n', 'line 3'),
    ('V1\n2\n0 0 nan\n0 0 1\n', 'finite'),
    ('V1\n2\n0 0 inf\n0 0 1\n', 'finite'),
    ('V1\n1\n0 0 1e9\n', 'too far'),
    ('V1\n99999999999\n', 'at most'),
    ('V1\n-4\n', 'at most'),
    ('V1\n2\n0 0 0\n0 0 0\n1\n0 1\n', 'no length'),
    (_tetrahedron('1\n0 4'), 'no point 4'),
    (_tetrahedron('1\n-1 2'), 'no point -1'),
    (_tetrahedron(faces='1\n3 0 1 7'), 'no point 7'),
    (_tetrahedron(faces='1\n3 0 1 1'), 'twice'),
    (_tetrahedron(faces='1\n1 0'), '2 to'),
    (_tetrahedron(faces='1\n999999 0'), '2 to'),
    (_tetrahedron(SIX_LINES, '1\n3 0 1 9'), 'does not exist'),
    (_tetrahedron(SIX_LINES, '1\n3 0 1 2'), 'do not close'),
    (_tetrahedron(), 'at least one line'),
    (_tetrahedron('1\n0 1') + '1\n0 1 -2\n', 'radius'),
    (_tetrahedron('1\n0 1') + '0\n1\n0.5 0 1 1\n', 'span'),
    ('V1\nload("missing.cao")\n', 'No such file'),
    ('V1\nload(missing.cao)\n', 'form'),
    ('V1\nload("object.cao")\n', 'in turn'),
    ('V1\nload("x.cao", t=[1; 2])\n', 't=[1; 2]'),
    ('V1\nload("x.cao", R=[1;0;0;0;1;0;0;0;2])\n', 'rotation'),
])
def test_what_is_wrong_is_said_in_one_sentence(tmp_path, text, says):
    path = _write(tmp_path, text)
    with pytest.raises(InputError) as error:
        read_model(path)
    sentence = str(error.value)
    assert says in sentence and '\n' not in sentence and 'cao' in sentence
    assert len(sentence) < 400 + 2 * len(str(tmp_path))


def test_a_tower_of_loads_is_stopped(tmp_path):
    # every file loads the next one ten times: 10 ** 9 files in all
    for level in range(9):
        _write(tmp_path, 'V1\n' + f'load("{level + 1}.cao")\n' * 10, f'{level}.cao')
    _write(tmp_path, 'V1\n2\n0 0 0\n0 0 1\n1\n0 1\n0\n0\n', '9.cao')
    with pytest.raises(InputError, match='too many'):
        read_model(tmp_path / '0.cao')


def test_files_that_are_no_text_or_no_file(tmp_path):
    (tmp_path / 'x.cao').write_bytes(b'V1\n\xff\xfe\x00')
    for path in (tmp_path / 'x.cao', tmp_path / 'no.cao', tmp_path, tmp_path / 'x.wrl'):
        with pytest.raises(InputError):
            read_model(path)


@pytest.mark.parametrize('name, lines, size', [
    ('visp_mbt_cube/cube.cao', 12, [0.084, 0.084, 0.084]),
    ('visp_mbt_cube/cube_and_cylinder.cao', 12, None),
    ('visp_tracking_videos/cube.cao', 12, [0.084, 0.084, 0.084]),
    ('visp_tracking_videos/teabox.cao', 12, [0.165, 0.068, 0.08]),
])
def test_models_of_others(name, lines, size):
    model = read_model(_shared(name))
    assert len(model.lines) == lines and len(model.faces) == 6
    if size:
        np.testing.assert_allclose(np.ptp(model.extent, axis=0), size)
    # closed boxes: every edge lies between two faces
    assert all(len(sides) == 2 for sides in model.line_faces)


def test_a_model_of_others_whose_parts_are_missing_names_the_part():
    path = _shared('visp_tracking_videos/lego-square.cao')
    if (path.parent / 'lego_parts').is_dir():
        assert len(read_model(path).faces) == 24
    else:
        with pytest.raises(InputError, match='brick-2x4.cao'):
            read_model(path)


def test_least_sizes_in_the_image_are_written(tmp_path):
    square = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]
    model = WireframeModel.build(
        square, [[0, 2], [0, 1]], [Polygon(range(4), 'top', 900.0)], ['seam', ''], [50.0, 20.0],
        cylinders=[Cylinder([0.3, 0, 0], [0.3, 0.1, 0], 0.02, 'pipe', 35.0)])
    again = read_model(write_model(model, tmp_path / 'again.cao'))
    least = {frozenset(pair): length for pair, length in zip(
        again.lines.tolist(), again.line_min_length_px)}
    assert len(least) == 5 and least[frozenset((0, 2))] == 50 and least[frozenset((0, 1))] == 20
    assert sum(length > 0 for length in least.values()) == 2
    assert again.faces[0].min_area_px2 == 900 and again.cylinders[0].min_length_px == 35
