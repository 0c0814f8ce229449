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
"""Covariances of the fixed points and of the closed form's camera: derivatives, and runs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from selfcal_ros.calibration.planar import (circular, conic_pencil as pencil, fixed_points,
                                            pair_means)
from selfcal_ros.calibration.result import FixedPoints
from selfcal_ros.geometry import fundamental, planar_batch, planar_pairs, projective
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.synthetic import scenes, special_scenes

RUNS = 40


@pytest.fixture
def rng():
    return np.random.default_rng(8)


def five(K):
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1]])


def numeric(f, x, step):
    return np.stack([(f(x + step * e) - f(x - step * e)) / (2 * step) for e in np.eye(len(x))],
                    axis=1)


def by_facts(calibrate, facts):
    """Covariance that the sigmas of the facts give, by differences."""
    total = np.zeros((5, 5))
    for name, sigma, step in (('aspect_ratio', facts.aspect_ratio_sigma, 1e-6),
                              ('skew', facts.skew_sigma_px, 1e-3),
                              ('principal_point', facts.principal_point_sigma_px, 1e-3)):
        value = getattr(facts, name)
        if value is None or not sigma:
            continue
        value = np.atleast_1d(value)

        def moved(x):
            given = float(x[0]) if len(x) == 1 else tuple(x)
            return five(calibrate(replace(facts, **{name: given})).K)
        slope = numeric(moved, value, step) * sigma
        total += slope @ slope.T
    return total


def equal(a, b, rel):
    # what is held has a sigma of zero: compare in thousandths of a pixel
    scale = np.sqrt(np.maximum(np.diag(b), 1e-6))
    return np.abs((a - b) / np.outer(scale, scale)).max() < rel


@pytest.mark.parametrize('facts, rel', [
    (CameraFacts(aspect_ratio=1.1), 1e-3), (CameraFacts(skew=5.0), 1e-3),
    (CameraFacts(aspect_ratio=1.1, aspect_ratio_sigma=0.01), 1e-3),
    # what the facts disagree by is of second order
    (CameraFacts(principal_point=(400, 300), principal_point_sigma_px=8), 0.05),
    (CameraFacts(aspect_ratio=1.1, skew=5.0, principal_point=(400, 300)), 0.05)])
def test_covariance_of_the_pencil_is_the_numeric_one(rng, facts, rel):
    sequence = scenes.sequence_si(rng, 0.05, aspect_ratio=1.1, skew=5.0)
    found = fixed_points.fixed_points(sequence.tracks)
    covariance = found.covariance[3:12, 3:12]

    def camera(x, given=facts):
        i = x[3:6] + 1j * x[6:]
        return pencil.calibrate_from_fixed_points(
            FixedPoints(np.cross(i.real, i.imag), x[:3], i), given)
    i = found.fixed.circular_point
    x = np.r_[found.fixed.vanishing_point, i.real, i.imag]
    slope = numeric(lambda y: five(camera(y).K), x, 1e-8)
    expected = slope @ covariance @ slope.T + by_facts(lambda given: camera(x, given), facts)
    assert equal(fixed_points.calibrate_estimate(found, facts).covariance, expected, rel)


@pytest.mark.parametrize('facts', [
    CameraFacts(aspect_ratio=1.0, skew=0.0),
    CameraFacts(aspect_ratio=1.0, skew=0.0, aspect_ratio_sigma=0.01, skew_sigma_px=3.0),
    CameraFacts(aspect_ratio=1.0, skew=0.0, principal_point=(400, 300),
                principal_point_sigma_px=5.0)])
def test_covariance_of_the_circular_camera_is_the_numeric_one(rng, facts):
    found = fixed_points.fixed_points(special_scenes.circular_motion(rng, 0.05, 6,
                                                                     aside=0.5).tracks)
    assert found.motion == 'circular'

    def camera(x, given=facts):
        return circular.calibrate_circular(x[:3] + 1j * x[3:6], x[6:], given)
    i = found.fixed.circular_point
    x = np.r_[i.real, i.imag, found.screw_axis]
    slope = numeric(lambda y: five(camera(y).K), x, 1e-8)
    expected = (slope @ found.covariance[6:, 6:] @ slope.T
                + by_facts(lambda given: camera(x, given), facts))
    assert equal(fixed_points.calibrate_estimate(found, facts).covariance, expected, 1e-3)


def share(distances, size, level=0.9):
    return np.mean(np.array(distances) < chi2.ppf(level, size))


def test_circular_point_lies_in_its_ellipsoid(rng):
    distances = []
    for _ in range(RUNS):
        sequence = scenes.sequence_si(rng, 0.2)
        found = fixed_points.fixed_points(sequence.tracks)
        i = found.fixed.circular_point
        truth = min((sequence.circular_point, sequence.circular_point.conj()),
                    key=lambda x: np.abs(np.cross(projective.unit(x), i)).max())
        away = truth / (i.conj() @ truth) - i
        away = np.r_[away.real, away.imag]
        covariance = found.covariance[6:12, 6:12]
        scale = np.sqrt(np.diag(covariance))
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        # four of six: neither along i nor along its phase
        assert values[1] < 1e-6 * values[2]
        distances.append((((vectors[:, 2:].T @ (away / scale)) ** 2) / values[2:]).sum())
    assert 0.77 < share(distances, 4) < 0.99
    assert np.mean(distances) / 4 == pytest.approx(1, abs=0.4)


@pytest.mark.long
def test_circular_camera_lies_in_its_ellipsoid(rng):
    facts, rows = CameraFacts(aspect_ratio=1.0, skew=0.0), [0, 2, 3]
    distances = []
    for _ in range(RUNS):
        sequence = special_scenes.circular_motion(rng, 0.05, 6, aside=0.5)
        found = fixed_points.fixed_points(sequence.tracks)
        camera = fixed_points.calibrate_estimate(found, facts)
        away = five(camera.K - sequence.camera.K)[rows]
        distances.append(away @ np.linalg.solve(camera.covariance[np.ix_(rows, rows)], away))
    assert 0.77 < share(distances, 3) < 0.99


def test_pairs_help_each_other_out_of_wrong_minima():
    settled = 0
    for seed in (5032, 5131, 5139, 5165, 5166, 5191, 5206, 5216, 5264):
        xy = np.moveaxis(scenes.sequence_si(np.random.default_rng(seed), 1.0).tracks.xy.reshape(
            50, 3, 2), 1, 0)
        data = fundamental.PairMatches.from_pixels([(xy[a], xy[b]) for a, b in
                                                    ((0, 1), (0, 2), (1, 2))])
        F, cost, _, _ = fundamental.refine_general(data, fundamental.eight_point(data))
        alone = planar_pairs.refine_planar(data, F)[1]
        F, cost, state, together = pair_means.agreed_pairs(data, F, cost)
        batch = planar_batch.refine_batch(data, *planar_batch.batch_start(state))[3]
        assert (cost <= together * (1 + 1e-6)).all()
        assert (together <= alone * (1 + 1e-6)).all()
        settled += together.sum() < 0.9 * alone.sum()
        assert batch.sum() < 1.5 * together.sum()
    assert settled >= 6
