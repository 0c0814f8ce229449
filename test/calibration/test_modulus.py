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
"""Affine structure from four general views: the true plane at infinity is found."""

import numpy as np
import pytest
from selfcal_ros.calibration.affine.modulus import (calibrate_modulus, modulus_residuals,
                                                    projective_structure)
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.synthetic.grid_scenes import grid_sequence, random_rotations
from selfcal_ros.values.tracks import Tracks

SIZE = (512, 512)


def _general(seed, noise_px, views=4):
    rng = np.random.default_rng(seed)
    scene = grid_sequence(rng, random_rotations(rng, views), noise_px)
    return scene, scene.tracks.in_frames(range(2, 2 + views))


@pytest.mark.parametrize('facts', [CameraFacts(), CameraFacts(skew=0.0, aspect_ratio=1.5)])
@pytest.mark.parametrize('views', [4, 6])
def test_four_general_views_calibrate_exactly_without_noise(facts, views):
    scene, tracks = _general(0, 0.0, views)
    found = calibrate_modulus(tracks, SIZE, facts)
    assert np.allclose(found.K, scene.camera.K, atol=1e-3)
    R = scene.cam_from_world[:, :, :3]
    K = scene.camera.K
    true = K @ R[found.frames[1:]] @ R[found.frames[0]].T @ np.linalg.inv(K)
    assert np.allclose(found.homographies.H, true, atol=1e-5 * np.abs(true).max())


def test_constraint_vanishes_at_the_plane_at_infinity_only():
    _, tracks = _general(1, 0.0)
    found = calibrate_modulus(tracks, SIZE)
    _, views, sigma_px = projective_structure(tracks, SIZE)
    assert sigma_px < 1e-3
    assert np.abs(modulus_residuals(views.cameras, found.plane)).max() < 1e-8
    assert np.abs(modulus_residuals(views.cameras, 1.2 * found.plane + 1e-4)).max() > 1e-3


@pytest.mark.long
def test_noise_leaves_a_start_for_the_adjustment():
    for seed in range(5):
        scene, tracks = _general(seed, 0.126)
        found = calibrate_modulus(tracks, SIZE)
        assert abs(found.K[0, 0] / 649 - 1) < 0.06 and abs(found.K[1, 1] / 973.5 - 1) < 0.06


@pytest.mark.long
def test_stated_covariance_is_that_of_the_estimates():
    scene, tracks = _general(0, 0.0)
    away, stated = [], []
    for seed in range(8):
        noise = 0.126 * np.random.default_rng([seed, 9]).normal(size=tracks.xy.shape)
        found = calibrate_modulus(Tracks(tracks.frame, tracks.track, tracks.xy + noise), SIZE)
        away.append((found.K - scene.camera.K)[[0, 1, 0, 1, 0], [0, 1, 2, 2, 1]])
        stated.append(np.diag(found.conic.covariance))
    ratio = np.sqrt(np.mean(np.square(away) / stated, axis=0))
    assert (ratio > 0.5).all() and (ratio < 1.7).all()
    assert 0.3 < found.conic.misfit < 1.8
    # all entries of the homographies alike: 17 px
    assert np.std(away, axis=0)[0] < 4


def test_three_views_or_too_few_points_are_refused():
    _, tracks = _general(0, 0.0)
    assert calibrate_modulus(tracks.in_frames((2, 3, 4)), SIZE).kind == 'too_few'
    assert calibrate_modulus(tracks.select(tracks.track < 8), SIZE).kind == 'too_few_shared'
