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

import numpy as np
import pytest
from selfcal_ros.calibration.bundle.object_bend import bend_modes
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.tracks import Tracks

SIZE = (1280, 960)
CAMERA = Camera([[1150, 0, 650], [0, 1150, 470], [0, 0, 1]], [-0.22, 0.09, 0.0005, -0.0004],
                *SIZE)
NO_SKEW = CameraFacts(skew=0.0)


def a4():
    """Corners of a board that fills a sheet of A4."""
    x, y = np.meshgrid(np.arange(9), np.arange(6))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(54)])
    return KnownObject(np.arange(54), 0.027 * points)


def views(bow_m, seed, count=12, board=None):
    """Tracks of the sheet, bent like a roof gutter, in views that show it whole."""
    rng, board = np.random.default_rng(seed), board or a4()
    middle = board.points.mean(axis=0)
    height = -np.cos(np.pi * (board.points[:, 0] - middle[0]) / 0.216)
    bent = board.points - middle + bow_m * height[:, None] * [0, 0, 1]
    seen = []
    while len(seen) < count:
        R = rotation_matrix(rng.uniform(-0.6, 0.6, 3))
        X = bent @ R.T + [*rng.uniform(-0.08, 0.08, 2), rng.uniform(0.24, 0.43)]
        xy = CAMERA.project(X)
        if (xy > 0).all() and (xy < SIZE).all():
            seen.append(xy + 0.15 * rng.standard_normal(xy.shape))
    return Tracks(np.repeat(np.arange(count), 54), np.tile(np.arange(54), count),
                  np.concatenate(seen), SIZE)


def off_in_sigmas(result):
    """Tell how far K is off, as the length of a vector of four sigmas."""
    error = result.camera.parameters[:4] - CAMERA.parameters[:4]
    return np.sqrt(error @ np.linalg.solve(result.covariance[:4, :4], error) / 4)


@pytest.mark.parametrize('seed', [0, 1])
def test_a_bent_board_is_told_and_does_not_move_the_camera(seed):
    tracks = views(0.6e-3, seed)
    result = calibrate_known_object(tracks, a4(), facts=NO_SKEW)
    told = next(one for one in result.findings if one.kind == 'board_bent')
    bend = told.values['bend_mm']
    assert abs(bend['value'] - 0.6) < 0.02 + 3 * bend['sigma'] and bend['sigma'] < 0.03
    assert 'it bends by 0.' in told.sentence
    assert off_in_sigmas(result) < 3
    assert abs(result.camera.K[0, 0] / 1150 - 1) < 0.003
    # the points stand where the sheet is
    assert np.ptp(result.reconstruction.points[:, 2]) == pytest.approx(0.6e-3, abs=0.1e-3)
    # a board that is said to be flat moves it
    flat = calibrate_known_object(tracks, a4(), facts=NO_SKEW, flatness=0)
    assert abs(flat.camera.K[0, 0] / 1150 - 1) > 0.004
    assert off_in_sigmas(flat) > 3


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_no_bend_is_told_of_a_flat_board_and_hardly_any_certainty_lost(seed):
    tracks = views(0.0, seed)
    result = calibrate_known_object(tracks, a4(), facts=NO_SKEW)
    told = next(one for one in result.findings if one.kind.startswith('board'))
    assert told.kind == 'board_flat' and told.values['limit_mm'] < 0.2
    assert off_in_sigmas(result) < 3
    flat = calibrate_known_object(tracks, a4(), facts=NO_SKEW, flatness=0)
    assert result.sigma['fx'] < 1.3 * flat.sigma['fx']
    assert not any(one.kind.startswith('board') for one in flat.findings)


@pytest.mark.parametrize('seed', [0, 1])
def test_a_print_that_is_not_to_scale_is_told_and_does_not_move_the_camera(seed):
    # 0.3 % longer along, and 0.2 degrees from upright; in silence before, and 5 sigmas off
    true = a4()
    P = true.points.copy()
    P[:, 0] += 0.003 * P[:, 0] + np.deg2rad(0.2) * P[:, 1]
    tracks = views(0.0, seed, board=replace(true, points=P))
    result = calibrate_known_object(tracks, true, facts=NO_SKEW)
    told = next(one for one in result.findings if one.kind == 'board_print_off').values
    for name, truth in (('stretch_percent', 0.3), ('lean_deg', 0.2)):
        assert abs(told[name]['value'] - truth) < 3.5 * told[name]['sigma'] < 0.1
    assert off_in_sigmas(result) < 3
    assert off_in_sigmas(calibrate_known_object(tracks, true, facts=NO_SKEW, flatness=0)) > 3
    # a true one is not called wrong
    right = calibrate_known_object(views(0.0, seed), true, facts=NO_SKEW)
    assert 'board_print_off' not in [one.kind for one in right.findings]


def test_a_stated_flatness_is_a_measurement():
    tracks = views(0.6e-3, 0, count=4)
    free, stiff = (calibrate_known_object(tracks, a4(), facts=NO_SKEW, flatness=sigma)
                   for sigma in (None, 1e-5))
    free, stiff = (np.ptp(one.reconstruction.points[:, 2]) for one in (free, stiff))
    assert stiff < 0.5 * free


def test_a_solid_does_not_bend():
    points = np.random.default_rng(0).normal(size=(20, 3))
    assert bend_modes(points) is None
    assert bend_modes(points * [1, 0, 0]) is None
    assert bend_modes(points[:4] * [1, 1, 0]) is None
    modes, normal = bend_modes(points * [1, 1, 0])
    assert normal == pytest.approx([0, 0, 1])
    assert np.ptp(modes[:, :3] @ normal, axis=0) == pytest.approx(1)
    assert (modes[:, 3:] @ normal == 0).all()
