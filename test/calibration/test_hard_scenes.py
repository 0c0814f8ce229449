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
"""At the edge of what self-calibration can do: right within the sigmas, or refused."""

import numpy as np
import pytest

from selfcal_ros import calibrate
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.synthetic.hard_scenes import ground, s_curve, vehicle
from test_support.hard_worlds import calibrated, SQUARE


def outcome(name, seed):
    """Return the result and its largest deviation from the truth in stated sigmas."""
    sequence, result = calibrated(name, seed)
    return result, away_from(sequence, result) if result else 0.0


def away_from(sequence, result):
    """Return the largest deviation from the truth in stated sigmas."""
    away = (result.camera.parameters - sequence.camera.parameters) / np.maximum(
        np.sqrt(np.diag(result.covariance)), 1e-12)
    estimated = [result.status[name] == 'estimated' for name in PARAMETER_NAMES]
    return float(np.abs(away[estimated]).max())


@pytest.mark.parametrize('name', [
    'S-curve, level camera', 'S-curve of 2 degrees', 'about image x, S-curve',
    'general, three views', 'three views in a row, turning', 'floor and wall',
    'a moving body, a fifth of the points', 'outliers, a fifth',
    'points in a corner of the image', *(
        pytest.param(name, marks=pytest.mark.long) for name in ('long lens', '16 points'))])
def test_what_the_images_determine_is_found(name):
    result, away = outcome(name, 0)

    assert result, result.reason
    assert away < 4


@pytest.mark.long
def test_a_floor_alone_is_enough():
    sequence = vehicle(np.random.default_rng([0, 5]), s_curve(), surface=ground, count=60)
    result = calibrate(sequence.tracks, facts=SQUARE)

    assert result, result.reason
    assert away_from(sequence, result) < 4


# `bench hard_scenes` has more seeds of all of them
@pytest.mark.long
def test_a_wall_does_not_take_its_mirror_image():
    result, away = outcome('wall only', 0)

    assert result, result.reason
    assert away < 4
    assert abs(result.camera.K[0, 0] / 520 - 1) < 0.01


@pytest.mark.long
def test_a_drive_before_a_far_scene_is_no_turn_about_a_far_point_of_the_axis():
    result, away = outcome('far scene, 200 steps away', 1)

    assert result.motion == 'planar'
    assert away < 4


@pytest.mark.parametrize('name, kind', [
    ('forward only', 'no_rotation'), ('sideways only', 'rotation_too_small'),
    ('one image twelve times', 'nothing_moves'), ('two views', 'too_few_images'),
    pytest.param('general, about z only', 'parameters_undetermined', marks=pytest.mark.long),
    ('8 points', 'no_epipolar_geometry')])
def test_what_the_images_leave_open_is_refused(name, kind):
    result, _ = outcome(name, 0)

    assert not result
    assert result.kind == kind


@pytest.mark.long
@pytest.mark.parametrize('name', ['on the spot, no translation', 'on the spot, 1 mm off the axis',
                                  'far scene, 2000 steps away'])
def test_rotation_is_told_from_motion_with_little_parallax(name):
    result, away = outcome(name, 0)

    assert result.motion == 'rotation'
    assert away < 4


@pytest.mark.long
@pytest.mark.parametrize('seed, refused', [(0, False), (1, False), (2, True)])
def test_a_long_valley_widens_the_sigmas(seed, refused):
    """Around a near axis the curvature at the optimum promises sigmas that are too small."""
    result, away = outcome('on the spot, 0.1 m off the axis', seed)

    assert away < 4
    if refused:
        assert not result and result.kind in ('parameters_undetermined', 'points_behind')
    else:
        assert result, result.reason
