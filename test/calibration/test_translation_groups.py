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
"""Views of one orientation are found from the images alone, through lens distortion too."""

from pathlib import Path

import numpy as np
import pytest
from selfcal_ros.calibration.affine.affine_calibration import calibrate_affine
from selfcal_ros.calibration.affine.pair_distortion import estimate_radial, undo_radial
from selfcal_ros.calibration.affine.translation_groups import (classify_translations,
                                                               translation_groups)
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.grid_scenes import grid_sequence, random_rotations
from selfcal_ros.synthetic.scenes import observe
from selfcal_ros.values.tracks import Tracks

SIZE = (1280, 720)


def _room(seed, k1=0.0, groups=4, each=3, noise_px=0.2, turn_deg=8.0, spread=0.4):
    rng = np.random.default_rng(seed)
    camera = Camera([[1000, 0, 640], [0, 1000, 360], [0, 0, 1]], [k1, 0, 0, 0], *SIZE)
    points = rng.uniform([-3, -2, 4], [3, 2, 9], (300, 3))
    turns = np.radians(turn_deg) * rng.normal(size=(groups, 3))
    R = rotation_matrix(np.repeat(turns, each, axis=0))
    centres = spread * rng.normal(size=(groups * each, 3))
    poses = np.concatenate([R, -R @ centres[:, :, None]], axis=2)
    return observe(rng, camera, poses, points, noise_px, only_inside=True)


@pytest.mark.parametrize('k1', [0.0, -0.2, 0.1])
def test_groups_are_found_through_distortion(k1):
    found = translation_groups(_room(1, k1).tracks, SIZE)
    assert set(found.groups) == {(0, 1, 2), (3, 4, 5), (6, 7, 8), (9, 10, 11)}
    assert '4 groups' in found.explain()
    if k1 == 0:
        assert found.radial == (0.0, 0.0)


def test_pairs_are_tested_in_parts_as_all_at_once(monkeypatch):
    tracks = _room(2).tracks
    whole, radial = classify_translations(tracks, SIZE)
    monkeypatch.setattr('selfcal_ros.calibration.affine.translation_groups.AT_ONCE', 7)
    parts, _ = classify_translations(tracks, SIZE, radial=radial)
    assert len(whole.statistic) > 50
    # those of a part are scaled alike, and stop together
    np.testing.assert_allclose(parts.statistic, whole.statistic, rtol=1e-3, atol=0.05)
    np.testing.assert_allclose(parts.limit, whole.limit, rtol=1e-3)
    np.testing.assert_array_equal(parts.frames, whole.frames)


def test_distortion_that_is_found_undoes_that_of_the_lens():
    sequence = _room(2, -0.2, noise_px=0.05)
    radial = translation_groups(sequence.tracks, SIZE).radial
    camera = sequence.camera
    pixels = np.random.default_rng(0).uniform(0, SIZE, (200, 2))
    straight = camera.normalised(pixels) @ camera.K[:2, :2].T + camera.K[:2, 2]
    undone = undo_radial(pixels, radial, SIZE)
    # a common scale is no distortion
    a, b = straight - straight.mean(axis=0), undone - undone.mean(axis=0)
    b *= np.sum(a * b) / np.sum(b * b)
    # the corners, where no tracks are, and a small change of perspective remain
    assert np.abs(a - b).max() < 8 < 30 < np.abs(straight - pixels).max()


def test_points_at_one_distance_from_the_middle_do_no_harm():
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    circle = (np.array(SIZE) - 1) / 2 + 250 * np.column_stack([np.cos(angle), np.sin(angle)])
    rng = np.random.default_rng(0)
    xy = np.array([rng.permutation(circle) for _ in range(3)])
    tracks = Tracks(np.repeat(range(3), 40), np.tile(range(40), 3), xy.reshape(-1, 2), SIZE)
    assert np.isfinite(estimate_radial(tracks, SIZE)).all()


def test_tests_hold_their_level_on_true_translations():
    statistics = []
    for seed in range(4):
        tests, _ = classify_translations(_room(seed, groups=1, each=6).tracks, SIZE,
                                         radial=(0.0, 0.0))
        statistics.append(tests.statistic)
        assert tests.translated.all() and tests.baseline.all()
        assert np.allclose(tests.noise_px, 0.2, rtol=0.25)
    assert 0.7 < np.mean(statistics) < 1.4


def test_small_rotations_are_told_from_translations():
    tests, _ = classify_translations(_room(3, groups=4, each=1, turn_deg=0.5).tracks, SIZE)
    assert not tests.translated.any()
    found = translation_groups(_room(3, groups=4, each=1).tracks, SIZE)
    assert found.groups == () and 'No two views are related' in found.explain()


def test_equal_frames_are_no_baseline():
    found = translation_groups(_room(4, groups=3, each=2, spread=0).tracks, SIZE)
    assert found.groups == ()


def test_group_feeds_the_chain():
    rng = np.random.default_rng(0)
    tracks = grid_sequence(rng, random_rotations(rng, 4)).tracks
    found = translation_groups(tracks, (512, 512))
    assert set(found.groups[0]) == {0, 1}
    assert abs(calibrate_affine(tracks, found.groups[0], (512, 512)).K[0, 0] / 649 - 1) < 0.01


def test_no_matches_is_said():
    tracks = Tracks([0, 1], [0, 0], np.zeros((2, 2)))
    assert 'No two views share' in translation_groups(tracks, SIZE).explain()


@pytest.mark.long
def test_recorded_arm_kept_its_orientation_where_its_notes_say():
    path = Path(__file__).resolve().parents[3] / 'shared/data/kuka_chess/corners.npz'
    if not path.is_file():
        pytest.skip('the recorded set kuka_chess is not there')
    xy = np.load(path)['image'][:, ::3, 0]
    frame, track = np.indices(xy.shape[:2])
    tracks = Tracks(frame.ravel(), track.ravel(), xy.reshape(-1, 2), (1928, 1208))
    found = translation_groups(tracks, (1928, 1208))
    assert found.groups[0] == (*range(11), 24, 25)
    # a chessboard alone is a plane, which does not do
    refused = calibrate_affine(tracks, found.groups[0], (1928, 1208))
    assert not refused and refused.kind == 'translated_scene_flat'
