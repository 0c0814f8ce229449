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
"""Meshes: files read, bad ones refused in a sentence, smooth parts followed by their outline."""

from functools import lru_cache

import numpy as np
import pytest

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.model import read_model
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerOptions, TrackerState
from selfcal_ros.rorapid.visibility.visible_mesh import VisibleMesh
from selfcal_ros.synthetic.mesh_scenes import bean, handle, MeshRenderer, ring
from selfcal_ros.synthetic.objects import object_poses, perturbed
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.mesh_orientation import edges_of
from selfcal_ros.values.mesh_simplified import simplified

CAMERA = Camera(np.array([[520, 0, 320], [0, 520, 240], [0, 0, 1.0]]), (), 640, 480)
CUBE = np.array([[x, y, z] for x in (0, 40) for y in (0, 40) for z in (0, 40)], float)
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def triangles():
    return np.array([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))])


def obj(path, vertices=CUBE, extra=''):
    path.write_text(extra + ''.join(f'v {x} {y} {z}\n' for x, y, z in vertices) + ''.join(
        'f ' + ' '.join(f'{i + 1}/1/1' for i in side) + '\n' for side in SIDES))
    return path


def stl(path):
    corners = CUBE[triangles()].astype('<f4')
    record = np.zeros(len(corners), np.dtype([('n', '<f4', 3), ('c', '<f4', (3, 3)),
                                              ('r', '<u2')]))
    record['c'] = corners
    path.write_bytes(bytes(80) + len(corners).to_bytes(4, 'little') + record.tobytes())
    return path


def stl_text(path):
    path.write_text('solid cube\n' + ''.join(
        'facet normal 0 0 0\nouter loop\n' + ''.join(f'vertex {x} {y} {z}\n' for x, y, z in face)
        + 'endloop\nendfacet\n' for face in CUBE[triangles()]) + 'endsolid\n')
    return path


def ply(path, binary=False):
    kind = 'binary_little_endian' if binary else 'ascii'
    head = (f'ply\nformat {kind} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n'
            'property float z\nelement face 6\nproperty list uchar int vertex_indices\n'
            'end_header\n')
    if binary:
        body = CUBE.astype('<f4').tobytes() + b''.join(
            b'\x04' + np.array(side, '<i4').tobytes() for side in SIDES)
    else:
        body = ''.join(f'{x} {y} {z}\n' for x, y, z in CUBE).encode() + ''.join(
            '4 ' + ' '.join(map(str, side)) + '\n' for side in SIDES).encode()
    path.write_bytes(head.encode() + body)
    return path


@pytest.mark.parametrize('write, name', (
    (obj, 'a.obj'), (stl, 'a.stl'), (stl_text, 'b.stl'), (ply, 'a.ply'),
    (lambda path: ply(path, binary=True), 'b.ply')))
def test_every_format_gives_the_same_cube(tmp_path, write, name):
    model = read_model(write(tmp_path / name), 0.001)
    assert len(model.vertices) == 8 and len(model.triangles) == 12 and not model.remarks
    assert len(model.lines) == 12              # the diagonals are no edges
    assert model.diameter_m == pytest.approx(0.04 * 3**0.5)


@pytest.mark.parametrize('text, words', (
    ('v 0 0 0\nv 1 0 0\nv 0 1 0\n', 'no faces'),
    ('v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n', 'finite'),
    ('v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n', 'area'),
    ('v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n', 'does not exist'),
    ('v 0 0 0\nv 100 0 0\nv 0 100 0\nf 1 2 3\n', 'say its unit with --model-scale'),
    ('v 0 0 x\n', 'cannot be read')))
def test_what_is_wrong_with_a_file_is_one_sentence(tmp_path, text, words):
    path = tmp_path / 'bad.obj'
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_model(path)


def test_an_absurd_size_with_a_stated_scale_asks_for_another(tmp_path):
    path = tmp_path / 'bad.obj'
    path.write_text('v 0 0 0\nv 0.3 0 0\nv 0 0.4 0\nf 1 2 3\n')
    with pytest.raises(InputError, match='0.0005 m large with --model-scale 0.001; choose'):
        read_model(path, scale=0.001)


def test_a_text_or_half_a_file_is_no_stl(tmp_path):
    for content in (b'some notes\n', bytes(80) + b'\x0c\0\0\0' + bytes(90)):
        (tmp_path / 'h.stl').write_bytes(content)
        with pytest.raises(InputError, match='h.stl cannot be read as stl: it does not begin'):
            read_model(tmp_path / 'h.stl')


def test_a_ply_without_a_format_is_one_sentence(tmp_path):
    path = ply(tmp_path / 'bad.ply')
    for instead in (b'', b'format\n', b'format odd 1.0\n'):
        path.write_bytes(ply(path).read_bytes().replace(b'format ascii 1.0\n', instead))
        with pytest.raises(InputError, match='names no format|cannot be read'):
            read_model(path)


@pytest.mark.parametrize('count', (b'8' + b'0' * 30, b'-1', b'0', b'8' * 5000))
def test_a_ply_with_an_absurd_count_is_one_sentence(tmp_path, count):
    for binary in (False, True):
        path = ply(tmp_path / 'bad.ply', binary=binary)
        path.write_bytes(path.read_bytes().replace(b'vertex 8', b'vertex ' + count))
        with pytest.raises(InputError, match='cannot be|holds no points'):
            read_model(path)


@pytest.mark.parametrize('turn', range(6))
def test_a_concave_face_is_cut_inside_itself(tmp_path, turn):
    """An L of 72 cm3, each of its two concave faces one polygon that may begin at any corner."""
    corners = np.roll([(0, 0), (8, 0), (8, 2), (2, 2), (2, 6), (0, 6)], turn, axis=0) / 100
    vertices = np.concatenate([np.column_stack([corners, np.full(6, z)]) for z in (0, 0.03)])
    faces = [range(5, -1, -1), range(6, 12)] + [
        (k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6) for k in range(6)]
    written = tmp_path / 'l.obj', tmp_path / 'l.ply'
    written[0].write_text(''.join(f'v {x} {y} {z}\n' for x, y, z in vertices) + ''.join(
        'f ' + ' '.join(str(k + 1) for k in face) + '\n' for face in faces))
    written[1].write_text(
        'ply\nformat ascii 1.0\nelement vertex 12\nproperty float x\nproperty float y\n'
        'property float z\nelement face 8\nproperty list uchar int vertex_indices\nend_header\n'
        + ''.join(f'{x} {y} {z}\n' for x, y, z in vertices)
        + ''.join(f'{len(face)} ' + ' '.join(map(str, face)) + '\n' for face in faces))
    for path in written:
        model = read_model(path)
        volume = np.linalg.det(model.vertices[model.triangles]).sum() / 6
        assert volume == pytest.approx(72e-6) and len(model.lines) == 18 and not model.remarks


def test_files_that_are_legal_but_odd_are_read(tmp_path):
    as_written = stl_text(tmp_path / 'a.stl').read_text()
    (tmp_path / 'a.stl').write_text(as_written.upper())
    (tmp_path / 'b.stl').write_bytes(stl(tmp_path / 'b.stl').read_bytes() + b'more')
    text = obj(tmp_path / 'a.obj').read_text()
    (tmp_path / 'a.obj').write_bytes(text.replace(' 40.0 ', ' 40.0 \\\r\n ').encode())
    # a property before the list, another list, and faces of three and of four corners in turn
    faces = [face for face in SIDES[::2]] + [t for face in SIDES[1::2] for t in (
        face[:3], (face[0], *face[2:]))]
    faces = [faces[k] for k in (0, 3, 4, 1, 5, 6, 2, 7, 8)]
    for name, kind in (('a.ply', 'ascii'), ('b.ply', 'binary_big_endian')):
        rows = [b'\x07' + b'\x01' + np.array([1], '>f4').tobytes() + bytes([len(face)])
                + np.array(face, '>i4').tobytes() if kind[0] == 'b' else
                f'7 1 1.0 {len(face)} {" ".join(map(str, face))}\n'.encode() for face in faces]
        places = CUBE.astype('>f4').tobytes() if kind[0] == 'b' else ''.join(
            f'{x} {y} {z}\n' for x, y, z in CUBE).encode()
        (tmp_path / name).write_bytes(
            f'ply\nformat {kind} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n'
            f'property float z\nelement face {len(faces)}\nproperty uchar flags\nproperty list '
            'uchar float texcoord\nproperty list uchar int vertex_index\nend_header\n'.encode()
            + places + b''.join(rows))
    for name in ('a.stl', 'b.stl', 'a.obj', 'a.ply', 'b.ply'):
        model = read_model(tmp_path / name, 0.001)
        assert len(model.vertices) == 8 and len(model.triangles) == 12 and not model.remarks
    (tmp_path / 'none.stl').touch()
    with pytest.raises(InputError, match='none.stl is empty'):
        read_model(tmp_path / 'none.stl')


def test_faces_that_are_given_twice_are_told():
    vertices, faces = ring()
    model = MeshModel.build(vertices, np.concatenate([faces, faces[:7, ::-1]]))
    assert model.remarks == ('7 faces that are given twice were left out once.',)


def test_a_missing_texture_does_no_harm(tmp_path):
    extra = 'mtllib nowhere.mtl\nusemtl gone\n'
    assert len(read_model(obj(tmp_path / 'a.obj', extra=extra), 0.001).lines) == 12


def test_open_meshes_flat_faces_and_too_many_are_told():
    vertices, faces = ring()
    opened = MeshModel.build(vertices, np.concatenate([faces[10:], [[0, 1, 1], [2, 2, 2]]]))
    assert any('open' in remark for remark in opened.remarks)
    assert any('2 faces without area' in remark for remark in opened.remarks)
    n = 130
    grid = np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) / n
    sheet = np.column_stack([grid, 0.2 * np.sin(9 * grid[:, 0])])
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    many = np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)])
    model = MeshModel.build(sheet, many)
    assert len(many) > 20_000 >= len(model.triangles) > 500
    # remarks are about the file, not about what simplifying makes of it
    sides = 4 * (n - 1)
    assert f'The mesh is open: {sides} edges bound one face only.' in model.remarks
    assert np.allclose(np.ptp(model.vertices, axis=0), np.ptp(sheet, axis=0), atol=1e-6)
    # the surface is known: 0.2 sin(9 x)
    assert np.abs(model.vertices[:, 2] - 0.2 * np.sin(9 * model.vertices[:, 0])).max() < 2e-4


def divided(vertices, faces, times):
    """Cut each face into four, so many times."""
    for _ in range(times):
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        n = 3 * np.arange(len(faces))[:, None] + len(vertices)
        halves = np.stack([a + b, b + c, c + a], axis=1).reshape(-1, 3) / 2
        vertices = np.concatenate([vertices, halves])
        one, two, three = faces.T[..., None]
        faces = np.concatenate([np.hstack(part) for part in (
            (one, n, n + 2), (two, n + 1, n), (three, n + 2, n + 1), (n, n + 1, n + 2))])
    return vertices, faces


def test_a_thin_sheet_of_many_faces_stays_as_it_is():
    """A plate of 100 x 100 x 0.5 mm: both its sides, its borders and its corners."""
    vertices, faces = divided((CUBE / 40) * [0.1, 0.1, 0.0005], triangles(), 4)
    _, first, index = np.unique(vertices.round(9), axis=0, return_index=True,
                                return_inverse=True)
    fewer = simplified(vertices[first], index[faces], 1500)
    # what is flat goes on to shrink
    assert len(fewer[1]) < 100 < 1500 < len(faces) == 3072 and fewer[2] < 1e-9
    corners = fewer[0][fewer[1]]
    assert np.linalg.det(corners).sum() / 6 == pytest.approx(0.1 * 0.1 * 0.0005, rel=1e-6)
    assert np.allclose(np.abs(fewer[0] / [0.1, 0.1, 0.0005] - 0.5).max(axis=1), 0.5)
    assert not len(np.setdiff1d(edges_of(fewer[1])[1], 2))


def test_the_outline_of_a_ball_is_its_rim():
    """Seen from a distance d a ball of radius r shows the circle of radius r sqrt(1 - (r/d)^2)."""
    v, u = np.meshgrid(np.linspace(0, np.pi, 60), np.arange(120) * np.pi / 60, indexing='ij')
    points = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], -1)
    r, c = np.meshgrid(np.arange(59), np.arange(120), indexing='ij')
    a, b = (r * 120 + c).ravel(), (r * 120 + (c + 1) % 120).ravel()
    faces = np.concatenate([np.stack([a, a + 120, b + 120], 1), np.stack([a, b + 120, b], 1)])
    visible = VisibleMesh(MeshModel.build(points.reshape(-1, 3), faces))
    seen = visible.control_points(np.eye(3), [0, 0, 4.0])
    place = seen.object_points
    assert len(place) > 60 and not len(visible.model.lines)
    assert np.allclose(np.hypot(*place.T[:2]), (1 - 1 / 16)**0.5, atol=3e-3)
    assert np.allclose(place[:, 2], -0.25, atol=0.03)
    assert np.abs((place * seen.tangents).sum(axis=1)).max() < 0.01


def test_a_rim_before_another_part_is_searched_but_need_not_show():
    small, large = bean(), bean()
    shift, camera_m = np.array([0.0, 0.0, -0.12]), 0.6
    for ball, radius_m in ((small, 0.02), (large, 0.06)):
        ball[0][:] *= radius_m / np.linalg.norm(ball[0], axis=1, keepdims=True)
    vertices = np.concatenate([small[0] + shift, large[0]])
    visible = VisibleMesh(MeshModel.build(
        vertices, np.concatenate([small[1], large[1] + len(small[0])]), 'two balls'))
    points = visible.control_points(np.eye(3), [0, 0, camera_m])
    before = (points.primitive >= visible.outline) & (points.primitive < visible.limb)
    assert before.sum() == 36 and not points.inward[before].any()
    # each lies where a ray from the camera touches the small ball, and goes on to the large one
    place, centre = points.object_points[before], np.array([0, 0, -camera_m])
    assert np.linalg.norm(place - shift, axis=1) == pytest.approx(0.02, rel=0.01)
    rays = (place - centre) / np.linalg.norm(place - centre, axis=1, keepdims=True)
    assert np.abs(((place - shift) * rays).sum(axis=1)).max() < 0.05 * 0.02
    assert np.linalg.norm(np.cross(rays, centre), axis=1).max() < 0.06
    # and all around it
    turn = np.sort(np.arctan2(*place[:, :2].T))
    assert np.diff(turn, append=turn[0] + 2 * np.pi).max() < np.deg2rad(25)
    outline = points.object_points[points.primitive >= visible.limb]
    assert np.linalg.norm(outline, axis=1) == pytest.approx(0.06, rel=0.01)


@pytest.mark.parametrize('method', ('rorapid', 'rapid'))
def test_the_methods_of_the_thesis_follow_creases_of_any_length(method):
    """A sheet of 12 by 7 cm: its sides have as many control points as they are long."""
    vertices = np.array([[-0.06, -0.035, 0], [0.06, -0.035, 0], [0.06, 0.035, 0],
                         [-0.06, 0.035, 0]])
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    model, drawn = MeshModel.build(vertices, faces, 'sheet'), MeshRenderer(vertices, faces, CAMERA)
    tracker = RorapidTracker(model, CAMERA, TrackerOptions(method=method))
    for k in range(6):
        pose = np.column_stack([rotation_matrix([0.5, 0.3 + 0.01 * k, 0.2]), [0.002 * k, 0, 0.4]])
        if not k:
            tracker.start(pose[:, :3], pose[:, 3] + [0.002, -0.001, 0.003])
        found = tracker.track(drawn.render(pose, np.random.default_rng(k), 1.0))
        assert found.state is TrackerState.TRACKING
    turn = np.linalg.norm(rotation_vector(found.rotation @ pose[:, :3].T))
    assert turn < np.deg2rad(2) and np.linalg.norm(found.translation - pose[:, 3]) < 0.002


@lru_cache(maxsize=None)
def followed():
    vertices, faces = ring()
    model = MeshModel.build(vertices, faces, 'ring')
    drawn = MeshRenderer(vertices, faces, CAMERA, np.random.default_rng(2))
    poses = object_poses('general', 10, model.diameter_m, speed=0.7)
    tracker = RorapidTracker(model, CAMERA)
    tracker.start(*perturbed(poses[0][:, :3], poses[0][:, 3], np.random.default_rng(3), 0.05,
                             0.003))
    return poses, [tracker.track(drawn.render(pose, np.random.default_rng(k), 1.0))
                   for k, pose in enumerate(poses)]


def test_a_smooth_part_is_followed_by_its_outline():
    poses, frames = followed()
    assert all(frame.state is TrackerState.TRACKING for frame in frames)
    for pose, frame in zip(poses, frames):
        assert np.linalg.norm(frame.translation - pose[:, 3]) < 0.01 * np.linalg.norm(pose[:, 3])
        turn = rotation_vector(frame.rotation @ pose[:, :3].T)
        assert np.rad2deg(np.linalg.norm(turn)) < 2


def test_faces_that_look_inwards_are_turned_round():
    vertices, faces = ring()
    right = MeshModel.build(vertices, faces)
    assert not right.remarks
    some = faces.copy()
    pick = np.random.default_rng(0).choice(len(faces), 700, replace=False)
    some[pick] = some[pick, ::-1]
    for wrong in (some, faces[:, ::-1]):
        model = MeshModel.build(vertices, wrong)
        assert np.allclose(model.normals, right.normals) and not len(model.lines)
        turned = int((wrong != faces).any(axis=1).sum())
        assert model.remarks == (f'{turned} faces that looked inwards were turned round.',)


def cube(side, centre=(0, 0, 0)):
    return (CUBE / 40 - 0.5) * side + centre, triangles()


def joined(*parts):
    """One mesh of several, each (vertices, faces)."""
    first = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    return (np.concatenate([vertices for vertices, _ in parts]),
            np.concatenate([faces + at for (_, faces), at in zip(parts, first)]))


def test_each_body_looks_outwards_and_voids_stay():
    """A file of several bodies, one of them inside out; another has a void in it."""
    large, small, void = cube(0.1), cube(0.03, (0.2, 0, 0)), cube(0.04)
    # 18 faces, of which the small body's 12 look inwards
    vertices, faces = joined(large, (small[0], small[1][:, ::-1]), (void[0], void[1][:, ::-1]))
    model = MeshModel.build(vertices, faces)
    corners = model.vertices[model.triangles]
    volume = np.linalg.det(corners) / 6
    centre = corners.mean(axis=1)
    whose = np.where(centre[:, 0] > 0.1, 1, np.where(np.abs(centre).max(axis=1) > 0.03, 0, 2))
    assert np.allclose(np.bincount(whose, volume), [0.1**3, 0.03**3, -0.04**3])
    assert model.remarks == ('12 faces that looked inwards were turned round.',)
    # two bodies whose boxes hold each other, but not the bodies: both are mended
    ringed = joined(ring(0.3), cube(0.01))
    turned = MeshModel.build(ringed[0], np.concatenate([ringed[1][:-12], ringed[1][-12:, ::-1]]))
    assert np.allclose(turned.normals, MeshModel.build(*ringed).normals)


def test_pieces_that_hang_apart_keep_the_way_they_look():
    """A ring of faces that have no edge in common: each is a flat part of its own."""
    vertices, faces = ring()
    corners = vertices[faces]
    apart = (0.9 * corners + 0.1 * corners.mean(axis=1, keepdims=True)).reshape(-1, 3)
    pieces = np.arange(len(apart)).reshape(-1, 3)
    right = MeshModel.build(vertices, faces).normals
    for given in (pieces, pieces[:, ::-1]):
        assert np.allclose(MeshModel.build(apart, given).normals, right)


def test_vertices_that_noise_parts_are_joined():
    vertices, faces = ring()
    soup = vertices[faces].reshape(-1, 3)
    soup += 2e-7 * np.ptp(vertices) * np.random.default_rng(0).standard_normal(soup.shape)
    model = MeshModel.build(soup, np.arange(len(soup)).reshape(-1, 3))
    assert len(model.vertices) == len(vertices) and not len(model.lines) and not model.remarks


def test_the_renderer_draws_a_part_neither_wider_nor_narrower():
    """The area of a cube seen along an axis is known."""
    model = MeshModel.build(CUBE / 1000 - 0.02, triangles())
    pose = np.column_stack([np.eye(3), [0.003, -0.002, 0.32]])
    image = MeshRenderer(model.vertices, model.triangles, CAMERA).render(pose)
    side = 520 * 0.04 / 0.3
    part = image[200:280, 280:370].astype(float) - 70
    assert np.sqrt(part.sum() / part[35:45, 40:50].mean()) == pytest.approx(side, abs=0.08)


@pytest.mark.long
@pytest.mark.parametrize('part, speed, first', ((ring, 0.9, 60), (handle, 0.9, 60)))
def test_a_patterned_part_is_followed_by_its_pattern_too(part, speed, first):
    vertices, faces = part()
    model = MeshModel.build(vertices, faces)
    drawn = MeshRenderer(vertices, faces, CAMERA, textured=True)
    poses = object_poses('general', 240, model.diameter_m, speed=speed)[first:first + 20]
    tracker = RorapidTracker(model, CAMERA)
    tracker.start(*perturbed(poses[0][:, :3], poses[0][:, 3], np.random.default_rng(3), 0.05,
                             0.003))
    for k, pose in enumerate(poses):
        frame = tracker.track(drawn.render(pose, np.random.default_rng(k), 1.0))
        turn = np.rad2deg(np.linalg.norm(rotation_vector(frame.rotation @ pose[:, :3].T)))
        # a start may take some images to be confirmed; no wrong pose is published
        assert frame.state is TrackerState.TRACKING or k < 8 and not frame
        off = np.linalg.norm(frame.translation - pose[:, 3]) / np.linalg.norm(pose[:, 3])
        assert not frame or turn < 2 and off < 0.01
    assert len(frame.texture_px) >= 8


@pytest.mark.parametrize('depth_m', (1e-9, 1e-4, 0.02))
def test_a_start_at_the_camera_itself_is_no_accident(depth_m):
    """Part of the object is behind the camera then, and its picture is without bounds."""
    tracker = RorapidTracker(MeshModel.build(*bean()), CAMERA)
    tracker.start(np.eye(3), [0, 0, depth_m])
    image = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    for _ in range(2):
        assert not tracker.track(image)


@pytest.mark.long
def test_half_an_outline_of_a_lump_is_never_tracked_to_a_wrong_pose():
    vertices, faces = bean()
    model = MeshModel.build(vertices, faces)
    drawn = MeshRenderer(vertices, faces, CAMERA, np.random.default_rng(1))
    poses = object_poses('general', 450, model.diameter_m, speed=1.1)[::-1][:51]
    tracker = RorapidTracker(model, CAMERA)
    tracker.start(poses[0][:, :3], poses[0][:, 3])
    tracked = 0
    for k, pose in enumerate(poses):
        image = drawn.render(pose, np.random.default_rng(k), 1.0)
        if k >= 20:
            middle = int(CAMERA.project(pose[:, 3][None])[0, 0])
            image[:, max(middle - 150, 0):middle] = 90
        frame = tracker.track(image)
        turn = np.rad2deg(np.linalg.norm(rotation_vector(frame.rotation @ pose[:, :3].T)))
        assert turn < 10 or frame.state is not TrackerState.TRACKING
        tracked += frame.state is TrackerState.TRACKING
    # the whole outline, and some halves
    assert tracked >= 20


def vase(size_m=0.12):
    """Make a turned part with a bent axis: vertices and faces."""
    v, u = np.meshgrid(np.arange(48) / 47, np.arange(64) / 64, indexing='ij')
    turn = 2 * np.pi * u
    radius = size_m * (0.16 + 0.1 * np.sin(6 * v + 0.5) * (1 - 0.4 * v))
    radius[[0, -1]] = 0
    height = np.clip((v - 1 / 47) / (45 / 47), 0, 1)
    vertices = np.stack([radius * np.cos(turn) * (1 + 0.25 * height), radius * np.sin(turn)
                         + 0.12 * size_m * np.sin(3 * height), size_m * (height - 0.5)], axis=-1)
    row, column = (index.ravel() for index in np.meshgrid(np.arange(47), np.arange(64),
                                                          indexing='ij'))
    a, b = row * 64 + column, row * 64 + (column + 1) % 64
    return vertices.reshape(-1, 3), np.concatenate([np.stack([a, b, b + 64], axis=1),
                                                    np.stack([a, b + 64, a + 64], axis=1)])


@pytest.mark.long
def test_a_start_that_was_never_confirmed_is_not_tracked_far_off():
    vertices, faces = vase()
    model = MeshModel.build(vertices, faces)
    drawn = MeshRenderer(vertices, faces, CAMERA, textured=True)
    poses = object_poses('general', 330, model.diameter_m, speed=0.9)[::-1][97:174]
    # half of the while in which nothing is found is left out
    poses = np.concatenate([poses[:18], poses[30:]])
    tracker = RorapidTracker(model, CAMERA, rng=np.random.default_rng(0))
    tracker.start(poses[0][:, :3], poses[0][:, 3])
    tracked = 0
    for k, pose in enumerate(poses):
        # the pattern hides the outline: no image confirms the start for long (it was 54° off)
        frame = tracker.track(drawn.render(pose, np.random.default_rng([81, k]), 1.0))
        turn = np.rad2deg(np.linalg.norm(rotation_vector(frame.rotation @ pose[:, :3].T)))
        assert turn < 20 or frame.state is not TrackerState.TRACKING
        tracked += frame.state is TrackerState.TRACKING
    # it is found again as it turns, and kept
    assert tracked >= 20
