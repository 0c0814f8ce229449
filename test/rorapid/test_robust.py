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
"""RANSAC in a primitive, case deletion over primitives, weights."""

import numpy as np

from selfcal_ros.geometry.robust_loss import tukey_weight
from selfcal_ros.geometry.robust_scale import fast_robust_sigma, robust_sigma
from selfcal_ros.rorapid.estimation.primitive_detection import (case_deletion, ransac_conics,
                                                                ransac_lines, stability)


def test_ransac_keeps_the_edgels_of_the_line():
    rng = np.random.default_rng(1)
    along = np.linspace(0, 50, 6)
    xy = np.stack([np.column_stack([along, 0.5 * along + k]) for k in range(8)])
    xy += 0.2 * rng.normal(size=xy.shape)
    valid = np.ones((8, 6), bool)
    wrong = np.zeros_like(valid)
    for k in range(8):
        at = rng.permutation(6)[:k % 3]
        xy[k, at, 1] += 9 + 3 * np.arange(len(at))
        wrong[k, at] = True
    valid[7, :2] = False
    support = ransac_lines(xy, valid, 2.0)
    assert np.array_equal(support, valid & ~wrong)


def test_ransac_with_many_points_draws_samples():
    rng = np.random.default_rng(2)
    along = np.linspace(0, 300, 60)
    xy = np.column_stack([along, np.where(np.arange(60) % 3 == 0, 40.0 + 5 * rng.random(60), 0)])
    support = ransac_lines(xy[None], np.ones((1, 60), bool), 2.0, rng, most_samples=100)
    assert np.array_equal(support[0], np.arange(60) % 3 != 0)


def test_ransac_keeps_the_edgels_of_the_conic():
    rng = np.random.default_rng(3)
    angle = np.arange(10) * 2 * np.pi / 10
    ellipse = np.column_stack([300 + 60 * np.cos(angle), 200 + 25 * np.sin(angle)])
    xy = np.stack([ellipse, ellipse + [40, 9]]) + 0.2 * rng.normal(size=(2, 10, 2))
    xy[0, 3] += [0, 12]
    xy[1, [1, 7]] += [[9, 9], [-8, 8]]
    support = ransac_conics(xy, np.ones((2, 10), bool), 2.0, rng)
    assert not support[0, 3] and support[0].sum() == 9
    assert not support[1, [1, 7]].any() and support[1].sum() == 8


def test_too_few_edgels_support_nothing():
    rng = np.random.default_rng(4)
    valid = np.zeros((2, 6), bool)
    valid[0, 0] = True
    assert not ransac_lines(rng.random((2, 6, 2)), valid, 2.0).any()
    assert not ransac_conics(rng.random((2, 10, 2)), np.zeros((2, 10), bool), 2.0, rng).any()
    assert ransac_conics(np.zeros((0, 10, 2)), np.zeros((0, 10), bool), 2.0, rng).shape == (0, 10)


def primitives(rng, wrong=()):
    """Normal equations of 10 primitives with 6 edgels each, some of them 15 px off."""
    truth = np.array([1.0, -2.0, 0.5, 1.5, -1.0, 2.0])
    matrices, vectors, squares = [], [], []
    for k in range(10):
        rows = rng.normal(size=(6, 6))
        length = rows @ truth + 0.1 * rng.normal(size=6) + (15 if k in wrong else 0)
        matrices.append(rows.T @ rows)
        vectors.append(rows.T @ length)
        squares.append(length @ length)
    return np.array(matrices), np.array(vectors), np.array(squares), np.full(10, 6.0)


def test_case_deletion_removes_the_wrong_primitives_and_no_other():
    rng = np.random.default_rng(5)
    damping = 1e-9 * np.eye(6)
    for wrong in ((), (4,), (2, 7)):
        alive = case_deletion(*primitives(rng, wrong), 4.0, 3, damping)
        assert set(np.flatnonzero(~alive)) == set(wrong)


def test_case_deletion_leaves_enough():
    alive = case_deletion(*primitives(np.random.default_rng(6), range(0, 10, 2)), 0.01, 8,
                          1e-9 * np.eye(6))
    assert alive.sum() >= 8


def test_weights():
    assert np.allclose(stability(np.array([1, 0]), np.array([1.0, 0.5])), [1, 0.25])
    w = tukey_weight(np.array([0.0, 1.0, 4.0, -9.0]), 4.0)
    assert w[0] == 1 and 0 < w[1] < 1 and w[2] == w[3] == 0
    residual = np.random.default_rng(7).normal(0, 2.0, 4000)
    residual[:400] = 100
    assert abs(fast_robust_sigma(residual, 0.1) - 2.0) < 0.4
    assert fast_robust_sigma(np.zeros(0), 0.3) == 0.3
    np.testing.assert_allclose(robust_sigma(residual), fast_robust_sigma(residual, 0.1), rtol=0.1)
    rows = np.stack([residual, np.where(np.arange(len(residual)) < 5, np.nan, residual)])
    np.testing.assert_allclose(robust_sigma(rows, axis=1),
                               [robust_sigma(residual), robust_sigma(residual[5:])])
