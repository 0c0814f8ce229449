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
"""Points from rays: the correction line is optimal, intersections are exact without noise."""

import numpy as np
import pytest
from selfcal_ros.geometry.projective import homogeneous, tangent_basis
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.geometry.triangulation import (correct_to_epipolar_line, metric_points, project,
                                                translated_points, triangulate)

K = np.array([[649.0, 2, 252], [0, 973, 256], [0, 0, 1]])


def _translated(rng, epipole, noise_px=0.0):
    a, depth = rng.uniform(0, 500, (60, 2)), rng.uniform(0.2, 1, 60)
    h = homogeneous(a) + depth[:, None] * np.asarray(epipole)
    b = h[:, :2] / h[:, 2:]
    return a + noise_px * rng.normal(size=a.shape), b + noise_px * rng.normal(size=b.shape), depth


@pytest.mark.parametrize('epipole', [(30, -20, 0.1), (50, 10, 0.0), (40.0, -25, 1e-7)])
def test_translated_points_are_exact_without_noise(epipole):
    a, b, depth = _translated(np.random.default_rng(0), epipole)
    points = translated_points(epipole, a, b)
    assert np.allclose(points[:, 3], depth, atol=1e-9)
    assert np.allclose(points[:, :2], a, atol=1e-7)


def test_correction_line_is_the_best_of_all_lines_through_the_epipole():
    epipole = np.array([30, -20, 0.1])
    a, b, _ = _translated(np.random.default_rng(1), epipole, 0.5)
    near_a, near_b, moved = correct_to_epipolar_line(epipole, a, b)
    angle = np.linspace(0, np.pi, 20001)
    normal = np.stack([-np.sin(angle), np.cos(angle)])
    offsets = (a - epipole[:2] / epipole[2]) @ normal, (b - epipole[:2] / epipole[2]) @ normal
    best = (offsets[0]**2 + offsets[1]**2).min(axis=1)
    found = (moved**2).sum(axis=1)
    assert (found <= best + 1e-9).all() and np.allclose(found, best, atol=1e-2)
    assert np.allclose(np.linalg.norm(near_a - a, axis=1), np.abs(moved[:, 0]))
    # the corrected points and e lie on one line
    triple = np.linalg.det(np.stack([homogeneous(near_a), homogeneous(near_b),
                                     np.tile(epipole, (60, 1))], axis=1))
    assert np.abs(triple).max() < 1e-6


def test_correction_does_not_jump_where_the_epipole_goes_to_infinity():
    a, b, _ = _translated(np.random.default_rng(2), (50, 10, 0.0), 0.5)
    there = correct_to_epipolar_line((50, 10, 0), a, b)[2]
    assert np.allclose(correct_to_epipolar_line((50, 10, 1e-10), a, b)[2], there, atol=1e-4)


def _views(rng, count=5):
    cameras = []
    for _ in range(count):
        R, c = rotation_matrix(0.1 * rng.normal(size=3)), rng.normal(size=3) * 0.5 - [0, 0, 5]
        cameras.append(K @ np.column_stack([R, -R @ c]))
    return np.array(cameras)


def test_many_views_intersect_exactly_and_least_squares_with_noise():
    rng = np.random.default_rng(3)
    cameras, X = _views(rng), rng.uniform(-1, 1, (80, 3))
    view, point = (i.ravel() for i in np.meshgrid(range(5), range(80), indexing='ij'))
    xy = project(cameras[view], homogeneous(X)[point])
    Y = triangulate(cameras, view, point, xy)
    assert np.allclose(Y[:, :3] / Y[:, 3:], X, atol=1e-9)
    noisy = xy + rng.normal(size=xy.shape)
    Y = triangulate(cameras, view, point, noisy)

    def cost(points):
        return np.bincount(point, np.sum((project(cameras[view], points[point]) - noisy)**2, 1))
    best = cost(Y)
    for direction in np.moveaxis(tangent_basis(Y), 2, 0):
        assert (cost(Y + 1e-3 * direction) > best).all()
        assert (cost(Y - 1e-3 * direction) > best).all()


def test_metric_points_undo_the_calibration():
    rng = np.random.default_rng(4)
    X = rng.uniform(-1, 1, (20, 3)) + [0, 0, 4]
    affine = np.column_stack([X @ K.T, np.ones(20)])
    assert np.allclose(metric_points(K, 3 * affine), X)
