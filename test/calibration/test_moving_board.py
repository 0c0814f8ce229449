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
"""A board that moves while the rows of its images are read."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.object_model import KnownPoints
from selfcal_ros.calibration.bundle.object_poses import ObjectPoses
from selfcal_ros.calibration.bundle.object_rows import ObjectRows
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.features.targets import Chessboard
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.observations import observations
from selfcal_ros.synthetic.waved_boards import CAMERA, waved_board

BOARD = Chessboard(9, 6, 0.03).known
ROLLING = CameraFacts(skew=0.0, shutter='rolling')


def waved(seed, readout_s):
    return waved_board(np.random.default_rng(seed), BOARD, readout_s)


def away(result):
    error = result.camera.parameters[:4] - CAMERA.parameters[:4]
    return np.abs(error / [result.sigma[name] for name in ('fx', 'fy', 'cx', 'cy')]).max()


@pytest.mark.parametrize('seed', [1, 2])
def test_a_board_that_is_waved_before_a_rolling_shutter_gives_the_camera(seed):
    # with all rows at once it is 8.3 and 5.5 sigma off, and the board is said to be bent
    tracks = waved(seed, 0.02)
    result = calibrate_known_object(tracks, BOARD, facts=ROLLING)
    told = {one.kind: one for one in result.findings}

    assert away(result) < 3.5 and result.sigma['fx'] < 0.005 * 520
    assert 0.3 < told['object_moves_in_rows'].values['shift_px'] < 3 and 'board_flat' in told
    # the report knows where each row was
    table = observations(result, tracks)
    rms_px = np.sqrt(np.mean(np.sum(table.residual[table.used]**2, axis=1)))
    assert rms_px == pytest.approx(result.reprojection_rms_px, rel=0.03)
    assert table.used.sum() >= result.observation_count


def test_a_board_that_holds_still_loses_nothing():
    tracks = waved(3, 0.0)
    found, plain = (calibrate_known_object(tracks, BOARD, facts=facts) for facts in (
        ROLLING, replace(ROLLING, shutter='auto')))
    assert not any(one.kind == 'object_moves_in_rows' for one in found.findings)
    np.testing.assert_array_equal(found.camera.parameters, plain.camera.parameters)
    assert found.sigma == plain.sigma


@pytest.mark.parametrize('axis', [0, 1])
def test_derivatives_by_motion_pose_and_lens_are_those_of_the_projection(axis):
    rng, views, points = np.random.default_rng(0), 3, 12
    poses = np.concatenate([rotation_matrix(rng.normal(0, 0.3, (views, 3))), np.array(
        [[0.1, 0.2, 4], [0, -0.2, 5], [0.3, 0, 6]])[:, :, None]], axis=2)
    view = np.repeat(np.arange(views), points)
    state = ObjectState(Lens.of(CAMERA), ObjectPoses(poses),
                        row_motion=rng.normal(0, 0.02, (views, 6)))
    # lines that hardly differ in time, so that these do not depend on what is differentiated by
    model = KnownPoints(np.tile(rng.normal(0, 1, (points, 3)), (views, 1)), None,
                        ObjectRows(0.02, 10**7, axis))
    bundle = Bundle(model, view, view, np.zeros((len(view), 2)), sigma_px=0.1,
                    priors=priors_from_facts(CameraFacts(distortion='radtan')))
    found, count, h = bundle.linearise(state), len(bundle.unknowns), 1e-6
    for k in [0, 1, 2, 3, *bundle.unknowns.by_view[1], *range(count, count + 6)]:
        step, poses_step = np.zeros(count), np.zeros((views, 6))
        if k < count:
            step[k] = h
        else:
            poses_step[1, k - count] = h
        there, back = (bundle.predict(bundle.moved(state, sign * step, sign * poses_step)).residual
                       for sign in (1, -1))
        numeric, mine = (there - back) / (2 * h), np.zeros((len(view), 2))
        if k < bundle.unknowns.shared.stop:
            mine = found.shared[:, :, k]
        elif k < count:
            mine[view == 1] = found.view[view == 1][:, :, k - bundle.unknowns.by_view[1, 0]]
        else:
            mine[view == 1] = found.eliminated[view == 1][:, :, k - count]
        np.testing.assert_allclose(mine, numeric, atol=1e-4 * max(np.abs(numeric).max(), 1))
