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
"""Epipolar geometry through lenses up to 185 degrees, against exact stereographic images."""

import numpy as np
import pytest
from selfcal_ros.geometry.division import DivisionModel, residuals
from selfcal_ros.geometry.lifted_ransac import lifted_fits, lifted_ransac
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.geometry.shared_division import shared_division

SIZE = (640, 480)


def images(rng, division, motions, noise_px=0.0, outliers=0.0, count=400):
    """Matches of two views each, through the stereographic lens with this division."""
    model = DivisionModel((division,), SIZE)
    focal = model.half_diagonal_px * np.sqrt(-0.25 / division) if division else 500.0
    widest = 2 * np.arctan(380 / (2 * focal)) if division else 0.5
    pairs, matrices = [], []
    for turn, step in motions:
        R, step = rotation_matrix(np.array(turn)), np.array(step, float)
        axis = rng.normal(size=(20 * count, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        X = axis * rng.uniform(2, 6, (len(axis), 1))
        Y = X @ R.T + step
        seen = [np.arccos(P[:, 2] / np.linalg.norm(P, axis=1)) < widest for P in (X, Y)]
        both = np.flatnonzero(seen[0] & seen[1])[:count]
        sides = []
        for P in (X[both], Y[both]):
            rho = np.hypot(P[:, 0], P[:, 1])
            radius = 2 * focal * np.tan(np.arctan2(rho, P[:, 2]) / 2) if division \
                else focal * rho / P[:, 2]
            sides.append(model.centre + P[:, :2] * (radius / rho)[:, None]
                         + rng.normal(0, noise_px, (len(both), 2)))
        wrong = rng.random(len(both)) < outliers
        sides[1][wrong] = rng.uniform([0, 0], SIZE, (wrong.sum(), 2))
        pairs.append(tuple(sides))
        K = np.diag([focal, focal, model.half_diagonal_px])
        cross = np.array([[0, -step[2], step[1]], [step[2], 0, -step[0]],
                          [-step[1], step[0], 0]])
        matrices.append(np.linalg.inv(K) @ cross @ R @ np.linalg.inv(K))
    return model, pairs, matrices


HAND = [((0.1, 0.2, 0), (1, 0.2, 0.1)), ((0, -0.3, 0.2), (0.2, 1, 0.3)),
        ((0.2, 0, -0.1), (-0.7, 0.3, 0.6)), ((0.1, 0.1, 0.3), (0.5, -0.6, -0.4))]


@pytest.mark.parametrize('division', [-0.1, -0.6, -1.2])
def test_points_beyond_90_degrees_lie_on_their_epipolar_curves(division):
    model, pairs, matrices = images(np.random.default_rng(0), division, HAND)
    assert (model.lifted(pairs[0][0])[:, 2] < 0).any() == (division == -1.2)
    for F, (a, b) in zip(matrices, pairs):
        assert np.abs(model.sampson_distance(F, a, b)).max() < 1e-6
        line = model.lifted(a) @ F.T
        assert np.abs(model.curve_distance(line, model.raised(b))).max() < 1e-6
        assert np.allclose(model.pixels(model.lifted(a)), a, atol=1e-8)


def test_distances_have_the_sigma_of_the_noise_in_the_image():
    model, pairs, matrices = images(np.random.default_rng(1), -1.2, HAND, noise_px=0.5)
    distances = [model.sampson_distance(F, *pair) for F, pair in zip(matrices, pairs)]
    assert np.std(np.concatenate(distances)) == pytest.approx(0.5, rel=0.06)


def test_two_coefficients_are_undone():
    model = DivisionModel((-0.8, -0.3), SIZE)
    xy = np.random.default_rng(2).uniform([0, 0], SIZE, (200, 2))
    assert np.abs(model.pixels(model.lifted(xy)) - xy).max() < 1e-6


def test_slopes_are_the_numeric_ones():
    rng, step = np.random.default_rng(3), 1e-6
    a, b = rng.uniform(-0.7, 0.7, (2, 2, 5, 2))
    F, coefficients = rng.normal(size=(2, 3, 3)), np.array([-0.8, 0.3])
    _, by_F, by_coefficient = residuals(a, b, F, coefficients, derivative=True)
    for k in range(9):
        move = step * np.eye(9)[k].reshape(3, 3)
        slope = (residuals(a, b, F + move, coefficients)[0]
                 - residuals(a, b, F - move, coefficients)[0]) / (2 * step)
        assert np.allclose(slope, by_F[..., k], atol=1e-7)
    for k in range(2):
        move = step * np.eye(2)[k]
        slope = (residuals(a, b, F, coefficients + move)[0]
                 - residuals(a, b, F, coefficients - move)[0]) / (2 * step)
        assert np.allclose(slope, by_coefficient[..., k], atol=1e-7)


def test_half_of_the_matches_may_be_wrong():
    rng = np.random.default_rng(4)
    model, pairs, matrices = images(rng, -1.2, HAND, 0.2, outliers=0.5)
    for (a, b), true in zip(pairs, matrices):
        found = lifted_ransac(model.units(a), model.units(b), np.array(model.coefficients),
                              1.0 / model.half_diagonal_px, rng)
        right = np.abs(model.sampson_distance(true, a, b)) < 1
        assert np.mean(found[1][right]) > 0.97
        assert np.mean(found[1][~right]) < 0.1


def test_pairs_fitted_together_agree_with_each_by_itself():
    rng = np.random.default_rng(8)
    model, pairs, _ = images(rng, -1.2, HAND, 0.2, outliers=0.2)
    coefficients, threshold = np.array(model.coefficients), 1.0 / model.half_diagonal_px
    units = [(model.units(a), model.units(b)) for a, b in pairs]
    alone = [lifted_ransac(a, b, coefficients, threshold, rng) for a, b in units]
    # one more with too few matches, and one where nothing was found
    units += [(units[0][0][:5], units[0][1][:5]), units[0]]
    found = [F for F, _ in alone] + [alone[0][0], None]
    together = lifted_fits(units, coefficients, threshold, found)
    assert together[-2:] == [None, None]
    for (F, near), other, (a, b) in zip(alone, together, pairs):
        apart = model.sampson_distance(F, a, b) - model.sampson_distance(other, a, b)
        assert np.abs(apart[near]).max() < 0.1


@pytest.mark.long
@pytest.mark.parametrize('division', [-0.15, -0.6, -1.2, -2.4])
def test_the_lens_follows_from_matches(division):
    rng = np.random.default_rng(5)
    found = shared_division(images(rng, division, HAND, 0.2)[1], SIZE, rng)
    assert found.division == pytest.approx(division, abs=3.5 * found.sigma)
    assert found.sigma < 0.005 * (1 - division)
    assert not found.model.straight
    # a wrong match next to an epipole has its way
    found = shared_division(images(rng, division, HAND, 0.2, outliers=0.2)[1], SIZE, rng)
    assert found.division == pytest.approx(division, abs=0.005 * (1 - division))


def test_a_pinhole_stays_one():
    rng = np.random.default_rng(6)
    found = shared_division(images(rng, 0.0, HAND, 0.2, outliers=0.2)[1], SIZE, rng)
    assert found.model.straight
    assert abs(found.division) < 4 * found.sigma


def test_nothing_comes_of_nothing():
    rng = np.random.default_rng(7)
    assert shared_division([], SIZE, rng) is None
    assert lifted_ransac(np.zeros((5, 2)), np.zeros((5, 2)), np.zeros(1), 0.01, rng) is None
    still = rng.uniform(-0.5, 0.5, (50, 2))
    # equal images: any F goes, none of them fails
    assert lifted_ransac(still, still, np.array([-1.0]), 0.01, rng) is not None
