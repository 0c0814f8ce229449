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
"""Camera matrices from points: exact without noise, and with the covariance that is true."""

import numpy as np
import pytest
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import homogeneous
from selfcal_ros.geometry.resection import (decompose, projection_jacobian, resect,
                                            resect_linear)
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.geometry.triangulation import project
from selfcal_ros.synthetic.grid_scenes import CORNER_NOISE_PX, grid_camera, grid_points

K = grid_camera(skew=2.0).K
R = rotation_matrix([0.2, -0.3, 0.1])
CENTRE = np.array([1.2, 1.0, -4.2])
P = K @ np.column_stack([R, -R @ CENTRE])
POINTS = grid_points()
XY = project(P, homogeneous(POINTS))


def test_camera_is_exact_without_noise():
    for points in (POINTS, -2 * homogeneous(POINTS)):
        parts = decompose(resect(points, XY).P)
        assert np.allclose(parts.K, K, atol=1e-7)
        assert np.allclose(parts.R, R) and np.allclose(parts.centre, CENTRE)
    assert np.allclose(parts.cam_from_world, np.column_stack([R, -R @ CENTRE]))


def test_jacobian_is_the_derivative():
    X = homogeneous(POINTS)[:10]
    slope = projection_jacobian(P, X)[1]
    for k in range(12):
        change = np.zeros(12)
        change[k] = 1e-6 * max(abs(P.ravel()[k]), 1)
        moved = (projection_jacobian(P + change.reshape(3, 4), X)[0]
                 - projection_jacobian(P - change.reshape(3, 4), X)[0]) / (2 * change[k])
        assert np.allclose(moved, slope[:, :, k], rtol=1e-5, atol=1e-7)


def test_stated_covariance_is_that_of_the_estimates():
    rng = np.random.default_rng(0)
    values, stated = [], []
    for _ in range(150):
        found = resect(POINTS, XY + CORNER_NOISE_PX * rng.normal(size=XY.shape))
        parts = decompose(found.P, found.covariance)
        turn = parts.R @ R.T
        values.append([parts.K[0, 0], parts.K[1, 1], parts.K[0, 2], parts.K[1, 2], parts.K[0, 1],
                       turn[2, 1], turn[0, 2], turn[1, 0], *parts.centre])
        stated.append(np.diag(parts.covariance))
    ratio = np.std(values, axis=0) / np.sqrt(np.mean(stated, axis=0))
    assert (np.abs(ratio - 1) < 0.2).all()
    assert found.mean_error_px == pytest.approx(0.158, rel=0.15)
    assert found.sigma_px == pytest.approx(CORNER_NOISE_PX, rel=0.15)


def test_refinement_beats_the_linear_camera_and_bears_gross_errors():
    rng = np.random.default_rng(1)
    noisy = XY + 0.5 * rng.normal(size=XY.shape)
    linear = resect_linear(POINTS, noisy)
    error = np.sum((project(linear, homogeneous(POINTS)) - noisy)**2)
    found = resect(POINTS, noisy)
    assert np.sum(found.residuals**2) < error
    noisy[:6] += 40
    K_bad, K_good = (decompose(resect(POINTS, noisy, huber_sigmas=s).P).K for s in (np.inf, 2.5))
    assert abs(K_good[0, 0] - 649) < 10 < abs(K_bad[0, 0] - 649)


def test_too_few_points_or_a_plane_give_no_camera():
    assert resect(POINTS[:5], XY[:5]).kind == 'too_few'
    plane = POINTS * [1, 1, 0]
    found = resect(plane, project(P, homogeneous(plane)))
    assert isinstance(found, NoEstimate) and not found
