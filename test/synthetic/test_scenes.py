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
"""The truth that the scenes claim is the truth that their tracks obey."""

import numpy as np
import pytest
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic import scenes, special_scenes


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_si_has_the_fixed_points_of_the_thesis(rng):
    sequence = scenes.sequence_si(rng, 0.0)
    v, line = sequence.vanishing_point, sequence.horizon
    assert v[:2] / v[2] == pytest.approx([-571.8, -11876], abs=0.6)
    assert line[:2] / line[2] == pytest.approx([-2.003e-4, -2.510e-3], rel=5e-4)
    assert sequence.points.shape == (50, 3) and len(sequence.tracks) == 150
    assert np.linalg.norm(sequence.points.mean(axis=0)) == pytest.approx(4.0)


def test_si_stays_in_the_image(rng):
    pixels = scenes.sequence_si(rng, 0.0, views=12).true_pixels
    assert (pixels > 0).all() and (pixels < [800, 600]).all()


def test_tracks_are_projections_with_the_stated_noise(rng):
    sequence = scenes.sequence_si(rng, 0.3, views=8, aspect_ratio=1.1, skew=5.0)
    K = sequence.camera.K
    assert K[1, 1] / K[0, 0] == pytest.approx(1.1) and K[0, 1] == 5.0
    poses = sequence.cam_from_world[sequence.tracks.frame]
    points = np.column_stack([sequence.points, np.ones(50)])[sequence.tracks.track]
    image = np.einsum('ij,njk,nk->ni', K, poses, points)
    error = sequence.tracks.xy - image[:, :2] / image[:, 2:]
    assert error.std() == pytest.approx(0.3, rel=0.08)


def test_motion_is_planar_and_turns_by_the_step(rng):
    poses = scenes.sequence_si(rng, 0.0, step_deg=12.0).cam_from_world
    axis = scenes.si_axis()
    for first, second in zip(poses[:-1], poses[1:]):
        turn = second[:, :3] @ first[:, :3].T
        assert turn @ axis == pytest.approx(axis)
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(12.0)
        shift = second[:, 3] - turn @ first[:, 3]
        assert shift @ axis == pytest.approx(0.0, abs=1e-12)


def test_fixed_points_are_fixed_under_homographies_of_the_plane_at_infinity(rng):
    sequence = scenes.sequence_si(rng, 0.0, aspect_ratio=1.1, skew=5.0)
    K, poses = sequence.camera.K, sequence.cam_from_world
    infinite = K @ poses[1, :, :3] @ poses[0, :, :3].T @ np.linalg.inv(K)
    for point in (sequence.vanishing_point, sequence.circular_point):
        assert np.abs(np.cross(infinite @ point, point)).max() < 1e-9 * np.abs(point).max() ** 2
    omega = np.linalg.inv(K @ K.T)
    i = sequence.circular_point
    assert abs(i @ omega @ i) < 1e-12 and abs(sequence.horizon @ i) < 1e-9


def test_horizon_of_a_pitched_camera_is_level(rng):
    line = special_scenes.level_horizon(rng).horizon
    assert abs(line[0]) < 1e-15
    # a camera that looks 20 degrees down sees the horizon above the principal point
    assert -line[2] / line[1] == pytest.approx(300 - 900 * np.tan(np.radians(20)))


def test_circular_motion_keeps_its_distance(rng):
    sequence = special_scenes.circular_motion(rng, 0.0, views=6)
    centre = sequence.points.mean(axis=0)
    local = sequence.cam_from_world @ np.append(centre, 1.0)
    assert local == pytest.approx(np.tile([0, 0, 4.0], (6, 1)), abs=1e-9)


def test_pure_motions_are_pure(rng):
    still = special_scenes.pure_rotation(rng).cam_from_world
    assert np.abs(still[:, :, 3]).max() == 0
    straight = special_scenes.pure_translation(rng).cam_from_world
    assert np.abs(straight[:, :, :3] - straight[0, :, :3]).max() == 0
    near = special_scenes.nearly_equal_positions(rng).cam_from_world
    assert np.abs(near[:, :, 3]).max() < 5e-3


def test_general_motion_is_not_planar(rng):
    sequence = special_scenes.general_motion(rng)
    R = sequence.cam_from_world[:, :, :3]
    assert R @ np.swapaxes(R, 1, 2) == pytest.approx(np.tile(np.eye(3), (3, 1, 1)))
    assert np.degrees(np.arccos(sequence.axis @ R[1, :, 2])) > 2
    assert (sequence.true_pixels > 0).all() and (sequence.true_pixels < [800, 600]).all()


def test_point_sets(rng):
    assert len(special_scenes.few_points(rng).points) == 4
    flat = special_scenes.coplanar_points(rng).points
    assert np.linalg.svd(flat - flat.mean(axis=0))[1][2] < 1e-12


def test_outliers_are_marked_and_replaced(rng):
    clean = scenes.sequence_si(rng, 0.1, views=5)
    dirty = special_scenes.with_outliers(clean, rng, 0.2)
    assert dirty.outliers.sum() == 50
    moved = (dirty.tracks.xy != clean.tracks.xy).any(axis=1)
    assert (moved == dirty.outliers).all()


def test_only_inside_drops_what_the_image_does_not_hold(rng):
    wide = 6 * scenes.double_tsai_grid()
    every = scenes.sequence_si(rng, 0.0, points=wide)
    inside = scenes.sequence_si(rng, 0.0, points=wide, only_inside=True)
    assert 0 < len(inside.tracks) < len(every.tracks)
    assert (inside.tracks.xy >= -0.5).all() and (inside.tracks.xy <= [799.5, 599.5]).all()


def test_same_seed_same_tracks():
    first = special_scenes.drive(np.random.default_rng(3), tracks=100)
    second = special_scenes.drive(np.random.default_rng(3), tracks=100)
    assert (first.tracks.xy == second.tracks.xy).all()


@pytest.mark.parametrize('views', [24, 200])
def test_drive_has_tracks_of_consecutive_views_in_every_view(rng, views):
    sequence = special_scenes.drive(rng, views=views)
    tracks = sequence.tracks
    _, first, length = np.unique(tracks.track, return_index=True, return_counts=True)
    assert length.max() <= 24 and np.median(length) > 8
    assert (np.bincount(tracks.frame, minlength=views) > 40).all()
    span = tracks.frame[first + length - 1] - tracks.frame[first] + 1
    assert (span <= 24).all()


def test_distortion_reaches_the_pixels(rng):
    straight = scenes.sequence_si(rng, 0.0)
    bent = scenes.sequence_si(rng, 0.0, distortion=(-0.12, 0.05, 0, 0))
    moved = np.linalg.norm(bent.true_pixels - straight.true_pixels, axis=-1)
    assert moved.max() > 0.2


FISHEYE = Camera([[200, 0, 322], [0, 200, 238], [0, 0, 1]], (-0.0388, 0.0087, -0.0110, 0.0025),
                 640, 480, 'equidistant')


@pytest.mark.parametrize('make', [special_scenes.drive, special_scenes.hand_held])
def test_any_lens_sees_its_scene_beyond_90_degrees_too(rng, make):
    sequence = make(rng, 0.2, 12, 600, 8, FISHEYE)
    tracks = sequence.tracks
    rays = FISHEYE.rays(sequence.true_pixels[tracks.frame, tracks.track])
    assert (rays[:, 2] < 0).sum() > 20
    # the true rays meet the true points
    poses = sequence.cam_from_world[tracks.frame]
    local = np.einsum('nij,nj->ni', poses[:, :, :3],
                      sequence.points[tracks.track]) + poses[:, :, 3]
    assert np.allclose(local / np.linalg.norm(local, axis=1, keepdims=True), rays, atol=1e-9)
    away = tracks.xy - sequence.true_pixels[tracks.frame, tracks.track]
    assert away.std() == pytest.approx(0.2, rel=0.05)
    assert np.bincount(tracks.frame, minlength=12).min() > 100


def test_points_beyond_the_fold_of_a_lens_are_not_seen(rng):
    folding = Camera([[400, 0, 320], [0, 400, 240], [0, 0, 1]], (-0.3, 0, 0, 0), 640, 480)
    points = np.array([[1.9, 0, 1.0], [0.3, 0, 1.0]])
    pose = np.eye(3, 4)[None]
    assert scenes.observe(rng, folding, pose, points).tracks.track.tolist() == [1]


def test_a_hand_turns_about_all_axes_and_moves_along_all(rng):
    poses = special_scenes.hand_held(rng).cam_from_world
    centres = -np.einsum('vji,vj->vi', poses[:, :, :3], poses[:, :, 3])
    assert (np.linalg.svd(centres - centres.mean(axis=0))[1] > 0.1).all()
    assert (np.linalg.svd((poses[:, :, :3] - poses[0, :, :3]).reshape(20, 9))[1][:3] > 0.3).all()
