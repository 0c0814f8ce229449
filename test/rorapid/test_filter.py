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
"""The Kalman filter: textbook values, and both ways of updating are one."""

import numpy as np
import pytest

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.estimation.kalman_filter import ConstantVelocityFilter
from selfcal_ros.rorapid.projection.camera_models import Projection
from selfcal_ros.rorapid.projection.motion_models import completed, motion_basis

PROJECTION = Projection(Camera([[540, 0, 320], [0, 540, 240], [0, 0, 1]]))


def new(motion='general', acceleration=1.0, random_walk=0.0):
    basis = motion_basis(motion, 6, [0, 0, 1])
    m = basis.shape[1]
    state = PROJECTION.from_pose(rotation_matrix([0.1, 0.2, 0.3]), [0, 0, 0.5])
    return ConstantVelocityFilter(PROJECTION, basis, state, 1e-4 * np.eye(m), np.full(m, 0.5),
                                  np.full(m, acceleration), random_walk)


@pytest.mark.parametrize('motion', ('general', 'translation', 'planar'))
def test_prediction_is_that_of_the_textbook(motion):
    kalman = new(motion)
    m = kalman.basis.shape[1]
    kalman.velocity = np.arange(m) * 0.1
    P, dt = kalman.covariance.copy(), 0.04
    F = np.eye(2 * m)
    F[:m, m:] = dt * np.eye(m)
    Q = np.kron([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]], np.eye(m))
    before = kalman.state
    after = kalman.predict(dt)
    assert np.allclose(kalman.covariance, F @ P @ F.T + Q)
    step = PROJECTION.difference(after, before)
    assert np.allclose(step, kalman.basis @ (np.arange(m) * 0.1 * dt), atol=1e-9)


def test_absorbing_a_posterior_equals_updating():
    one, other = new(), new()
    noise = np.diag([1e-5] * 3 + [1e-6] * 3)
    for kalman in (one, other):
        kalman.predict(0.04)
    measured = PROJECTION.moved(one.state, np.array([1e-3, 0, 2e-3, 1e-3, -2e-3, 1e-3]))
    prior = other.pose_covariance.copy()
    information = np.linalg.inv(prior) + np.linalg.inv(noise)
    step = np.linalg.solve(information, np.linalg.solve(
        noise, PROJECTION.difference(measured, other.state)))
    one.update(measured, noise)
    other.absorb(PROJECTION.moved(other.state, step), np.linalg.inv(information))
    assert np.allclose(one.covariance, other.covariance, atol=1e-12)
    assert np.allclose(one.velocity, other.velocity, atol=1e-9)
    assert np.allclose(PROJECTION.difference(one.state, other.state), 0, atol=1e-6)


def test_a_steady_motion_is_learned():
    kalman = new(acceleration=0.1)
    velocity = np.array([0.2, -0.1, 0.3, 0.1, 0.05, -0.1])
    truth = kalman.state
    for _ in range(60):
        truth = PROJECTION.moved(truth, velocity / 25)
        kalman.predict(1 / 25)
        kalman.update(truth, 1e-8 * np.eye(6))
    # the turn is about fixed axes of the camera only to first order
    assert np.allclose(kalman.velocity, velocity, atol=0.01)


def test_covariance_is_consistent():
    """Normalised errors over many runs have the mean of a chi-square of 6 degrees of freedom."""
    rng = np.random.default_rng(5)
    squares = []
    noise = np.diag([2e-3**2] * 3 + [1e-3**2] * 3)
    for _ in range(120):
        kalman = new()
        truth = PROJECTION.moved(kalman.state, rng.normal(0, 1e-2, 6))
        velocity = rng.normal(0, 0.5, 6)
        for _ in range(12):
            push = rng.normal(0, 1.0, 6)
            truth = PROJECTION.moved(truth, velocity * 0.04 + push * 0.04**2 / 2)
            velocity = velocity + push * 0.04
            kalman.predict(0.04)
            kalman.update(PROJECTION.moved(truth, rng.multivariate_normal(np.zeros(6), noise)),
                          noise)
        error = PROJECTION.difference(truth, kalman.state)
        squares.append(error @ np.linalg.solve(kalman.pose_covariance, error))
    assert 5.0 < np.mean(squares) < 7.2


def test_what_does_not_move_is_found_out_from_all_measurements():
    basis = completed(motion_basis('translation', 6))
    start = PROJECTION.from_pose(np.eye(3), [0, 0, 0.5])
    still = np.array([0, 0, 0, 1.0, 1.0, 1.0])
    kalman = ConstantVelocityFilter(PROJECTION, basis, start, 1e-2 * np.eye(6),
                                    0.5 * np.r_[np.ones(3), np.zeros(3)],
                                    np.r_[np.ones(3), np.zeros(3)])
    rng = np.random.default_rng(6)
    truth = PROJECTION.moved(start, np.array([0.05, -0.04, 0.06, 0, 0, 0]))
    for _ in range(100):
        kalman.predict(0.04)
        kalman.update(PROJECTION.moved(truth, 0.01 * rng.normal(size=6)), 1e-4 * np.eye(6))
    assert np.abs(PROJECTION.difference(truth, kalman.state)[:3]).max() < 0.004
    full = basis @ kalman.pose_covariance @ basis.T
    assert np.sqrt(full[0, 0]) < 0.0015 and still @ np.diag(full) > 0


def test_a_restart_forgets():
    kalman = new()
    kalman.velocity[:] = 3
    kalman.restart(kalman.state, 1e-3 * np.eye(6))
    assert not kalman.velocity.any() and np.allclose(kalman.pose_covariance, 1e-3 * np.eye(6))
