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
"""Homographies of one plane, and a drone that sees nothing else, through a lens that bends it."""

import numpy as np

import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.initialisation.planar_scene import separate
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.scenes import observe


def _drone(seed, pitch_deg, tilt_deg, views=20, points=500):
    """Fly over a flat ground with a camera of 65 degrees that bends it."""
    rng = np.random.default_rng(seed)
    camera = Camera([[1000, 0, 640], [0, 1000, 480], [0, 0, 1]], [-0.25, 0.09, 0, 0, -0.015],
                    1280, 960)
    time = np.linspace(0, 1, views)[:, None]

    def swings(size, columns, slow, fast):
        rates = rng.uniform(slow, fast, (2, columns))
        waves = np.sin(2 * np.pi * (rates[:, None] * time + rng.uniform(0, 1, (2, 1, columns))))
        return size * waves.sum(axis=0) / 2

    course = np.column_stack([np.zeros((views, 2)), swings(np.radians(90), 1, 0.4, 0.9)])
    swing = np.column_stack([swings(np.radians(tilt_deg), 2, 1.1, 3.1), np.zeros(views)])
    # x to the right, y backwards and z down; then the nose up by what lacks to straight down
    level = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1.0]])
    nose = rotation_matrix(np.array([np.radians(90 - pitch_deg), 0, 0]))
    R = rotation_matrix(swing) @ nose @ level @ rotation_matrix(course)
    centres = np.column_stack([swings(18, 2, 0.5, 1.3), 20 + swings(3, 1, 0.7, 1.5)])
    poses = np.concatenate([R, -R @ centres[:, :, None]], axis=2)
    ground = np.column_stack([rng.uniform(-45, 45, (points, 2)), np.zeros(points)])
    return observe(rng, camera, poses, ground, 0.25, only_inside=True)


def _calibrated(sequence):
    """Calibrate with square pixels."""
    return calibrate(sequence.tracks, facts=CameraFacts(skew=0.0, aspect_ratio=1.0))


@pytest.mark.long
def test_a_drone_over_a_flat_ground_gives_its_camera_through_a_lens_that_bends():
    # without the lens the starts missed the plane: a shutter or things that move were blamed
    sequence = _drone(6, 75, 8)
    found = _calibrated(sequence)
    assert found, found
    error = found.camera.parameters - sequence.camera.parameters
    sigma = np.array([found.sigma[name] for name in found.camera.parameter_names])
    assert np.abs(error[:4] / np.maximum(sigma[:4], 1e-9)).max() < 4
    assert sigma[0] < 8
    assert not {'tracks_moving', 'tracks_jump', 'focal_varies'} & {
        one.kind for one in found.findings}


@pytest.mark.long
def test_a_drone_that_looks_straight_down_has_no_focal_length():
    found = _calibrated(_drone(6, 90, 0.5, views=12, points=250))
    # both are so: it moved without turning, and one homography explains its flat ground
    assert not found and found.kind in ('moved_not_rotated', 'no_parallax'), found


def test_rotation_and_translation_come_back():
    rng = np.random.default_rng(4)
    normal = np.array([0.1, 0.5, 0.8])
    R = rotation_matrix(np.vstack([np.zeros(3), rng.normal(0, 0.2, (6, 3))]))
    t = np.vstack([np.zeros(3), rng.normal(0, 0.3, (6, 3))])
    H = (R + t[:, :, None] * normal) * rng.uniform(-2, 2, 7)[:, None, None]

    found_R, found_t = separate(H)

    np.testing.assert_allclose(found_R, R, atol=1e-9)
    np.testing.assert_allclose(found_t, t * np.linalg.norm(normal), atol=1e-9)


def test_a_camera_that_only_turned_has_no_translation():
    R = rotation_matrix(np.random.default_rng(1).normal(0, 0.2, (5, 3)))
    found_R, found_t = separate(R)

    np.testing.assert_allclose(found_R, R, atol=1e-6)
    np.testing.assert_allclose(found_t, 0, atol=1e-6)
