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
from functools import cache
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.polygon import cut_into_triangles
from selfcal_ros.rorapid.edges.control_points import ControlModel
from selfcal_ros.rorapid.model import Conic, Cylinder, Polygon, WireframeModel
from selfcal_ros.rorapid.projection.camera_models import Projection
from selfcal_ros.rorapid.visibility.visibility_table import VisibilityTable
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.synthetic.object_shapes import cube, spool, step_block
from selfcal_ros.synthetic.render import Renderer, Scene


@cache
def _cube():
    """Return a cube; its faces are drawn texel by texel, once, and not to collect the tests."""
    return cube(1.0).model


def _star(arms=5, height=0.6):
    """Return a prism over a star: deep notches on all sides."""
    angle = np.pi * np.arange(2 * arms) / arms
    radius = np.where(np.arange(2 * arms) % 2, 0.35, 1.0)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle])
    n = len(ring)
    faces = [Polygon(range(n)), Polygon(range(2 * n - 1, n - 1, -1))]
    faces += [Polygon((k, (k + 1) % n, n + (k + 1) % n, n + k)) for k in range(n)]
    return WireframeModel.build(np.concatenate([ring, ring + [0, 0, height]]), (), faces)


def _open_box():
    """Return a box without a lid: its faces are seen from both sides."""
    return WireframeModel.build(_cube().vertices[:8], (), [
        face for k, face in enumerate(_cube().faces) if k != 4])


def _two_boxes():
    """Return two boxes that share a part of a wall."""
    one = _cube()
    other = one.vertices[:8] * [1, 0.6, 0.5] + [1.0, 0.1, -0.25]
    faces = list(one.faces) + [Polygon([i + 8 for i in face.indices]) for face in one.faces]
    return WireframeModel.build(np.concatenate([one.vertices[:8], other]), (), faces)


SOLIDS = {'cube': _cube, 'step': lambda: step_block(1.0).model, 'star': _star, 'open': _open_box,
          'two': _two_boxes}


@cache
def solid(name):
    """Return one of the solids."""
    return SOLIDS[name]()


def _winding_number(point, polygon):
    """Count the turns of a polygon (N, 2) around a point."""
    a = polygon - point
    b = np.roll(a, -1, axis=0)
    return np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1)).sum() \
        / (2 * np.pi)


def _cast_ray(model, centre, point):
    """Whether a face is met before the point; by plane and winding number, face by face."""
    for face in model.faces:
        corners = model.vertices[list(face.indices)]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        reach = normal @ (point - centre)
        share = normal @ (corners[0] - centre) / reach if reach else np.inf
        if not 0 < share < 1 - 1e-7:
            continue
        hit = centre + share * (point - centre)
        axes = [k for k in range(3) if k != np.abs(normal).argmax()]
        if abs(_winding_number(hit[axes], corners[:, axes])) > 0.5:
            return True
    return False


def _poses(rng, count, low, high):
    R = Rotation.random(count, random_state=np.random.RandomState(rng.integers(2**31)))
    t = np.column_stack([rng.uniform(-0.3, 0.3, (count, 2)), rng.uniform(low, high, count)])
    return list(zip(R.as_matrix(), t))


@pytest.mark.parametrize('name', SOLIDS)
def test_what_is_hidden_is_what_a_ray_meets(name):
    model, rng = solid(name), np.random.default_rng(1)
    seen = VisibleModel(model, 5, 7)
    hidden_points = 0
    for R, t in _poses(rng, 25, 2.0, 8.0):
        points = seen.control_points(R, t)
        visible = np.zeros(seen.size, bool)
        visible[points.ids] = points.visible
        expected = [not _cast_ray(model, -t @ R, X) for X in seen._points]
        np.testing.assert_array_equal(visible, expected)
        hidden_points += (~visible).sum()
    assert hidden_points > 100


def _depth_check(thing, poses, camera):
    """Compare with rendered depth: hidden points lie behind, visible ones in front."""
    seen = VisibleModel(thing.model, 9, 16)
    renderer = Renderer(Scene(thing.surfaces), camera, supersampling=1)
    tolerance = 0.02 * thing.model.diameter_m
    wrong = total = 0
    for R, t in poses:
        depth = np.pad(renderer.depth(np.column_stack([R, t])), 2, constant_values=np.nan)
        points = seen.control_points(R, t)
        X = points.object_points @ R.T + t
        x, y = np.rint(camera.project(X)).astype(int).T
        around = np.stack([depth[y + 2 + dy, x + 2 + dx] for dy in (-2, 0, 2)
                           for dx in (-2, 0, 2)])
        around = np.where(np.isnan(around), np.inf, around)
        # the farthest of the neighbourhood decides for hidden, the nearest for visible
        wrong += (points.visible & (around.max(axis=0) < X[:, 2] - tolerance)).sum()
        wrong += (~points.visible & (around.min(axis=0) > X[:, 2] - 1e-3 * tolerance)).sum()
        total += len(points)
    return wrong, total


@pytest.mark.parametrize('make', [cube, step_block, spool])
def test_visibility_agrees_with_rendered_depth(make):
    thing, rng = make(), np.random.default_rng(2)
    camera = Camera([[500, 0, 160], [0, 500, 120], [0, 0, 1]], width=320, height=240)
    poses = [(R, np.array([0, 0, 3.6 * thing.model.diameter_m]))
             for R, _ in _poses(rng, 12, 1, 2)]
    wrong, total = _depth_check(thing, poses, camera)
    assert total > 500 and wrong == 0


def test_a_cylinders_outline_touches_its_rays():
    cylinder = Cylinder([0.1, 0.2, -0.3], [0.5, -0.1, 0.8], 0.2, 'pipe')
    seen = VisibleModel(WireframeModel((), cylinders=[cylinder]), 6)
    axis = (cylinder.end - cylinder.start) / np.linalg.norm(cylinder.end - cylinder.start)
    for R, t in _poses(np.random.default_rng(3), 20, 2.0, 5.0):
        points = seen.control_points(R, t)
        assert points.kind == ('silhouette', 'silhouette') and points.visible.all()
        assert points.names == ('pipe left', 'pipe right') and points.contour.all()
        assert points.ids.tolist() == list(range(12))
        offset = points.object_points - cylinder.start
        radial = offset - np.outer(offset @ axis, axis)
        np.testing.assert_allclose(np.linalg.norm(radial, axis=1), 0.2)
        # the ray is tangent: at right angles to the surface's normal
        rays = points.object_points + t @ R
        np.testing.assert_allclose((rays * radial).sum(axis=1), 0, atol=1e-12)
        np.testing.assert_allclose(points.tangents, np.tile(axis, (12, 1)), atol=1e-12)


def test_a_cylinder_has_no_outline_from_above_or_within():
    seen = VisibleModel(WireframeModel((), cylinders=[Cylinder([0, 0, 1], [0, 0, 2], 0.5)]))
    assert len(seen.control_points(np.eye(3), np.zeros(3))) == 0
    assert len(seen.control_points(np.eye(3), [0.2, 0, -1.5])) == 0
    assert len(seen.control_points(np.eye(3), [2.0, 0, 0])) == 12


def test_a_cylinder_hides_what_is_behind_it():
    # a line crosses behind a post; from the side both are free
    model = WireframeModel([[-1, 0.8, 0], [1, 0.8, 0]], [[0, 1]],
                           cylinders=[Cylinder([0, 0, -1], [0, 0, 1], 0.3)])
    seen = VisibleModel(model, 41)
    R = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
    points = seen.control_points(R, [0, 0, 3.0])
    line = points.primitive == 0
    x = points.object_points[line, 0]
    # the tangents from (0, -3) to the post meet the line at |x| = 3.8 tan(asin(0.1))
    shadow = 3.8 * np.tan(np.arcsin(0.1))
    np.testing.assert_array_equal(points.visible[line], np.abs(x) > shadow)
    assert points.visible[~line].all()
    above = seen.control_points(np.eye(3), [0, 0, 5.0])
    assert above.visible[above.primitive == 0].all()


def test_contours_have_the_background_on_one_side():
    seen = VisibleModel(solid('cube'), 3)
    points = seen.control_points(np.eye(3), [0.0, 0.0, 3.0])
    # seen head-on, only the nearest face with its marking shows
    assert {np.round(p[2], 6) for p in points.object_points} == {-0.5}
    assert points.contour.all()
    R = Rotation.from_rotvec([0.5, 0.6, 0.1]).as_matrix()
    points = seen.control_points(R, [0, 0, 4.0])
    lines = [k for k in np.unique(points.primitive)
             if points.kind[k] == 'line' and len(seen.model.line_faces[k])]
    contour = [k for k in lines if points.contour[points.primitive == k].all()]
    assert len(lines) == 9 and len(contour) == 6
    assert not points.contour[[points.kind[k] == 'conic' for k in points.primitive]].any()


def test_control_points_lie_on_their_primitives_and_keep_their_numbers():
    model = WireframeModel([[0, 0, 0], [2, 0, 0]], [[0, 1]], line_names=['edge'],
                           conics=[Conic([0, 0, 0], [1, 0, 0], [0, 0.5, 0], 'ring')])
    points = VisibleModel(model, 4, 8).control_points(np.eye(3), [0, 0, 3])
    assert points.names == ('edge', 'ring') and points.kind == ('line', 'conic')
    assert points.ids.tolist() == list(range(12)) and len(points) == 12
    np.testing.assert_allclose(points.object_points[:4, 0], [0.25, 0.75, 1.25, 1.75])
    ring, tangents = points.object_points[4:], points.tangents[4:]
    np.testing.assert_allclose(ring[:, 0]**2 + 4 * ring[:, 1]**2, 1)
    # the tangent is at right angles to the gradient (x, 4 y)
    np.testing.assert_allclose(ring[:, 0] * tangents[:, 0] + 4 * ring[:, 1] * tangents[:, 1], 0,
                               atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points.tangents, axis=1), 1)


def test_what_is_behind_the_camera_is_not_visible():
    model = WireframeModel([[0, 0, -1], [0, 0.1, 1]], [[0, 1]])
    points = VisibleModel(model, 4).control_points(np.eye(3), np.zeros(3))
    np.testing.assert_array_equal(points.visible, [False, False, True, True])
    assert len(VisibleModel(model, 4).control_points(np.eye(3), [0, 0, -9.0])) == 0


def test_small_lines_and_faces_are_left_out_when_the_focal_length_is_known():
    square = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]
    model = WireframeModel.build(square, [[0, 2]], [Polygon(range(4), min_area_px2=900)],
                                 line_min_length_px=[50])
    seen = VisibleModel(model)
    for focal, lines in ((400, 5), (320, 4), (299, 0)):
        # the square is 40, 32, 29.9 px wide, its diagonal 57, 45, 42 px long
        assert len(seen.control_points(np.eye(3), [0, 0, 1.0], focal)) == 6 * lines
    assert len(seen.control_points(np.eye(3), [0, 0, 1.0])) == 30
    least = VisibleModel(model, min_length_px=41).control_points(np.eye(3), [0, 0, 1.0], 400)
    assert len(np.unique(least.primitive)) == 1


@pytest.mark.parametrize('name', SOLIDS)
def test_the_table_gives_the_same_answers(name):
    model, rng = solid(name), np.random.default_rng(4)
    table = VisibilityTable(model, 2.5, 6.0, subdivisions=2, control_points_per_line=5)
    direct = VisibleModel(model, control_points_per_line=5)
    assert 0.3 < table.share_decided <= 1
    for R, t in _poses(rng, 150, 2.2, 6.5):
        a, b = table.control_points(R, t), direct.control_points(R, t)
        np.testing.assert_array_equal(a.ids, b.ids)
        np.testing.assert_array_equal(a.visible, b.visible)


def test_the_table_refuses_what_cannot_be():
    with pytest.raises(ArgumentError, match='too long'):
        VisibilityTable(_star(80), 1, 2, subdivisions=4)
    for arguments in ((0, 1), (2, 1), (1, np.inf), (1, np.nan), (1, 2, 9)):
        with pytest.raises(ArgumentError):
            VisibilityTable(solid('cube'), *arguments)


def test_a_model_that_is_too_large_is_refused_before_memory_runs_out():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    sheets = np.concatenate([square + [0, 0, k] for k in range(1600)])
    model = WireframeModel.build(sheets, (), [Polygon(range(4 * k, 4 * k + 4))
                                              for k in range(1600)])
    with pytest.raises(ArgumentError, match='simplify'):
        VisibleModel(model)


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_an_impossible_pose_shows_nothing():
    seen = VisibleModel(spool().model)
    for R, t in ((np.full((3, 3), np.nan), np.zeros(3)), (np.eye(3), [np.nan] * 3),
                 (np.eye(3), [np.inf] * 3), (np.zeros((3, 3)), np.ones(3))):
        assert not seen.control_points(R, t).visible.any()


def test_polygons_are_cut_into_triangles_that_cover_them():
    rng = np.random.default_rng(5)
    for corners in (3, 4, 7, 12, 30):
        angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
        radius = rng.uniform(0.2, 1.0, corners)
        flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle])
        if np.diff(angle, append=angle[0] + 2 * np.pi).max() > 3:
            continue
        for points in (flat, flat[::-1]):
            turned = points @ Rotation.from_rotvec(rng.normal(size=3)).as_matrix().T + 3
            cut = cut_into_triangles(turned)
            a, b, c = (turned[cut[:, k]] for k in range(3))
            area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
            x, y = points[:, 0], points[:, 1]
            shoelace = abs((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()) / 2
            np.testing.assert_allclose(area, shoelace, rtol=1e-9)
    bow_tie = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]], float)
    assert cut_into_triangles(bow_tie) is None
    assert cut_into_triangles(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], float)) is None


def test_a_cube_takes_less_than_a_millisecond():
    # a third of that on an idle machine; the best of many, since others use it too
    seen = VisibleModel(solid('cube'))
    R = Rotation.from_rotvec([0.5, 0.6, 0.1]).as_matrix()
    best = np.inf
    for _ in range(50):
        start = time.perf_counter()
        seen.control_points(R, [0, 0, 4.0])
        best = min(best, time.perf_counter() - start)
    assert best < 1e-3


def test_each_control_point_has_its_nearest_in_another_layout():
    model = spool().model
    few, many = VisibleModel(model, 6, 10), VisibleModel(model, 18, 30)
    assert (few.nearest_in(few) == np.arange(few.size)).all()
    nearest = many.nearest_in(few)
    assert (few.primitive[nearest] == many.primitive).all()
    # three lie about each of the few
    assert (np.bincount(nearest) == 3).all()
    assert (nearest[few.nearest_in(many)] == np.arange(few.size)).all()


def test_what_is_small_in_the_image_is_not_searched():
    square = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]
    model = WireframeModel.build(
        square, [[0, 2]], [Polygon(range(4), min_area_px2=900)], line_min_length_px=[50],
        cylinders=[Cylinder([0.3, 0, 0], [0.3, 0.1, 0], 0.02, min_length_px=35)])
    camera = Camera([[400, 0, 320], [0, 400, 240], [0, 0, 1]], (), 640, 480)
    control = ControlModel(VisibleModel(model), Projection(camera), (640, 480))
    # the square is 40, 33, 29.6 px wide, its diagonal 57, 47, 42 px, the pipe 40, 33, 29.6 px long
    for away, lines, pipes in ((1.0, 5, 2), (1.2, 4, 0), (1.35, 0, 0)):
        view = control.view(control.projection.from_pose(
            np.eye(3), np.array([0, 0, away]) + control.centre))
        searched = np.unique(view.primitive[view.searched])
        assert (np.sum(searched < 5), np.sum(searched >= 5)) == (lines, pipes)
