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
from dataclasses import replace
import json
from pathlib import Path
import re

import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.acquisition.image_lines import (detect_lines, find_corners, refine_lines,
                                                         refine_vertices)
from selfcal_ros.rorapid.acquisition.line_matching import match_vertices
from selfcal_ros.rorapid.acquisition.plane_loops import plane_loops
from selfcal_ros.rorapid.acquisition.two_view_model import acquire_model, points_from_translation
from selfcal_ros.rorapid.model import read_model, write_model
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.synthetic.objects import cube, tracked_object
from selfcal_ros.synthetic.paths import look_at
from selfcal_ros.synthetic.recordings import default_camera

CAMERA = default_camera(distortion=(-0.12, 0.05, 0.001, -0.001))
MOVED = np.array([-0.06, 0.01, 0.02])
BASELINE = float(np.linalg.norm(MOVED))
POSE = look_at([0.25, -0.3, 0.26], [0, 0, 0])
#: The corners of the cube that this pose shows, and the faces between them.
SEEN = [1, 0, 4, 5, 7, 3, 6]
FACES = [(0, 3, 4, 5), (1, 2, 3, 0), (2, 6, 4, 3)]


def _vertices(pose=POSE):
    return cube().model.vertices[SEEN] @ pose[:, :3].T + pose[:, 3]


def _two_views(shape, noise_sigma=1.5, **options):
    """Return a recording of two views between which the object was translated."""
    recording = tracked_object(2, shape, 'translation', noise_sigma=noise_sigma, **options)
    poses = recording.cam_from_world.copy()
    poses[:, :, 3] *= 0.7
    poses[1] = poses[0]
    poses[1, :, 3] += MOVED
    recording = replace(recording, cam_from_world=poses)
    return recording, [image for image, _ in recording.frames()]


def _visible_wireframe(model, pose):
    """Vertices (camera frame) of wholly visible lines, and these lines among them."""
    seen = VisibleModel(model).control_points(pose[:, :3], pose[:, 3])
    lines = [model.lines[k] for k in np.unique(seen.primitive)
             if seen.kind[k] == 'line' and seen.visible[seen.primitive == k].all()]
    used = sorted({int(v) for line in lines for v in line})
    return (model.vertices[used] @ pose[:, :3].T + pose[:, 3],
            [(used.index(i), used.index(j)) for i, j in lines])


def test_without_noise_the_points_are_exact():
    X = _vertices()
    for facts in ({'baseline_m': BASELINE}, {'known_length': (0, 3, 0.084)}):
        found = points_from_translation(CAMERA.project(X), CAMERA.project(X + MOVED), CAMERA,
                                        **facts)
        np.testing.assert_allclose(found.points, X, atol=1e-9)
        np.testing.assert_allclose(found.moved, MOVED, atol=1e-9)
        assert found.noise_px < 1e-6


def test_the_covariance_tells_the_spread():
    X, rng, sigma = _vertices(), np.random.default_rng(1), 0.2
    distances = []
    for _ in range(200):
        found = points_from_translation(
            CAMERA.project(X) + rng.normal(0, sigma, (len(X), 2)),
            CAMERA.project(X + MOVED) + rng.normal(0, sigma, (len(X), 2)), CAMERA,
            baseline_m=BASELINE, sigma_px=sigma)
        error = found.points - X
        distances.append(np.einsum('ni,nij,nj->n', error, np.linalg.inv(found.covariances),
                                   error))
    # chi-square with three degrees of freedom; 200 runs know its mean to 0.17
    assert np.abs(np.mean(distances, axis=0) - 3).max() < 0.7
    # a depth of half a metre is worse known than what lies across
    assert found.covariances[0, 2, 2] > 4 * found.covariances[0, 0, 0]


def test_a_turn_of_the_camera_is_noticed():
    X = _vertices()
    turned = (X + MOVED) @ rotation_matrix([0.02, 0.05, 0.1]).T
    found = points_from_translation(CAMERA.project(X), CAMERA.project(turned), CAMERA,
                                    baseline_m=1.0)
    assert not found and found.kind == 'points_miss_translation'


@pytest.mark.parametrize('moved, says', [([1e-4, 0, 0], 'moved too little'),
                                         ([0, 0, 0], 'moved too little|behind')])
def test_a_small_motion_gives_a_reason_and_no_model(moved, says):
    X, rng = _vertices(), np.random.default_rng(2)
    noise = rng.normal(0, 0.3, (2, len(X), 2))
    found = points_from_translation(CAMERA.project(X) + noise[0],
                                    CAMERA.project(X + moved) + noise[1], CAMERA, baseline_m=1.0)
    assert not found
    assert re.search(says, found.reason)


def test_arguments_are_checked():
    X = CAMERA.project(_vertices())
    for facts in ({}, {'baseline_m': 1.0, 'known_length': (0, 1, 1.0)}, {'baseline_m': -1.0},
                  {'known_length': (0, 99, 1.0)}, {'known_length': (0, 0, 1.0)}):
        with pytest.raises(ArgumentError):
            points_from_translation(X, X + 1, CAMERA, **facts)
    with pytest.raises(ArgumentError):
        points_from_translation(X, X[1:], CAMERA, baseline_m=1.0)
    assert not points_from_translation(X[:3], X[:3] + 1, CAMERA, baseline_m=1.0)


def test_clicked_vertices_faces_and_a_disc_make_a_model(tmp_path):
    X = _vertices()
    truth = cube().model
    disc = truth.conics[2]
    rim = disc.points(np.linspace(0, 5.5, 9)) @ POSE[:, :3].T + POSE[:, 3]
    acquired = acquire_model(
        CAMERA.project(X), CAMERA.project(X + MOVED), CAMERA, faces=FACES,
        conics=[(2, CAMERA.project(rim))], frame=(0, 3, 5), baseline_m=BASELINE, name='box')
    model = acquired.model
    assert len(model.lines) == 9 and len(model.faces) == 3 and len(model.conics) == 1
    # the pose says where the model lies: its vertices are where they were
    np.testing.assert_allclose(model.vertices @ acquired.rotation.T + acquired.translation, X,
                               atol=1e-9)
    np.testing.assert_allclose(acquired.rotation @ acquired.rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(model.vertices[0], 0, atol=1e-12)
    np.testing.assert_allclose(model.vertices[3], [0.084, 0, 0], atol=1e-9)
    assert abs(model.vertices[5, 2]) < 1e-9 and model.vertices[5, 1] > 0
    ring = model.conics[0]
    centre = acquired.rotation @ ring.centre + acquired.translation
    np.testing.assert_allclose(centre, POSE[:, :3] @ disc.centre + POSE[:, 3], atol=2e-5)
    np.testing.assert_allclose([np.linalg.norm(ring.axis_u), np.linalg.norm(ring.axis_v)],
                               np.linalg.norm(disc.axis_u), atol=3e-5)
    again = read_model(write_model(model, tmp_path / 'box.yaml'))
    np.testing.assert_array_equal(again.vertices, model.vertices)
    # and it is a model that can be tracked: from the first view all of it is seen
    seen = VisibleModel(again).control_points(acquired.rotation, acquired.translation)
    assert seen.visible.all() and len(np.unique(seen.primitive)) == 10


def test_wrong_indices_are_refused():
    X = _vertices()
    views = CAMERA.project(X), CAMERA.project(X + MOVED)
    for wrong in ({'lines': [(0, 9)]}, {'faces': [(0, 1, 9)]}, {'frame': (0, 0, 1)},
                  {'faces': FACES, 'conics': [(0, np.zeros((4, 2)))]}, {}):
        with pytest.raises(ArgumentError):
            acquire_model(*views, CAMERA, baseline_m=1.0, **wrong)


@pytest.mark.parametrize('shape', ['cube', 'step_block'])
def test_clicks_two_pixels_off_are_moved_onto_the_edges(shape):
    recording, images = _two_views(shape)
    rng = np.random.default_rng(3)
    for image, pose in zip(images, recording.cam_from_world):
        X, lines = _visible_wireframe(recording.model, pose)
        true = recording.camera.project(X)
        clicked = true + rng.normal(0, 1.5, true.shape)
        off = np.linalg.norm(refine_vertices(image, clicked, lines) - true, axis=1)
        assert np.median(off) < 0.15 and (off < 0.6).mean() > 0.85


def test_lines_and_corners_are_found_to_a_fraction_of_a_pixel():
    recording, images = _two_views('step_block', background=False)
    pose = recording.cam_from_world[0]
    X, lines = _visible_wireframe(recording.model, pose)
    true = recording.camera.project(X)
    found = detect_lines(images[0])
    off = [np.linalg.norm(found[:, None] - np.stack([true[[i, j]], true[[j, i]]]), axis=3).max(
        axis=2).min() for i, j in lines]
    assert np.median(off) < 3 and len(found) < 40
    corners = np.array([corner.xy for corner in find_corners(found)])
    nearest = np.linalg.norm(corners[:, None] - true, axis=2).min(axis=0)
    assert (nearest < 0.5).sum() >= len(true) - 2
    # the brighter side is to the left
    along = found[:, 1] - found[:, 0]
    left = np.column_stack([along[:, 1], -along[:, 0]]) / np.hypot(*along.T)[:, None]
    x, y = np.rint(found.mean(axis=1) + 3 * left).astype(int).T
    u, v = np.rint(found.mean(axis=1) - 3 * left).astype(int).T
    assert (images[0][y, x].astype(int) - images[0][v, u] > 0).mean() > 0.95


def test_nothing_is_found_where_nothing_is():
    grey = np.full((120, 160), 90, np.uint8)
    assert detect_lines(grey).shape == (0, 2, 2)
    assert find_corners(np.zeros((0, 2, 2))) == []
    segments, support = refine_lines(grey, [[[20, 20], [90, 50]]])
    np.testing.assert_array_equal(segments, [[[20, 20], [90, 50]]])
    assert support == 0
    rng = np.random.default_rng(0)
    found = match_vertices(grey, grey, CAMERA, rng)
    assert not found and found.kind == 'corners_disagree'
    for pair in ((grey, grey[:50]), (grey.astype(float), grey), (grey[:1, :1], grey[:1, :1])):
        with pytest.raises(ArgumentError):
            match_vertices(*pair, CAMERA, rng)


@pytest.mark.long
@pytest.mark.parametrize('shape, background, vertices, faces', [
    ('step_block', False, 10, 4), ('step_block', True, 7, 1), ('cube', False, 8, 2)])
def test_a_model_is_made_from_two_images_alone(shape, background, vertices, faces):
    recording, images = _two_views(shape, background=background, distortion=(-0.1, 0.02, 0, 0))
    matched = match_vertices(*images, recording.camera, np.random.default_rng(4))
    seen = matched.first_px, matched.second_px, recording.camera, matched.lines
    bare = acquire_model(*seen, baseline_m=BASELINE)
    acquired = acquire_model(*seen, plane_loops(bare.model.vertices, matched.lines),
                             baseline_m=BASELINE)
    assert acquired
    assert len(acquired.model.vertices) >= vertices
    assert len(acquired.model.faces) >= faces
    pose = recording.cam_from_world[0]
    X = acquired.model.vertices @ acquired.rotation.T + acquired.translation
    truth = recording.model.vertices @ pose[:, :3].T + pose[:, 3]
    off = np.linalg.norm(X[:, None] - truth, axis=2).min(axis=1)
    # half a millimetre at 0.3 m
    assert np.median(off) < 5e-4 and (off < 2e-3).mean() > 0.85
    assert np.linalg.norm(acquired.structure.moved - MOVED) < 2e-3


def test_loops_in_a_plane_are_found_and_others_are_not():
    # a square pyramid with one slant missing its base edge
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4)]
    loops = {frozenset(loop) for loop in plane_loops(vertices, pairs)}
    assert loops == {frozenset((0, 1, 2, 3)), frozenset((0, 1, 4)), frozenset((1, 2, 4))}
    # an L-shaped loop goes around its notch
    corner = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]], float)
    loop, = plane_loops(corner, [(k, (k + 1) % 6) for k in range(6)])
    assert len(loop) == 6


def test_a_chessboard_seen_by_an_arm_that_moved_without_turning():
    folder = next((p / 'shared/data/kuka_chess' for p in Path(__file__).resolve().parents
                   if (p / 'shared/data/kuka_chess').is_dir()), None)
    if folder is None:
        pytest.skip('the images shared/data/kuka_chess are not beside the repository')
    truth = json.loads((folder / 'gt.json').read_text())
    camera = Camera(truth['K'], truth['dist'], 1928, 1208)
    images = np.load(folder / 'corners.npz')['image'].reshape(30, -1, 2)
    arm = np.array(truth['base_T_flange'])[:, :3, 3]
    for view in (2, 3, 7, 10, 25):
        found = points_from_translation(images[0], images[view], camera, sigma_px=0.15,
                                        baseline_m=np.linalg.norm(arm[view] - arm[0]))
        board = found.points.reshape(17, 28, 3)
        squares = np.concatenate([np.linalg.norm(np.diff(board, axis=k), axis=2).ravel()
                                  for k in (0, 1)])
        assert abs(squares.mean() - 0.02) < 1.2e-4
        # flat to a third of a millimetre, half a metre away
        spread = np.linalg.svd(found.points - found.points.mean(axis=0), compute_uv=False)
        assert spread[2] / np.sqrt(len(found.points)) < 3.5e-4
    # view 14 was turned
    turned = points_from_translation(images[0], images[13], camera, baseline_m=0.1)
    assert not turned and turned.kind == 'points_miss_translation'
