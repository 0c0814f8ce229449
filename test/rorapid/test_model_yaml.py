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
import os

import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.rorapid.model import (Conic, Cylinder, Polygon, read_model, WireframeModel,
                                       write_model)
from selfcal_ros.synthetic.object_shapes import SHAPES

SQUARE = 'points: [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]\n'


def _read(tmp_path, text):
    path = tmp_path / 'object.yaml'
    path.write_text(text)
    return read_model(path)


def _assert_same(a, b):
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.lines, b.lines)
    np.testing.assert_array_equal(a.line_min_length_px, b.line_min_length_px)
    assert (a.line_names, a.faces, a.name) == (b.line_names, b.faces, b.name)
    assert [c.name for c in a.conics + a.cylinders] == [c.name for c in b.conics + b.cylinders]
    for c, d in zip(a.conics, b.conics):
        np.testing.assert_array_equal([c.centre, c.axis_u, c.axis_v],
                                      [d.centre, d.axis_u, d.axis_v])
    for c, d in zip(a.cylinders, b.cylinders):
        np.testing.assert_array_equal([c.start, c.end], [d.start, d.end])
        assert (c.radius_m, c.min_length_px) == (d.radius_m, d.min_length_px)


@pytest.mark.parametrize('shape', SHAPES)
def test_what_is_written_is_read_back(tmp_path, shape):
    model = SHAPES[shape]().model
    _assert_same(read_model(write_model(model, tmp_path / 'it.yml')), model)
    assert os.listdir(tmp_path) == ['it.yml']


def test_everything_that_a_model_holds_is_written(tmp_path):
    model = WireframeModel(
        np.arange(12).reshape(4, 3) ** 2 / 7, [[0, 1], [3, 2]],
        [Polygon((0, 1, 2), 'plate: "a"', 12.5)], [Conic([0, 1, 2], [1, 0, 0], [0, 2, 1], 'oval')],
        [Cylinder([0, 0, 0], [0, 0, 1e-3], 1e-5, 'wire', 7)], ['one', ''], [0, 33], 'everything')
    _assert_same(read_model(write_model(model, tmp_path / 'it.yaml')), model)


def test_a_model_by_hand(tmp_path):
    model = _read(tmp_path, SQUARE + """
lines:
- {points: [0, 2], name: seam, min_length_px: 20}
faces:
- [0, 1, 2, 3]
circles:
- {centre: [0.5, 0.5, 0], normal: [0, 0, 2], radius: 1e-1, name: ring}
cylinders:
- {start: [0, 0, 0], end: [0, 0, 1], radius: 0.1}
""")
    assert len(model.lines) == 5 and model.line_names[0] == 'seam'
    assert model.internal.tolist() == [True] + [False] * 4
    ring = model.conics[0].points(np.linspace(0, 6, 9)) - [0.5, 0.5, 0]
    np.testing.assert_allclose(np.linalg.norm(ring, axis=1), 0.1)
    np.testing.assert_allclose(ring[:, 2], 0, atol=1e-15)
    assert model.name == 'object'


def test_borders_can_be_left_untracked(tmp_path):
    model = _read(tmp_path, SQUARE + 'faces: [[0, 1, 2, 3]]\nlines: [[0, 1]]\n'
                  'face_borders: false\n')
    assert model.lines.tolist() == [[0, 1]] and model.line_faces == ((0,),)


@pytest.mark.parametrize('text, says', [
    ('', 'lists'),
    ('- 1\n- 2\n', 'lists'),
    ('points: {a: 1}\n', 'list'),
    ('points: [[0, 0]]\nlines: [[0, 0]]\n', '3 numbers'),
    ('points: [[0, 0, .nan]]\n', 'nan'),
    ('points: [[0, 0, .inf]]\n', 'inf'),
    ('points: [[0, 0, true]]\n', 'True'),
    (SQUARE, 'at least one line'),
    (SQUARE + 'lines: [[0, 9]]\n', 'does not exist'),
    (SQUARE + 'lines: [[0, 1, 2]]\n', 'two points'),
    (SQUARE + 'lines: [[0, -1]]\n', 'numbered from 0'),
    (SQUARE + 'lines: [[0, 0]]\n', 'no length'),
    (SQUARE + 'faces: [[0, 1, 4]]\n', 'Face 0 names a point'),
    (SQUARE + 'faces: [[0, 1]]\n', 'Face 0'),
    (SQUARE + 'faces: [[0, 2, 1, 3]]\n', 'crosses itself'),
    (SQUARE + 'faces: [{points: [0, 1, 2], colour: red}]\n', 'keys'),
    (SQUARE + 'edges: [[0, 1]]\n', "'edges'"),
    (SQUARE + 'lines: [[0, 1]]\nface_borders: maybe\n', 'true or false'),
    (SQUARE + 'circles: [{centre: [0, 0, 0], normal: [0, 0, 0], radius: 1}]\n', 'normal'),
    (SQUARE + 'conics: [{centre: [0, 0, 0], axis_u: [0, 0, 1], axis_v: [0, 0, 2]}]\n', 'plane'),
    (SQUARE + 'cylinders: [{start: [0, 0, 0], end: [0, 0, 0], radius: 1}]\n', 'apart'),
    (SQUARE + 'cylinders: [{start: [0, 0, 0], end: [0, 0, 1], radius: -1}]\n', 'radius'),
    ('points: [\n', 'line 2'),
    ('!!python/object/apply:os.system ["true"]\n', 'not valid YAML'),
    ('[' * 5000, 'YAML'),
    ('a: &a [1, 1]\nb: &b [*a, *a]\npoints: [*b, *b, *b]\n', "'a'"),
])
def test_what_is_wrong_is_said_in_one_sentence(tmp_path, text, says):
    with pytest.raises(InputError) as error:
        _read(tmp_path, text)
    assert says in str(error.value) and '\n' not in str(error.value)
    assert 'object.yaml' in str(error.value)


def test_where_a_model_cannot_be_written(tmp_path):
    model = SHAPES['cube']().model
    for path in (tmp_path / 'no' / 'it.yaml', tmp_path / 'it.stl', tmp_path / 'no' / 'it.cao',
                 tmp_path / 'no' / 'it.obj'):
        with pytest.raises(InputError):
            write_model(model, path)
    assert not os.listdir(tmp_path)


def test_the_size_of_an_object_counts_its_round_parts():
    model = WireframeModel((), cylinders=[Cylinder([0, 0, 0], [0, 0, 1], 0.5)])
    np.testing.assert_allclose(np.ptp(model.extent, axis=0), [1, 1, 1], atol=0.04)
    np.testing.assert_allclose(model.centre, [0, 0, 0.5], atol=1e-12)
    assert abs(model.diameter_m - np.sqrt(3)) < 0.05
    # points that nothing uses do not count
    assert WireframeModel([[0, 0, 0], [1, 0, 0], [9, 9, 9]], [[0, 1]]).diameter_m == 1


def test_vertices_in_the_same_place_count_as_one():
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    wall = [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]]
    model = WireframeModel.build(points + wall, (), [Polygon(range(4)), Polygon(range(4, 8))])
    assert len(model.lines) == 7
    assert sorted(map(len, model.line_faces)) == [1] * 6 + [2]


def test_a_sheet_with_two_sides_keeps_its_edges():
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    model = WireframeModel.build(points, (), [Polygon((0, 1, 2)), Polygon((2, 1, 0))])
    assert len(model.lines) == 3


@pytest.mark.parametrize('arguments', [
    ([[0, 0, np.nan], [1, 0, 0]], [[0, 1]]), ([[0, 0, 0], [1, 0, 0]], [[0, 2]]), ([], []),
    (np.zeros((20_000, 3)), [[0, 1]])])
def test_impossible_models_are_refused(arguments):
    with pytest.raises(ArgumentError):
        WireframeModel(*arguments)
