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
"""First-order covariances of F, its lines, tensors and their cameras: what is stated is seen."""

import numpy as np
import pytest
from scipy.stats import chi2
from selfcal_ros.geometry import (fundamental, planar_pairs, projective, propagation,
                                  tensor_cameras, trifocal)
from selfcal_ros.synthetic import scenes, special_scenes
from test_support.image_maps import tensor_from_cameras

RUNS = 120


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def views_of(sequence):
    return np.moveaxis(sequence.tracks.xy.reshape(len(sequence.points), -1, 2), 1, 0)


def mean_square(estimates, covariances, truth, rank):
    """Mean squared distance of the truth in sigmas, over its expectation."""
    distance = []
    for x, covariance in zip(estimates, covariances):
        scale = np.sqrt(np.diag(covariance))
        # entries that cannot move have rounding only
        scale = np.maximum(scale, 1e-9 * scale.max())
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        assert values[-rank] > 1e-9 * values[-1] and (
            rank == len(x) or values[-rank - 1] < 1e-7 * values[-rank])
        flat = vectors[:, -rank:].T @ ((x - truth) / scale)
        distance.append((flat ** 2 / values[-rank:]).sum())
    inside = np.mean(np.array(distance) < chi2.ppf(0.9, rank))
    assert 0.8 < inside < 0.97
    return np.mean(distance) / rank


def signed(x, truth):
    return x * np.sign(x.ravel() @ truth.ravel())


def holds(ratio, rank, runs=RUNS):
    # four standard deviations of a mean of chi-squares, and a few percent of second order
    return abs(ratio - 1) < 4 * np.sqrt(2 / rank / runs) + 0.05


@pytest.mark.parametrize('form, rank', [('general', 7), ('planar', 6), ('translation', 2)])
def test_covariance_of_F_in_every_form(rng, form, rank):
    translated = form == 'translation'
    sequence = (special_scenes.pure_translation if translated else scenes.sequence_si)(rng, 0.0)

    def estimate(xy):
        return (planar_pairs.planar_fundamental(*xy) if form == 'planar'
                else fundamental.fundamental(*xy, form))
    clean = views_of(sequence)[:2]
    truth = estimate(clean).F
    found = [estimate(clean + 0.1 * rng.standard_normal(clean.shape)) for _ in range(RUNS)]
    ratio = mean_square([signed(one.F, truth).ravel() for one in found],
                        [one.covariance for one in found], truth.ravel(), rank)
    assert holds(ratio, rank)
    assert np.mean([one.noise_px ** 2 for one in found]) == pytest.approx(0.01, rel=0.1)


def test_covariances_of_the_lines_of_a_pair(rng):
    sequence = scenes.sequence_si(rng, 0.0)
    clean = views_of(sequence)[:2]

    def estimate(xy):
        data = fundamental.PairMatches.from_pixels([xy], projective.normalising_transform(
            np.vstack(clean)))
        F = fundamental.refine_general(data, fundamental.eight_point(data))[0]
        state, cost, _ = planar_pairs.refine_planar(data, F)
        return planar_pairs.pair_lines(data, state, cost)
    truth = estimate(clean)
    found = [estimate(clean + 0.1 * rng.standard_normal(clean.shape)) for _ in range(RUNS)]
    for k, name in enumerate(('horizons', 'axes')):
        true = getattr(truth, name)[0]
        ratio = mean_square([signed(getattr(one, name)[0], true) for one in found],
                            [one.covariances[k][0] for one in found], true, 2)
        assert holds(ratio, 2)


def test_pairs_that_share_a_view_share_its_noise(rng):
    moved = rng.normal(size=(6, 2, 3))
    identity = np.array([0, 1, 1, 3, -1, 0])
    total = propagation.add_up(identity, moved, 4)
    assert total[0] == pytest.approx(moved[0] + moved[5])
    assert total[1] == pytest.approx(moved[1] + moved[2])
    assert not total[2].any() and total[3] == pytest.approx(moved[3])
    flat = total.reshape(-1, 3)
    assert propagation.spread(total) == pytest.approx(flat.T @ flat)


def test_slopes_of_the_canonical_transform_are_the_numeric_ones(rng):
    x = rng.normal(size=6)
    step = 1e-6
    numeric = np.stack([(projective.canonical_transform(*np.split(x + step * e, 2))
                         - projective.canonical_transform(*np.split(x - step * e, 2)))
                        / (2 * step) for e in np.eye(6)], axis=-1)
    assert projective.canonical_slopes(x[:3], x[3:]) == pytest.approx(numeric, abs=1e-6)


def test_slopes_of_the_point_equations_are_the_numeric_ones(rng):
    points, T = rng.normal(size=(3, 5, 2)), rng.normal(size=(3, 3, 3))
    slopes = trifocal.equation_slopes(T, *points)
    for view, coordinate in np.ndindex(3, 2):
        step = np.zeros_like(points)
        step[view, :, coordinate] = 1e-6
        sides = [np.einsum('meijk,ijk->me', trifocal.point_equations(*(points + s)), T)
                 for s in (step, -step)]
        assert slopes[:, :, view, coordinate] == pytest.approx((sides[0] - sides[1]) / 2e-6,
                                                               abs=1e-7)


def test_covariance_of_the_general_tensor(rng):
    clean = views_of(special_scenes.general_motion(rng, 0.0))
    truth = trifocal.linear_tensor_estimate(*clean)[0].ravel()
    found = [trifocal.linear_tensor_estimate(*(clean + 0.05 * rng.standard_normal(clean.shape)))
             for _ in range(RUNS)]
    scale = np.sqrt(np.mean([np.diag(one[1]) for one in found], axis=0))
    spread = np.std([signed(one[0].ravel(), truth) for one in found], axis=0)
    assert np.abs(spread / scale - 1).max() < 0.3
    assert np.mean([one[2] for one in found]) == pytest.approx(0.05, rel=0.1)


def canonical(sequence, pixels):
    """Views in the canonical frame, and their derivative by pixels."""
    H = projective.canonical_transform(sequence.horizon, sequence.vanishing_point)
    flat = projective.homogeneous(pixels) @ H.T
    xy = flat[..., :2] / flat[..., 2:]
    return xy, (H[:2, :2] - xy[..., None] * H[2, :2]) / flat[..., 2:, None]


def test_covariances_of_circular_points_and_of_tensor_cameras(rng):
    sequence = scenes.sequence_si(rng, 0.0)
    clean = views_of(sequence)
    xy, _ = canonical(sequence, clean)
    truth = trifocal.circular_points(*xy)
    scaling = trifocal.canonical_scaling(np.vstack(xy))
    scale, shift = np.diag(scaling)[:2], scaling[:2, 2]
    true_tensor = trifocal.reduced_tensor(*(xy * scale + shift))
    true_cameras = np.array(tensor_cameras.planar_cameras(true_tensor.T))
    circular, reduced = [], []
    for _ in range(RUNS):
        xy, spreads = canonical(sequence, clean + 0.1 * rng.standard_normal(clean.shape))
        circular.append(trifocal.circular_points(*xy, spreads))
        reduced.append(trifocal.reduced_tensor(*(xy * scale + shift), scale[:, None] * spreads))
    ratio = mean_square([[one.kappa.real, one.kappa.imag] for one in circular],
                        [one.covariance for one in circular],
                        np.array([truth.kappa.real, truth.kappa.imag]), 2)
    assert holds(ratio, 2)
    assert np.mean([one.noise_px for one in circular]) == pytest.approx(0.1, rel=0.05)
    cameras, covariances = [], []
    for one in reduced:
        T = signed(one.T, true_tensor.T)
        slopes = tensor_cameras.planar_camera_slopes(T).reshape(24, 12)
        cameras.append(np.array(tensor_cameras.planar_cameras(T)).ravel())
        covariances.append(slopes @ one.covariance @ slopes.T)
    ratio = np.std(cameras, axis=0) / np.sqrt(np.maximum(np.mean(
        [np.diag(c) for c in covariances], axis=0), 1e-30))
    free = np.std(cameras, axis=0) > 1e-12 * np.abs(true_cameras).max()
    assert free.sum() == 12
    assert np.abs(ratio[free] - 1).max() < 0.3
    assert not np.diag(covariances[0])[~free].any()


def test_slopes_of_tensor_cameras_are_the_numeric_ones(rng):
    second, third = np.zeros((2, 3, 4))
    for camera in (second, third):
        camera[np.ix_([0, 2], [0, 2, 3])] = rng.normal(size=(2, 3))
        camera[1, 1] = 1
    T = tensor_from_cameras(second, third)
    slopes = tensor_cameras.planar_camera_slopes(T)
    for n, element in enumerate(trifocal.PLANAR_ELEMENTS):
        step = np.zeros((3, 3, 3))
        step[tuple(element)] = 1e-6
        sides = [np.array(tensor_cameras.planar_cameras(T + s)) for s in (step, -step)]
        assert slopes[..., n] == pytest.approx((sides[0] - sides[1]) / 2e-6, abs=1e-6)
