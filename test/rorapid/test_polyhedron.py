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
"""Meshes of plane faces become polyhedra; all others stay meshes."""

import numpy as np
import pytest
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.synthetic.mesh_scenes import bean
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.polyhedron import polyhedron


def prism(outline, height=0.04, cuts=1):
    """Mesh of a prism over an outline that is seen whole from (1, 1) cm, its sides cut."""
    count = len(outline)
    levels = np.linspace(0, height, cuts + 1)
    rings = [np.column_stack([outline, np.full(count, z)]) for z in levels]
    middle = (0.01, 0.01)
    vertices = np.concatenate([*rings, [[*middle, 0], [*middle, height]]])
    low, high = len(vertices) - 2, len(vertices) - 1
    faces = []
    for k in range(count):
        after = (k + 1) % count
        for level in range(cuts):
            a, b = level * count + k, level * count + after
            faces += [(a, b, b + count), (a, b + count, a + count)]
        faces += [(low, after, k), (high, cuts * count + k, cuts * count + after)]
    return vertices, np.array(faces)


def regular(count, radius=0.05):
    angles = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


L_SHAPE = np.array([[0, 0], [6, 0], [6, 2], [2, 2], [2, 6], [0, 6]]) * 0.01


@pytest.mark.parametrize('outline, cuts', ((regular(4), 1), (regular(4), 3), (regular(6), 2),
                                           (L_SHAPE, 1), (L_SHAPE, 2)))
def test_a_prism_has_its_faces_and_edges_however_it_is_cut(outline, cuts):
    vertices, triangles = prism(outline, cuts=cuts)
    model = polyhedron(MeshModel.build(vertices, triangles, 'prism'))
    count = len(outline)
    assert model.name == 'prism' and len(model.faces) == count + 2
    assert len(model.lines) == 3 * count
    assert sorted(len(face.indices) for face in model.faces) == sorted(
        [4] * count + [count] * 2)
    # the faces enclose what the mesh does
    corners = model.vertices[model.triangles]
    volume = np.linalg.det(corners - vertices.mean(axis=0)).sum() / 6
    x, y = outline.T
    area = 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert abs(volume) == pytest.approx(0.04 * area, rel=1e-9)


def plate_with_a_hole():
    """A square plate with a square hole through it."""
    outer = 0.05 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    inner = 0.4 * outer
    vertices = np.array([[*p, z] for z in (0.0, 0.01) for ring in (outer, inner) for p in ring])
    faces = []
    for k in range(4):
        n = (k + 1) % 4
        for o, i, flip in ((0, 4, False), (8, 12, True)):
            quad = (o + k, i + k, i + n, o + n) if not flip else (o + k, o + n, i + n, i + k)
            faces += [quad[:3], (quad[0], quad[2], quad[3])]
        for low, high, flip in ((0, 8, False), (4, 12, True)):
            quad = (low + k, low + n, high + n, high + k)
            quad = quad[::-1] if flip else quad
            faces += [quad[:3], (quad[0], quad[2], quad[3])]
    return vertices, np.array(faces)


@pytest.mark.parametrize('mesh', (prism(regular(24)), prism(regular(70)), bean(),
                                  plate_with_a_hole(),
                                  (prism(regular(4))[0], prism(regular(4))[1][1:])))
def test_round_open_and_holed_meshes_stay_meshes(mesh):
    assert polyhedron(MeshModel.build(*mesh)) is None


def test_a_cube_of_a_file_is_read_as_a_polyhedron_with_its_remarks(tmp_path):
    vertices, triangles = prism(regular(4))
    turned = triangles.copy()
    turned[0] = turned[0][::-1]
    lines = [f'v {x} {y} {z}' for x, y, z in vertices]
    lines += ['f ' + ' '.join(str(k + 1) for k in face) for face in turned]
    path = tmp_path / 'box.obj'
    path.write_text('\n'.join(lines), encoding='utf-8')
    model = read_model(path)
    assert not isinstance(model, MeshModel) and len(model.faces) == 6 and model.name == 'box'
    assert model.remarks == ('1 face that looked inwards was turned round.',)


def test_a_rough_surface_has_no_creases_and_a_box_with_a_rough_top_keeps_its_edges():
    vertices, faces = bean()
    rng = np.random.default_rng(3)
    rough = vertices * (1 + 0.08 * rng.normal(size=(len(vertices), 1)))
    model = MeshModel.build(rough, faces)
    assert not len(model.lines)
    # every corner is a corner of the smooth surface then: the rim runs all around
    assert len(np.unique(model.smooth)) < 1.1 * len(rough)
    box = MeshModel.build(*prism(regular(4)))
    assert len(box.lines) == 12
