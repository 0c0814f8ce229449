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
"""Measures of the bench of wide lenses."""

from __future__ import annotations

from bench.lenses.held_lens import distance_after_similarity, observations_of, under_lens
from bench.lenses.lens_distance import angles_deg, pixel_grid, projection_distance, rms
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.synthetic.special_scenes import drive
from selfcal_ros.synthetic.wide_recordings import wide_camera


def test_a_longer_focal_length_turns_rays_in_proportion():
    true = wide_camera(150, coefficients=(), off_centre_px=(0, 0))
    longer = Camera(true.K * [[1.01], [1.01], [1]] * [1, 1, 0] + true.K * [0, 0, 1],
                    true.distortion, true.width, true.height, true.model)
    angle = angles_deg(longer, true, 60)
    assert np.allclose(angles_deg(true, true, 60), 0, atol=1e-9)
    # equidistant: a pixel at 60 degrees is seen at 60 / 1.01
    assert angle.max() == pytest.approx(60 - 60 / 1.01, abs=0.02)


def test_rays_that_a_camera_lacks_are_infinitely_wrong():
    true = wide_camera(185)
    pinhole = Camera(true.K, (-0.5,), true.width, true.height)
    assert np.isinf(angles_deg(pinhole, true, 88)).any()


def test_distance_in_pixels_leaves_the_best_rotation_out():
    true = wide_camera(150)
    pixels = pixel_grid(640, 480, 20, 15)
    moved = Camera(true.K + [[0, 0, 0.5], [0, 0, 0], [0, 0, 0]], true.distortion, 640, 480,
                   true.model)
    assert rms(projection_distance(true, true, pixels)) < 1e-6
    assert 0 < rms(projection_distance(moved, true, pixels)) < 0.2


def test_places_are_compared_after_the_best_similarity(rng=np.random.default_rng(1)):
    places = rng.normal(size=(20, 3))
    moved = 3.0 * Rotation.random(rng=rng).apply(places) + [5, 6, 7]
    assert distance_after_similarity(moved, places) == pytest.approx(0, abs=1e-12)
    noisy = places + 0.01 * rng.normal(size=places.shape)
    assert 0.005 < distance_after_similarity(noisy, places) < 0.02


def test_a_wrong_lens_costs_more_than_the_one_found():
    scene = drive(np.random.default_rng(3), 0.1, 10, 150)
    found = calibrate(scene.tracks, facts=CameraFacts(1.0, 0.0, distortion='none'))
    observations, state = observations_of(found, scene.tracks)
    own = under_lens(observations, state, found.noise_sigma_px, found.camera)
    K = found.camera.K
    wrong = under_lens(observations, state, found.noise_sigma_px,
                       Camera(K, (-0.02,), found.camera.width, found.camera.height))
    assert own.noise_px == pytest.approx(found.noise_sigma_px, rel=0.1)
    assert wrong.cost > 1.1 * own.cost
