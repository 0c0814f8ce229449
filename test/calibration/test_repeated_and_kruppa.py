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
"""Equal objects in one image, and Kruppa's equations: exact without noise, near with it."""

import numpy as np
import pytest
from selfcal_ros.calibration.affine.kruppa import calibrate_kruppa, kruppa_residuals
from selfcal_ros.calibration.affine.repeated_structure import (calibrate_repeated,
                                                               tracks_from_objects)
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.fundamental import fundamental
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.grid_scenes import grid_points, grid_sequence, random_rotations

SIZE = (1280, 960)
CAMERA = Camera([[1100, 0, 660], [0, 1150, 470], [0, 0, 1]], width=SIZE[0], height=SIZE[1])
ZERO_SKEW = CameraFacts(skew=0.0)


def _objects(noise_px, turns=((14, 22, 5),), seed=0):
    """Equal boxes in one image: two translated, the others turned."""
    rng = np.random.default_rng(seed)
    X = 0.5 * grid_points()
    places = [(-0.9, -0.7, 5.0), (0.8, -0.55, 4.2), (-0.6, 0.8, 4.6), (0.9, 0.7, 5.2)]
    rotations = [np.eye(3), np.eye(3), *rotation_matrix(np.radians(np.array(turns, float)))]
    images = [CAMERA.project(X @ R.T + place) for R, place in zip(rotations, places)]
    assert all((xy > 0).all() and (xy < SIZE).all() for xy in images)
    return [xy + noise_px * rng.normal(size=xy.shape) for xy in images]


@pytest.mark.parametrize('translated', [None, (0, 1)])
def test_three_equal_objects_calibrate_exactly_without_noise(translated):
    found = calibrate_repeated(_objects(0), SIZE, ZERO_SKEW, translated)
    assert np.allclose(found.K, CAMERA.K, atol=1e-2)
    X = found.metric()
    planes = [np.linalg.svd(X[k:k + 64] - X[k:k + 64].mean(axis=0))[2][2] for k in (0, 64)]
    assert abs(planes[0] @ planes[1]) < 1e-5


def test_more_objects_need_no_fact_and_stay_near_with_noise():
    for seed in range(4):
        found = calibrate_repeated(_objects(0.05, ((14, 22, 5), (20, -15, 0)), seed), SIZE)
        error = found.K[[0, 1], [0, 1]] / [1100, 1150] - 1
        assert np.abs(error).max() < 0.05
        sigma = np.sqrt(np.diag(found.conic.covariance))
        assert np.abs(found.K[0, 0] - 1100) < 4 * sigma[0]


def test_three_objects_without_a_fact_or_without_a_translation_are_refused():
    found = calibrate_repeated(_objects(0.05), SIZE)
    assert not found and found.kind == 'rotations_about_one_axis'
    turned = _objects(0.05, ((14, 22, 5), (20, -15, 0)))[1:]
    found = calibrate_repeated(turned, SIZE, ZERO_SKEW)
    assert not found and found.kind == 'no_translated_objects'


def test_hidden_points_are_left_out_and_unequal_objects_refused():
    objects = _objects(0)
    objects[1][:20] = np.nan
    assert len(tracks_from_objects(objects)) == 3 * 128 - 20
    assert np.allclose(calibrate_repeated(objects, SIZE, ZERO_SKEW).K, CAMERA.K, atol=1e-2)
    with pytest.raises(InputError, match='same points'):
        tracks_from_objects([objects[0], objects[1][:5]])


def _pairs(seed, noise_px):
    rng = np.random.default_rng(seed)
    scene = grid_sequence(rng, random_rotations(rng, 4), noise_px)
    F = [fundamental(*scene.tracks.matches(a, b)[1:]).F
         for a in range(1, 6) for b in range(a + 1, 6)]
    return np.array(F), scene.camera.K


@pytest.mark.long
@pytest.mark.parametrize('facts', [CameraFacts(), CameraFacts(skew=0.0, aspect_ratio=1.5)])
def test_kruppa_is_exact_without_noise_and_near_with_it(facts):
    F, K = _pairs(0, 0.0)
    assert np.abs(kruppa_residuals(F, K @ K.T)).max() < 1e-6
    assert np.allclose(calibrate_kruppa(F, (512, 512), facts).K, K, atol=1e-3)
    for seed in range(4):
        found = calibrate_kruppa(_pairs(seed, 0.126)[0], (512, 512), facts)
        assert abs(found.K[0, 0] / K[0, 0] - 1) < 0.1


def test_kruppa_refuses_what_the_pairs_do_not_hold():
    F, _ = _pairs(0, 0.0)
    assert calibrate_kruppa(F[:2], (512, 512)).kind == 'too_few'
    rng = np.random.default_rng(0)
    tracks = grid_sequence(rng, np.zeros((3, 3)), 0.0).tracks
    still = [fundamental(*tracks.matches(a, b)[1:], 'translation').F
             for a in range(4) for b in range(a + 1, 4)]
    assert calibrate_kruppa(still, (512, 512)).kind == 'pairs_leave_camera_open'
