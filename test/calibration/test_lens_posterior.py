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
"""What real lenses are like, weighed by what the images know once their errors are known."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import with_fixed
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, fit_robustly, with_all_points
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.lens_selection import lens_priors
from selfcal_ros.calibration.initialisation.problem import observations_of
from selfcal_ros.calibration.uncertainty.lens_posterior import lens_posterior
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.synthetic.few_view_scenes import general_views

SIZE = (640, 480)
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='plumb_bob')


@pytest.fixture(scope='module')
def fit():
    """Fit six views of seventy points, where what lenses are like tells as much as the images."""
    camera = Camera([[520, 0, 328], [0, 520, 235], [0, 0, 1]], (-0.12, 0.05, 0.001, -0.002),
                    *SIZE)
    scene = general_views(np.random.default_rng(4), camera, views=6, points=70, noise_px=0.3)
    observations = observations_of(scene.tracks, scene.tracks.frames)
    first = scene.cam_from_world[0]
    R = scene.cam_from_world[:, :, :3] @ first[:, :3].T
    t = scene.cam_from_world[:, :, 3] - R @ first[:, 3]
    path = AxisPath.of_poses(np.eye(3), np.concatenate([R, t[:, :, None]], axis=2))
    priors = lens_priors(FACTS, SIZE, 520.0)
    state = with_fixed(SceneState(Lens.of(camera), path), priors)
    found = fit_robustly(observations, with_all_points(state, observations), GENERAL, priors, 0.3)
    return replace(found, state=found.bundle.optimise(found.state, 50, 1e-9))


def with_errors(fit, variance):
    """Covariance of the lens when the observations err by more than independent noise."""
    lens = fit.bundle.unknowns.lens
    free = np.flatnonzero(fit.bundle.unknowns.free[lens])
    square = np.ix_(free, free)
    factor = fit.bundle.loss_factors(fit.linearisation)[0]
    C = fit.lens_covariance[square] / factor
    P = fit.bundle.priors.soft_information()[square]
    covariance = np.zeros_like(fit.lens_covariance)
    covariance[square] = factor * (C @ (np.linalg.inv(C) - P) @ C * variance + C @ P @ C)
    return covariance, square, factor


@pytest.mark.parametrize('variance', [3.0, 20.0])
def test_it_is_the_estimate_of_an_adjustment_that_knows_the_errors(fit, variance):
    """Errors whose variance is so many times larger, against lenses weighed up as much."""
    covariance, square, factor = with_errors(fit, variance)
    found = lens_posterior(fit, fit.state, covariance, fit.bundle.residuals(fit.state))

    population = fit.bundle.priors.population
    heavier = replace(fit.bundle.priors, population=replace(
        population, information=variance * factor * population.information))
    bundle = bundle_of(fit.observations, fit.motion, heavier, fit.bundle.sigma_px)
    best = bundle.optimise(fit.state, 100, 1e-9)
    sigma = np.sqrt(np.diag(covariance)[square[0].ravel()])
    moved = (best.lens.values - fit.state.lens.values)[square[0].ravel()] / sigma
    told = (found.state.lens.values - fit.state.lens.values)[square[0].ravel()] / sigma
    assert np.abs(moved).max() > 0.1
    # the adjustment is bent, this is one step
    np.testing.assert_allclose(told, moved, atol=0.1 * np.abs(moved).max())
    expected = variance * factor * bundle.inverse(bundle.normal_equations(best))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)),
                               np.sqrt(np.diag(expected[bundle.unknowns.lens,
                                                        bundle.unknowns.lens])), rtol=0.1)
    # path and points have followed
    after = np.sqrt(np.mean(found.residual**2))
    assert after == pytest.approx(np.sqrt(np.mean(bundle.residuals(best)**2)), rel=0.005)


def test_a_covariance_of_all_weighed_down_alike_tells_as_much(fit):
    """As beside a smooth field: images and lenses count less by one factor."""
    covariance, _, _ = with_errors(fit, 4.0)
    residual = fit.bundle.residuals(fit.state)
    found = lens_posterior(fit, fit.state, covariance, residual)
    alike = lens_posterior(fit, fit.state, 4.0 * fit.lens_covariance, residual, 4.0)

    np.testing.assert_allclose(alike.covariance, found.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(alike.state.lens.values, found.state.lens.values, rtol=1e-9)


def test_the_less_images_know_the_more_a_lens_is_like_others(fit):
    """No coefficient is ever less sure than what is known of it without images."""
    population = fit.bundle.priors.population
    places = fit.state.lens.places(population.names)
    spread = np.sqrt(np.diag(np.linalg.inv(population.information)))
    distance = []
    for variance in (10.0, 100.0, 2000.0):
        covariance, _, _ = with_errors(fit, variance)
        found = lens_posterior(fit, fit.state, covariance, fit.bundle.residuals(fit.state))
        off = found.state.lens.values[places] - population.mean
        distance.append(off @ population.information @ off)
        assert (np.sqrt(np.diag(found.covariance)[places]) < spread).all()

    assert distance[0] > distance[1] > distance[2]


def test_independent_errors_change_nothing(fit):
    covariance, _, _ = with_errors(fit, 1.0)

    assert lens_posterior(fit, fit.state, covariance,
                          fit.bundle.residuals(fit.state)) is None


def test_a_lens_of_which_nothing_is_known_stays(fit):
    covariance, _, _ = with_errors(fit, 9.0)
    without = replace(fit, bundle=fit.bundle.with_priors(
        replace(fit.bundle.priors, population=None)))

    assert lens_posterior(without, fit.state, covariance,
                          fit.bundle.residuals(fit.state)) is None
