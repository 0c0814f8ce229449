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
"""A camera that looks straight at a plane sees images that slide, which tell no focal length."""

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts, Tracks
from selfcal_ros.calibration.estimators.rotation import calibrate_rotating
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)
FLOOR = Camera([[520, 0, 322], [0, 520, 243], [0, 0, 1]], [-0.08, 0.02, 0, 0], 640, 480)
VIEWS = 14


def seen(camera, poses, points, rng, noise_px=0.25):
    """Draw tracks of points (P, 3) from poses (V, 3, 4)."""
    rows = []
    for k, pose in enumerate(poses):
        xy = camera.project(points @ pose[:, :3].T + pose[:, 3])
        inside = (xy > 0).all(axis=1) & (xy < [camera.width, camera.height]).all(axis=1)
        rows += [(k, i, *xy[i]) for i in np.flatnonzero(inside)]
    rows = np.array(rows)
    return Tracks(rows[:, 0].astype(int), rows[:, 1].astype(int),
                  rows[:, 2:] + noise_px * rng.normal(size=(len(rows), 2)), (640, 480))


def over_floor(rng, tilt_deg):
    """Drive a camera 1.2 m above a floor, which it looks at; off the perpendicular by an angle."""
    heading = np.linspace(0, 2.4, VIEWS)
    places = np.column_stack([0.25 * np.arange(VIEWS) * np.cos(heading / 2),
                              0.25 * np.arange(VIEWS) * np.sin(heading / 2), 0 * heading])
    tilted = rotation_matrix(np.array([[np.radians(tilt_deg), 0, 0]]))[0]
    turns = tilted @ rotation_matrix(np.column_stack([0 * heading, 0 * heading, -heading]))
    points = np.column_stack([rng.uniform(-1.5, 4.5, (1500, 2)), np.full(1500, 1.2)])
    poses = np.concatenate([turns, -np.einsum('vij,vj->vi', turns, places)[:, :, None]], axis=2)
    return seen(FLOOR, poses, points, rng)


@pytest.mark.long
@pytest.mark.parametrize('seed', range(2))
def test_over_a_floor_no_turn_behind_a_long_lens_is_found(seed):
    result = calibrate_rotating(over_floor(np.random.default_rng(seed), 0.0), (640, 480), SQUARE)
    assert not result and result.kind == 'images_slide'
    assert result.values['status']['fx'] == 'unobservable'


@pytest.mark.long
def test_nearly_straight_above_a_floor_a_path_counts_that_leaves_the_focal_length_open():
    result = calibrate(over_floor(np.random.default_rng(0), 1.0), facts=SQUARE)
    assert not result, result.camera.K


@pytest.mark.parametrize('focal_px', [1500.0, 4000.0])
def test_a_true_turn_behind_a_long_lens_is_calibrated(focal_px):
    rng = np.random.default_rng(3)
    camera = Camera([[focal_px, 0, 322], [0, focal_px, 243], [0, 0, 1]], [-0.08, 0.02, 0, 0],
                    640, 480)
    width, phase = 640 / focal_px, np.linspace(0, 2 * np.pi, VIEWS)
    turns = rotation_matrix(width * np.column_stack([
        0.8 * np.sin(2 * phase), 1.2 * np.sin(phase), 0.3 * np.cos(phase)]))
    points = np.column_stack([np.tan(width * rng.uniform(-2, 2, (1500, 2))), np.ones(1500)])
    poses = np.concatenate([turns, np.zeros((VIEWS, 3, 1))], axis=2)
    result = calibrate_rotating(seen(camera, poses, points, rng), (640, 480), SQUARE)
    assert result, result
    assert abs(result.camera.K[0, 0] - focal_px) < 4 * result.sigma['fx']
