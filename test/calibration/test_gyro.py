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
"""
The camera against a gyro: truth, the stated covariance, and what cannot be known.

The gyro is simulated from a smooth path through the true orientations, with noise and a bias.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, RotationSpline
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.mounting.gyro import mount_by_gyro
from selfcal_ros.calibration.mounting.integrated_rates import integrate, RateSteps
from selfcal_ros.calibration.structure.camera_path import camera_path, with_shared_errors
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.synthetic.hard_scenes import hand, one_curve, vehicle
from selfcal_ros.values.angular_rates import AngularRates

BODY_FROM_CAMERA = rotation_matrix([0.9, -1.2, 1.1])
BIAS, DENSITY, STEP_S = np.array([0.01, -0.02, 0.03]), 5e-4, 0.005
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')


def stamps(views, offset_s):
    """Return when each frame was taken, by a camera clock that is ahead."""
    return {k: int((10 + 0.5 * k + offset_s) * 1e9) for k in range(views)}


def gyro_of(rotations, rng, ends_s=0.6):
    """Simulate a gyro on a body whose camera has orientations (V, 3, 3), world from camera."""
    times = 10 + 0.5 * np.arange(len(rotations))
    spline = RotationSpline(times, Rotation.from_matrix(rotations @ BODY_FROM_CAMERA.T))
    when = np.arange(times[0] - ends_s, times[-1] + ends_s, STEP_S)
    rates = spline(np.clip(when, times[0], times[-1]), 1)
    rates[(when < times[0]) | (when > times[-1])] = 0
    rates += BIAS + DENSITY / np.sqrt(STEP_S) * rng.standard_normal(rates.shape)
    return AngularRates((when * 1e9).astype(int), rates)


@pytest.fixture(scope='module')
def waved():
    rng = np.random.default_rng(5)
    turns = np.cumsum(rng.uniform(-8, 8, (10, 3)), axis=0)
    scene = hand(rng, turns, count=150)
    result = calibrate(scene.tracks, facts=FACTS)
    assert result, result
    return scene, result


def test_turns_are_integrated_as_scipy_does():
    rng = np.random.default_rng(1)
    rates, steps = rng.normal(size=(37, 3)), rng.uniform(0.01, 0.1, 37)
    turns, sums = integrate(rates, steps)
    expected = Rotation.identity()
    for rate, step in zip(rates, steps):
        expected = expected * Rotation.from_rotvec(rate * step)
    np.testing.assert_allclose(turns[-1], expected.as_matrix(), atol=1e-12)
    # a small bias turns the end by the integral of the orientation
    bias = np.array([1e-6, -2e-6, 3e-6])
    moved = integrate(rates - bias, steps)[0][-1]
    turned = rotation_vector(turns[-1].T @ moved)
    np.testing.assert_allclose(turned, -turns[-1].T @ sums[-1] @ bias, rtol=2e-3, atol=1e-12)


def test_turn_offset_and_bias_within_their_sigmas(waved):
    scene, result = waved
    true = np.swapaxes(scene.cam_from_world[:, :, :3], 1, 2)
    found = mount_by_gyro(result, gyro_of(true, np.random.default_rng(2)), stamps(10, 0.037))
    mount, sigma = found.mount, found.mount.sigma
    assert mount, mount
    error = rotation_vector(mount.T_body_camera[:3, :3] @ BODY_FROM_CAMERA.T)
    assert error @ np.linalg.solve(mount.covariance[3:6, 3:6], error) < 16
    assert max(sigma[name] for name in ('roll', 'pitch', 'yaw')) < np.radians(0.3)
    assert abs(mount.time_offset_s - 0.037) < 3 * sigma['time_offset'] < 0.01
    assert mount.outlier_count == 0
    assert mount.status == {**dict.fromkeys(('x', 'y', 'z', 'scale'), 'unobservable'),
                            **dict.fromkeys(('roll', 'pitch', 'yaw', 'time_offset'),
                                            'estimated')}
    assert np.isnan(mount.T_body_camera[:3, 3]).all() and np.isinf(sigma['x'])
    # the camera is known better, and not elsewhere
    assert found.sigma['fx'] < result.sigma['fx']
    assert abs(found.camera.K[0, 0] - scene.camera.K[0, 0]) < 4 * found.sigma['fx']


@pytest.mark.long
def test_the_stated_covariance_is_true(waved):
    _, result = waved
    precision = result.reconstruction.pose_precision
    spread = np.linalg.cholesky(with_shared_errors(precision, result.covariance)
                                + 1e-18 * np.eye(precision.covariance.shape[0]))
    rng, squared = np.random.default_rng(3), []
    R = camera_path(result).rotation
    for _ in range(12):
        off = (precision.by_unknowns @ (spread @ rng.standard_normal(len(spread)))).reshape(
            -1, 6)[:, 3:]
        mount = mount_by_gyro(result, gyro_of(rotation_matrix(off) @ R, rng),
                              stamps(10, -0.11)).mount
        error = np.append(rotation_vector(mount.T_body_camera[:3, :3] @ BODY_FROM_CAMERA.T),
                          mount.time_offset_s + 0.11)
        C = mount.covariance[np.ix_([3, 4, 5, 7], [3, 4, 5, 7])]
        squared.append(error @ np.linalg.solve(C, error))
    # four degrees of freedom: mean 4, standard deviation √8
    assert abs(np.mean(squared) - 4) < 3 * np.sqrt(8 / 12)


@pytest.mark.parametrize('begin, end, known', [
    (9.0, 9.5, True), (9.5, 10.0, True), (9.8, 10.5, False), (10.2, 10.7, False),
    (10.0, 12.0, False), (10.5, 11.8, False), (11.5, 12.3, False), (12.0, 12.6, True),
    (9.5, 12.5, False), (-0.1, 1.0, False), (14.5, 15.5, False)])
def test_an_interval_that_touches_a_gap_is_not_known(begin, end, known):
    times = np.r_[np.arange(0, 1001), np.arange(1200, 1501)] / 100
    gyro = RateSteps(times, np.zeros((len(times) - 1, 3)))
    assert gyro.covers(np.array([begin, end])).tolist() == [known]


@pytest.mark.parametrize('begin, end, offset_s, intervals', [
    (12.1, 13.6, 0.0, 5), (12.1, 13.1, 0.3, 6), (12.1, 13.1, -0.3, 6)])
def test_a_gap_of_the_gyro_counts_by_its_own_clock(waved, begin, end, offset_s, intervals):
    scene, result = waved
    gyro = gyro_of(np.swapaxes(scene.cam_from_world[:, :, :3], 1, 2), np.random.default_rng(2))
    kept = (gyro.stamps_ns < begin * 1e9) | (gyro.stamps_ns > end * 1e9)
    gyro = AngularRates(gyro.stamps_ns[kept], gyro.rate_rad_s[kept])
    mount = mount_by_gyro(result, gyro, stamps(10, offset_s)).mount
    assert (mount.pose_count, mount.outlier_count) == (intervals, 0)
    error = rotation_vector(mount.T_body_camera[:3, :3] @ BODY_FROM_CAMERA.T)
    assert error @ np.linalg.solve(mount.covariance[3:6, 3:6], error) < 16


def test_a_wrong_view_is_set_aside(waved):
    scene, result = waved
    true = np.swapaxes(scene.cam_from_world[:, :, :3], 1, 2).copy()
    true[4] = true[4] @ rotation_matrix([0.1, 0.05, -0.1])
    mount = mount_by_gyro(result, gyro_of(true, np.random.default_rng(2)), stamps(10, 0.0)).mount
    error = rotation_vector(mount.T_body_camera[:3, :3] @ BODY_FROM_CAMERA.T)
    assert mount.outlier_count
    assert error @ np.linalg.solve(mount.covariance[3:6, 3:6], error) < 16


def test_a_left_handed_gyro_is_refused(waved):
    scene, result = waved
    gyro = gyro_of(np.swapaxes(scene.cam_from_world[:, :, :3], 1, 2), np.random.default_rng(2))
    mirrored = AngularRates(gyro.stamps_ns, gyro.rate_rad_s * [-1, 1, 1])
    found = mount_by_gyro(result, mirrored, stamps(10, 0.0))
    assert found.mount.kind == 'gyro_contradicts' and found.camera is result.camera


def test_turns_about_one_axis_leave_it_open():
    rng = np.random.default_rng(0)
    scene = vehicle(rng, one_curve(8), count=120)
    result = calibrate(scene.tracks, facts=FACTS)
    assert result, result
    true = np.swapaxes(scene.cam_from_world[:, :, :3], 1, 2)
    found = mount_by_gyro(result, gyro_of(true, rng), stamps(len(true), 0.0))
    assert not found.mount and found.mount.kind == 'gyro_leaves_an_axis_open'
    assert found.camera is result.camera


def test_a_gyro_of_another_time_is_refused(waved):
    scene, result = waved
    true = np.swapaxes(scene.cam_from_world[:, :, :3], 1, 2)
    gyro = gyro_of(true, np.random.default_rng(2))
    found = mount_by_gyro(result, gyro, stamps(10, 3600.0))
    assert found.mount.kind == 'gyro_covers_too_little'
    assert mount_by_gyro(result, gyro, {}).mount.kind == 'gyro_without_poses'


@pytest.mark.parametrize('stamps_ns, rate, word', [
    ([0, 1], np.zeros((3, 3)), 'instants'), ([1, 0], np.zeros((2, 3)), 'order'),
    ([0, 1], np.full((2, 3), np.nan), 'finite'), ([0, 1], np.full((2, 3), 90.0), 'degrees')])
def test_bad_rates_are_one_sentence(stamps_ns, rate, word):
    with pytest.raises(InputError, match=word):
        AngularRates(np.array(stamps_ns), rate)
