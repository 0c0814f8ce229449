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
"""Projective helpers against their definitions."""

import numpy as np
import pytest
from selfcal_ros.geometry import projective
from selfcal_ros.geometry.no_estimate import NoEstimate
from test_support.image_maps import transform_points


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def test_cross_matrix_is_the_cross_product(rng):
    a, b = rng.normal(size=(2, 5, 3))
    assert (projective.cross_matrix(a) @ b[..., None])[..., 0] == pytest.approx(np.cross(a, b))


def test_normalising_transform_centres_and_scales(rng):
    xy = rng.normal(size=(40, 2)) * 70 + [300, 200]
    moved = transform_points(projective.normalising_transform(xy), xy)
    assert moved.mean(axis=0) == pytest.approx([0, 0], abs=1e-12)
    assert np.linalg.norm(moved, axis=1).mean() == pytest.approx(np.sqrt(2))
    assert np.isfinite(projective.normalising_transform(np.ones((4, 2)))).all()


def test_rq_gives_back_its_factors(rng):
    K = np.array([[900, 5, 400], [0, 950, 300], [0, 0, 1.0]])
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for sign in (1, -1):
        U, Q = projective.rq(sign * K @ R)
        assert U == pytest.approx(K, abs=1e-8) and Q == pytest.approx(sign * R, abs=1e-12)


def test_canonical_transform_carries_both_to_the_y_direction(rng):
    for _ in range(10):
        line, point = rng.normal(size=(2, 3))
        H = projective.canonical_transform(line, point)
        moved = np.linalg.solve(H.T, line)
        assert np.cross(moved, [0, 1, 0]) == pytest.approx([0, 0, 0], abs=1e-9 * abs(moved[1]))
        assert np.cross(H @ point, [0, 1, 0]) == pytest.approx([0, 0, 0], abs=1e-9)


def test_completed_frame_is_a_rotation_and_small_rotation_is_one_to_first_order(rng):
    frame = projective.completed_frame(projective.unit(rng.normal(size=(6, 3))))
    assert frame @ np.swapaxes(frame, 1, 2) == pytest.approx(np.tile(np.eye(3), (6, 1, 1)))
    assert np.linalg.det(frame) == pytest.approx(np.ones(6))
    w = 1e-5 * rng.normal(size=3)
    expected = np.eye(3) + projective.cross_matrix(w)
    assert projective.small_rotation(w) == pytest.approx(expected, abs=1e-9)


def test_calibration_and_iac_are_inverse_to_each_other():
    K = np.array([[646, 3.5, 260], [0, 969, 237], [0, 0, 1.0]])
    omega = projective.iac_from_calibration(K)
    assert projective.calibration_from_iac(-7 * omega) == pytest.approx(K)
    refused = projective.calibration_from_iac(omega - 2 * omega[2, 2] * np.diag([0, 0, 1]))
    assert isinstance(refused, NoEstimate) and refused.kind == 'conic_not_definite'
    assert not projective.calibration_from_iac(np.full((3, 3), np.nan))


def test_pole_of_the_horizon_is_the_vanishing_point_of_the_axis(rng):
    K = np.array([[900, 5, 400], [0, 990, 300], [0, 0, 1.0]])
    axis = projective.unit(rng.normal(size=3))
    point = np.linalg.solve(projective.iac_from_calibration(K), np.linalg.solve(K.T, axis))
    assert point == pytest.approx(K @ axis)


def test_scaling_a_vector_carries_its_covariance(rng):
    x = np.array([-3.0, 8.0, 2.0])
    root = 1e-4 * rng.normal(size=(3, 3))
    draws = x + rng.normal(size=(20000, 3)) @ root.T
    xy, covariance = projective.euclidean_covariance(x, root @ root.T)
    assert xy == pytest.approx([-1.5, 4.0])
    assert covariance == pytest.approx(np.cov((draws[:, :2] / draws[:, 2:]).T), rel=0.05)
    _, covariance = projective.unit_covariance(x, root @ root.T)
    tolerance = 0.03 * covariance.max()
    assert covariance == pytest.approx(np.cov(projective.unit(draws).T), abs=tolerance)


def test_weighted_mean_prefers_the_certain_and_ignores_signs():
    vectors = projective.unit(np.array([[1e-3, 0, 1], [0, -3e-3, -1]]))
    covariances = np.array([1e-8 * np.eye(3), 1e-2 * np.eye(3)])
    mean, covariance = projective.weighted_mean(vectors, covariances)
    assert np.abs(mean[:2] / mean[2]) == pytest.approx([1e-3, 0], abs=1e-7)
    assert np.linalg.eigvalsh(covariance)[1:] == pytest.approx([1e-8, 1e-8], rel=1e-4)
