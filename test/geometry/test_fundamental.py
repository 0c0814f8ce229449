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
"""Fundamental matrices: exact without noise, right derivatives, honest spreads."""

import numpy as np
import pytest
from selfcal_ros.geometry import (epipolar_distance, fundamental, planar_batch, planar_pairs,
                                  projective, ransac)
from selfcal_ros.synthetic import scenes, special_scenes

PAIRS = ((0, 1), (1, 2), (0, 2))


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def views_of(sequence):
    return np.moveaxis(sequence.tracks.xy.reshape(len(sequence.points), -1, 2), 1, 0)


def pairs_of(sequence):
    xy = views_of(sequence)
    return fundamental.PairMatches.from_pixels([(xy[a], xy[b]) for a, b in PAIRS])


def true_F(sequence, a, b):
    K, poses = sequence.camera.K, sequence.cam_from_world
    R = poses[b, :, :3] @ poses[a, :, :3].T
    t = poses[b, :, 3] - R @ poses[a, :, 3]
    F = np.linalg.inv(K).T @ projective.cross_matrix(t) @ R @ np.linalg.inv(K)
    return F / np.linalg.norm(F)


def numeric(f, size, step=1e-6):
    sides = [(f(step * e), f(-step * e)) for e in np.eye(size)]
    return np.stack([(p - m) / (2 * step) for p, m in sides], axis=-1)


def equal_up_to_sign(a, b, tolerance):
    return min(np.abs(a - b).max(), np.abs(a + b).max()) < tolerance


def test_exact_without_noise(rng):
    sequence = scenes.sequence_si(rng, 0.0, aspect_ratio=1.1, skew=5.0)
    xy = views_of(sequence)
    F = true_F(sequence, 0, 1)
    for found in (fundamental.fundamental(xy[0], xy[1]),
                  planar_pairs.planar_fundamental(xy[0], xy[1])):
        assert equal_up_to_sign(found.F, F, 1e-11)
        assert found.rms_px < 1e-9
        assert abs(np.linalg.det(found.F)) < 1e-20


def test_translation_is_exact_without_noise_and_two_parameters_suffice(rng):
    xy = views_of(special_scenes.pure_translation(rng, 0.0))
    found = fundamental.fundamental(xy[0], xy[1], 'translation')
    assert found.F == pytest.approx(-found.F.T)
    assert found.rms_px < 1e-9 and found.degrees_of_freedom == 2


def test_residuals_are_distances_to_epipolar_lines(rng):
    xy = views_of(scenes.sequence_si(rng, 1.0))
    found = fundamental.fundamental(xy[0], xy[1])
    line = projective.homogeneous(xy[0]) @ found.F.T
    distance = (line * projective.homogeneous(xy[1])).sum(1) / np.hypot(line[:, 0], line[:, 1])
    assert np.abs(found.residuals[:, 0]) == pytest.approx(np.abs(distance))
    again = epipolar_distance.epipolar_residuals(found.F, xy[0], xy[1])
    assert np.abs(again) == pytest.approx(np.abs(found.residuals))


def test_residual_slopes_are_the_numeric_ones(rng):
    data = pairs_of(scenes.sequence_si(rng, 1.0))
    F = rng.normal(size=(3, 3, 3))
    _, slope = fundamental.pair_residuals(data, F, derivative=True)
    expected = numeric(lambda d: fundamental.pair_residuals(data, F + d.reshape(3, 3)), 9)
    assert slope == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


def test_model_slopes_are_the_numeric_ones(rng):
    frames = np.linalg.qr(rng.normal(size=(4, 3, 3)))[0]
    frames *= np.linalg.det(frames)[:, None, None]
    angle = rng.normal(size=2)
    cases = [
        ((frames[:2], angle, frames[2:]), fundamental.general_model, fundamental.general_step,
         7),
        ((frames[:2],), fundamental._translation_model, fundamental._translation_step, 2),
        ((angle, frames[:2], frames[2:]), planar_pairs._planar_model, planar_pairs._planar_step,
         6)]
    for state, model, step, size in cases:
        expected = numeric(
            lambda d: model(step(state, np.tile(d, (2, 1))))[0].reshape(2, 9), size)
        assert model(state)[1] == pytest.approx(expected, abs=1e-8)


def test_batch_slopes_are_the_numeric_ones(rng):
    L, V = (projective.completed_frame(projective.unit(rng.normal(size=3))) for _ in range(2))
    own = rng.normal(size=(4, 3))
    _, common, single = planar_batch._batch_model(L, V, own)

    def moved(d):
        return planar_batch._batch_model(planar_batch._turned(L, d[:2]),
                                         planar_batch._turned(V, d[2:]), own)[0].reshape(4, 9)
    assert common == pytest.approx(numeric(moved, 4), abs=1e-8)
    expected = numeric(
        lambda d: planar_batch._batch_model(L, V, own + d)[0].reshape(4, 9), 3)
    assert single == pytest.approx(expected, abs=1e-8)


def test_decomposition_finds_horizon_and_axis(rng):
    sequence = scenes.sequence_si(rng, 0.0)
    F = np.array([true_F(sequence, a, b) for a, b in PAIRS])
    T = projective.normalising_transform(sequence.tracks.xy)
    back = np.linalg.inv(T)
    line, axis, _, _, real = planar_pairs.decompose_planar(back.T @ F @ back)
    assert real.all()
    for found in line @ T:
        assert np.abs(np.cross(projective.unit(found), sequence.horizon)).max() < 1e-9
    assert np.abs(axis @ T @ sequence.vanishing_point).max() < 1e-9


def batch(sequence):
    data = pairs_of(sequence)
    F = fundamental.refine_general(data, fundamental.eight_point(data))[0]
    state, cost, _ = planar_pairs.refine_planar(data, F)
    start = planar_batch.batch_start(state)
    return (data, *planar_batch.refine_batch(data, *start), cost)


def test_batch_is_exact_without_noise_and_stationary_with_it(rng):
    sequence = scenes.sequence_si(rng, 0.0)
    data, L, V, own, cost, _, _ = batch(sequence)
    result = planar_batch.result_in_pixels(data, L, V, own, cost, np.zeros((4, 4)), 1.0)
    assert equal_up_to_sign(result.horizon, sequence.horizon, 1e-9)
    assert equal_up_to_sign(result.vanishing_point, sequence.vanishing_point, 1e-9)
    data, L, V, own, cost, _, separate = batch(scenes.sequence_si(rng, 0.3))
    assert cost.sum() >= separate.sum() * (1 - 1e-6)

    def total(d):
        F = planar_batch._batch_model(planar_batch._turned(L, d[:2]),
                                      planar_batch._turned(V, d[2:4]),
                                      own + d[4:].reshape(3, 3))[0]
        return np.array([fundamental.normal_equations(data, F)[0].sum()])
    F, common, single = planar_batch._batch_model(L, V, own)
    matrix = fundamental.normal_equations(data, F)[2]
    blocks = planar_batch._arrow(matrix, np.zeros((3, 9)), common, single)
    curvature = np.concatenate([np.diag(blocks[0]), np.einsum('nii->ni', blocks[2]).ravel()])
    gradient = numeric(total, 13)[0]
    # in units in which a step of one costs as much as the whole
    assert np.abs(gradient / np.sqrt(curvature * cost.sum())).max() < 1e-2


def test_arrow_solution_is_the_dense_one(rng):
    data, L, V, own, _, _, _ = batch(scenes.sequence_si(rng, 0.5))
    F, common, single = planar_batch._batch_model(L, V, own)
    _, gradient, matrix = fundamental.normal_equations(data, F)
    gradient = gradient + rng.normal(size=gradient.shape)
    A, B, D, a, d = planar_batch._arrow(matrix, gradient, common, single)
    dense = np.zeros((13, 13))
    dense[:4, :4] = A
    for k in range(3):
        rows = slice(4 + 3 * k, 7 + 3 * k)
        dense[:4, rows], dense[rows, :4], dense[rows, rows] = B[k], B[k].T, D[k]
    expected = -np.linalg.solve(dense, np.concatenate([a, d.ravel()]))
    step, own_step = planar_batch._solve_arrow(A, B, D, a, d, 0.0)
    assert step == pytest.approx(expected[:4], rel=1e-5)
    assert own_step.ravel() == pytest.approx(expected[4:], rel=1e-5)


def test_stated_covariance_of_F_is_the_observed_one(rng):
    sequence = scenes.sequence_si(rng, 0.0)
    clean = views_of(sequence)[:2]
    reference = fundamental.fundamental(*clean).F.ravel()
    found, stated = [], []
    for _ in range(150):
        estimate = fundamental.fundamental(*(clean + 0.1 * rng.standard_normal(clean.shape)))
        F = estimate.F.ravel()
        found.append(F * np.sign(F @ reference))
        stated.append(estimate.covariance)
    ratio = np.std(found, axis=0) / np.sqrt(np.mean(np.diagonal(stated, axis1=1, axis2=2), 0))
    assert (np.abs(ratio - 1) < 0.2).all()


def test_too_few_matches_are_refused(rng):
    xy = rng.normal(size=(2, 7, 2))
    for refused in (fundamental.fundamental(*xy), planar_pairs.planar_fundamental(*xy),
                    ransac.ransac_fundamental(*xy, rng),
                    fundamental.fundamental(*xy[:, :2], 'translation')):
        assert not refused and refused.kind == 'too_few' and refused.reason


def test_seven_points_contain_the_truth(rng):
    sequence = scenes.sequence_si(rng, 0.0)
    data = pairs_of(sequence)
    chosen = np.array([0, 7, 13, 22, 29, 38, 44])
    F = ransac.seven_point(data.first[:1, chosen], data.second[:1, chosen])[0]
    F = data.pixels_F(F[np.isfinite(F).all(axis=(1, 2))])
    assert any(equal_up_to_sign(f, true_F(sequence, 0, 1), 1e-7) for f in F)


@pytest.mark.parametrize('share', [0.1, 0.25])
def test_ransac_finds_the_outliers(rng, share):
    dirty = special_scenes.with_outliers(scenes.sequence_si(rng, 0.1), rng, share)
    xy = views_of(dirty)
    bad = dirty.outliers.reshape(50, -1)[:, :2].any(axis=1)
    found = ransac.ransac_fundamental(xy[0], xy[1], rng)
    assert (found.inliers & bad).sum() <= 1
    assert (found.inliers | bad).all()
