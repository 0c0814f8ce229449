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
"""Many calibrations of one camera: weights, facts counted once, and a test that is true."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import calibrate
from selfcal_ros.calibration.estimators.joint import combine
from selfcal_ros.calibration.estimators.under_camera import under_camera
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import rms_length
from selfcal_ros.synthetic.special_scenes import hand_held

TRUTH = np.r_[520, 520, 320, 240, 0, -0.12, 0.05, np.zeros(len(PARAMETER_NAMES) - 7)]
#: What fx and fy have in common.
FOCAL = np.r_[1, 1, np.zeros(len(PARAMETER_NAMES) - 2)]
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')
FREE = [0, 2, 3, 5, 6]


def calibration(values, covariance, facts=FACTS):
    return Calibration(Camera.from_parameters(values, 640, 480), covariance, {}, {}, 'planar',
                       facts, (1, 2, 3), 0.1, 0.1, 100, 1, None)


def draw(rng, truth=TRUTH, scale=1.0):
    """Draw a calibration with a covariance of its own; fx and fy move together."""
    half = scale * np.diag([1, 0.8, 0.8, 0.002, 0.003]) @ rng.standard_normal((5, 8)) / 2
    root = np.zeros((len(PARAMETER_NAMES), 8))
    root[FREE], root[1] = half, half[0]
    return calibration(truth + root @ rng.standard_normal(8), root @ root.T)


def test_joint_estimate_covariance_and_p_values_are_true():
    rng, distance, p, scatter = np.random.default_rng(0), [], [], []
    for _ in range(150):
        joint = combine([draw(rng) for _ in range(8)])
        error = (joint.calibration.camera.parameters - TRUTH)[FREE]
        C = joint.calibration.covariance[np.ix_(FREE, FREE)] / max(joint.scatter, 1)**2
        distance.append(error @ np.linalg.solve(C, error))
        p.append(joint.p_value)
        scatter.append(joint.scatter)
        assert joint.freedom == 8 * 5 - 5
    # chi-square with five degrees of freedom: mean 5, and that of 150 within three sigmas
    assert abs(np.mean(distance) - 5) < 3 * np.sqrt(10 / 150)
    for nominal in (0.2, 0.5, 0.8):
        assert abs(np.mean(np.array(p) < nominal) - nominal) < 3 * 0.5 / np.sqrt(150)
    status = joint.calibration.status
    assert status['fx'] == 'estimated' and status['skew'] == status['p1'] == 'held'
    assert joint.calibration.camera.K[0, 0] == joint.calibration.camera.K[1, 1]


def test_what_is_of_one_recording_is_no_part_of_the_joint_estimate():
    rng = np.random.default_rng(1)
    one = replace(draw(rng), mount=NoEstimate('body_stood_still', body='base'),
                  shutter=RowReadout(2e-5, 1e-7, 'estimated', 0.288, 0.00144, 480))
    joint = combine([one, draw(rng)]).calibration
    assert joint.mount is joint.shutter is joint.labels is joint.identifiability is None


def test_path_and_points_follow_the_camera_of_all_recordings():
    scene = hand_held(np.random.default_rng(2), 0.1, 12, 150, 8)
    result = calibrate(scene.tracks, motion='general',
                       facts=CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none'))
    values = result.camera.parameters + 2 * np.array([*result.sigma.values()])
    other = Camera.from_parameters(values, result.camera.width, result.camera.height)
    followed = under_camera(result, other, scene.tracks)

    def left_px(one):
        path = one.reconstruction
        tracks = scene.tracks.select(np.isin(scene.tracks.track, path.tracks))
        row = np.searchsorted(path.tracks, tracks.track)
        view = np.searchsorted(path.frames, tracks.frame)
        seen = np.einsum('nij,nj->ni', path.cam_from_world[view], path.points[row])
        return rms_length(one.camera.project(seen) - tracks.xy)

    alone = replace(result, camera=other)
    assert left_px(alone) > 1.3 * left_px(result)
    assert left_px(followed) < 1.02 * left_px(result)
    assert followed.reprojection_rms_px == pytest.approx(left_px(followed), rel=0.02)
    assert followed.camera is other


def test_of_independent_parameters_it_is_the_weighted_mean():
    C = np.diag([4.0, 4, 1, 1, *[0] * (len(PARAMETER_NAMES) - 4)])
    C[0, 1] = C[1, 0] = 4
    facts = replace(FACTS, distortion='none')
    a = calibration([520, 520, 320, 240, 0, 0, 0, 0, 0], C, facts)
    b = calibration([522, 522, 321, 240, 0, 0, 0, 0, 0], C / 3, facts)
    joint = combine([a, b])
    assert joint.calibration.camera.K[0, 0] == pytest.approx(521.5)
    assert joint.calibration.sigma['fx'] == pytest.approx(1.0)
    assert joint.calibration.sigma['skew'] == 0
    assert joint.chi2 == pytest.approx(4 / (4 + 4 / 3) + 1 / (1 + 1 / 3))


def test_a_fact_is_known_once_however_many_recordings_state_it():
    # the images say nothing of the principal point: each result is the fact again
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0, principal_point=(320, 240),
                        principal_point_sigma_px=3.0, distortion='none')
    C = np.diag([1.0, 1, 9, 9, *[0] * (len(PARAMETER_NAMES) - 4)])
    C[0, 1] = C[1, 0] = 1
    same = calibration([520, 520, 320, 240, 0, 0, 0, 0, 0], C, facts)
    joint = combine([same] * 9)
    assert joint.calibration.sigma['fx'] == pytest.approx(1 / 3, rel=1e-6)
    assert joint.calibration.sigma['cx'] == pytest.approx(3, rel=1e-3)
    # half the information of each is from its images
    half = C.copy()
    half[2, 2] = half[3, 3] = 4.5
    joint = combine([calibration([520, 520, 321, 240, 0, 0, 0, 0, 0], half, facts)] * 9)
    assert joint.calibration.sigma['cx'] == pytest.approx(3 / np.sqrt(10), rel=1e-3)
    # each would say 322 without the fact
    assert joint.calibration.camera.K[0, 2] == pytest.approx(320 + 2 * 9 / 10, rel=1e-3)


def test_one_that_contradicts_the_rest_is_left_out_and_named():
    rng = np.random.default_rng(1)
    many = [draw(rng) for _ in range(9)]
    many.insert(4, draw(rng, TRUTH + 15 * FOCAL))
    joint = combine(many)
    assert not joint.agree and np.flatnonzero(~joint.used).tolist() == [4]
    assert joint.deviation[4] > 3 > np.delete(joint.deviation, 4).max()
    assert joint.p_value > 0.001
    error = joint.calibration.camera.K[0, 0] - 520
    assert abs(error) < 4 * joint.calibration.sigma['fx']


def test_a_drift_is_a_disagreement_and_widens_sigma():
    rng = np.random.default_rng(2)
    drift = [draw(rng, TRUTH + 4.0 * k * FOCAL) for k in range(10)]
    joint = combine(drift)
    still = combine([draw(np.random.default_rng(2)) for _ in range(10)])
    assert not joint.agree and joint.scatter > 1.5 and joint.p_value < 1e-6
    assert joint.calibration.sigma['fx'] > 1.5 * still.calibration.sigma['fx']
    assert still.agree


def test_one_alone_and_what_cannot_be_combined():
    one = draw(np.random.default_rng(3))
    joint = combine([one])
    assert np.allclose(joint.calibration.camera.parameters, one.camera.parameters)
    assert np.allclose(joint.calibration.covariance, one.covariance, atol=1e-9)
    assert joint.freedom == 0 and joint.agree and np.isnan(joint.deviation).all()
    with pytest.raises(InputError, match='no calibration'):
        combine([])
    with pytest.raises(InputError, match='facts'):
        combine([one, calibration(TRUTH, one.covariance, CameraFacts())])
