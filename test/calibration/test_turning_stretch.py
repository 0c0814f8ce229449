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
"""A robot that turns on the spot before it moves, the camera a little off the axis."""

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.estimators.turning_stretch import lever_directions, stretches_of
from selfcal_ros.calibration.estimators.turning_views import frames_in_motion
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.hard_scenes import s_curve, scene, vehicle
from selfcal_ros.synthetic.scenes import pitched_mount

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)
VIEWS = 10


def turned_then_driven(rng, lever_m, turn_deg=90.0):
    """Turn about a vertical axis behind the camera, then drive."""
    heading, place = s_curve(VIEWS, 40.0)
    heading = np.r_[np.radians(np.linspace(-turn_deg, 0, VIEWS)), heading[1:]]
    place = np.r_[np.zeros((VIEWS, 2)), place[1:]]
    place = place + lever_m * np.column_stack([np.cos(heading), np.sin(heading)])
    return vehicle(rng, (heading, place), count=600)


def turned_then_moved(rng, lever_m):
    """Turn by hand about a wrist behind the camera, then move freely."""
    time = np.linspace(0, 1, 2 * VIEWS)[:, None, None]

    def waves():
        size, phase = rng.normal(size=(3, 3)), rng.uniform(0, 2 * np.pi, (3, 3))
        return np.sum(size * np.sin(2 * np.pi * np.arange(1, 4) * time + phase), axis=2)

    R, centres = rotation_matrix(np.radians(12.0) * waves()), 0.3 * waves()
    centres -= centres[VIEWS - 1]
    about = lever_m * R[:VIEWS, 2]
    centres[:VIEWS] = about - about[-1]
    return scene(rng, np.concatenate([R, -R @ centres[:, :, None]], axis=2), count=600)


def off_in_sigmas(result, camera):
    return [abs(result.camera.parameters[k] - camera.parameters[k]) / result.sigma[name]
            for k, name in enumerate(('fx', 'fy', 'cx', 'cy'))]


@pytest.mark.long
def test_a_turn_before_a_drive_is_not_explained_inside_out():
    sequence = turned_then_driven(np.random.default_rng([1, 5]), 0.03)
    result = calibrate(sequence.tracks, facts=FACTS)
    assert result and result.motion == 'planar' and len(result.frames) == 2 * VIEWS - 1
    assert max(off_in_sigmas(result, sequence.camera)) < 4
    # the wrong side of the lever left an uneven ground, and three to six times this sigma
    assert result.sigma['fx'] < 0.35
    assert 'not_exactly_planar' not in [one.kind for one in result.findings]


@pytest.mark.long
def test_views_that_turn_before_a_free_motion_are_left_out_and_told():
    sequence = turned_then_moved(np.random.default_rng([4, 5]), 0.03)
    result = calibrate(sequence.tracks, facts=FACTS)
    assert result and max(off_in_sigmas(result, sequence.camera)) < 4
    told = [one for one in result.findings if one.kind == 'turning_left_out']
    assert len(told) == 1
    left_out = told[0].values['left_out']
    assert set(left_out) | set(result.frames) == set(range(2 * VIEWS))
    assert 4 < len(left_out) < VIEWS and max(left_out) < VIEWS


def test_a_free_motion_without_such_a_turn_keeps_all_views():
    rng = np.random.default_rng(7)
    turns = rotation_matrix(rng.normal(0, 0.2, (12, 3)))
    centres = rng.uniform(-0.3, 0.3, (12, 3))
    sequence = scene(rng, np.concatenate([turns, -turns @ centres[:, :, None]], axis=2))
    result = calibrate(sequence.tracks, facts=FACTS)
    assert result and result.frames == tuple(range(12))
    assert frames_in_motion(result.reconstruction, sequence.tracks) is None


@pytest.mark.parametrize('turn_deg, lever_m, found', (
    (90.0, 0.02, True), (90.0, 0.5, False), (2.0, 0.0, False)))
def test_a_stretch_turns_and_hardly_moves(turn_deg, lever_m, found):
    heading = np.radians(np.r_[np.linspace(0, turn_deg, 8), np.full(8, turn_deg)])
    R = rotation_matrix(np.column_stack([np.zeros((16, 2)), -heading]))
    centres = np.column_stack([lever_m * np.cos(heading), lever_m * np.sin(heading),
                               np.zeros(16)])
    centres[8:, 1] += 0.3 * np.arange(1, 9)
    assert stretches_of(centres, R, np.full(16, 0.3), 0.1) == ([(0, 7)] if found else [])
    # of far points a longer lever is as short
    assert stretches_of(centres, R, np.full(16, 0.3), 0.9, most=1e-9) == (
        [(0, 7)] if lever_m == 0 and turn_deg > 5 else [])


@pytest.mark.parametrize('pitch_deg', (0.0, 20.0, 90.0))
def test_levers_lie_in_the_plane_of_motion(pitch_deg):
    path = turned_path(pitch_deg)
    levers = lever_directions(path, in_plane=True)
    assert np.allclose(np.linalg.norm(levers, axis=1), 1) and np.allclose(levers[:, 2], 0)
    assert np.allclose(levers.sum(axis=0), 0) and len(levers) == (4 if pitch_deg == 90 else 2)
    assert len(lever_directions(path, in_plane=False)) == 6


def turned_path(pitch_deg):
    """Views of a camera that is pitched down, before a world whose z axis is up."""
    return AxisPath.at_origin(pitched_mount(np.radians(pitch_deg)), np.zeros(3))
