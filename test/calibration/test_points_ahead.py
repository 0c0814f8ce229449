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
"""That points lie before the camera is a measurement: of the lens, where images leave it open."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from selfcal_ros import Camera
from selfcal_ros.calibration.bundle.depths import share_behind
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import PIVOT
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import Prior, Priors
from selfcal_ros.calibration.bundle.robust_fit import fit_robustly, Observations
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.uncertainty.lens_posterior import moved_lens
from selfcal_ros.calibration.uncertainty.points_ahead import _depths, _summed_up, points_ahead
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.hard_scenes import scene

TRUTH = Camera([[520, 0, 328], [0, 520, 235], [0, 0, 1]], width=640, height=480)


def _of_head(seed, lever, depth_m=(2.0, 6.0), views=10, count=120, noise_px=0.2):
    """Return the truth of a head with a lever, as an adjustment of its observations."""
    rng = np.random.default_rng([seed, 43])
    turns = np.radians(12) * np.sin(
        np.linspace(0, 6, views)[:, None] * [1, 2, 3] + rng.uniform(0, 6, 3))
    R = rotation_matrix(turns)
    poses = np.concatenate([R, np.tile(lever, (views, 1))[:, :, None]], axis=2)
    seen = scene(rng, poses, count=count, depth_m=depth_m, camera=TRUTH, noise_px=noise_px)
    tracks = seen.tracks.with_at_least(2)
    observed = Observations.of(tracks, np.arange(views))
    points = np.column_stack([seen.points[observed.track], np.ones(len(observed.track))])
    path = replace(AxisPath.of_turns(R), translation=poses[:, :, 3])
    state = SceneState(Lens.of(TRUTH), path,
                       points / np.linalg.norm(points, axis=1, keepdims=True))
    held = {name: Prior(state.lens[name], 0.0) for name in ('aspect', 'skew', 'p1', 'p2')}
    held['k3'] = Prior(0.0, 0.05)
    return observed, state, Priors(held)


def _fit(seed, lever, **how):
    observed, state, priors = _of_head(seed, lever, **how)
    return fit_robustly(observed, state, PIVOT, priors, 0.2)


@pytest.mark.parametrize('wall', [-1.5, 0.0, 1.0])
def test_a_wall_cuts_a_gaussian_as_the_truncated_normal_says(wall):
    # points that all pass through infinity at once, and sharply, as seen from both sides of it
    mean, sigma = _summed_up(np.full(300, 1000.0 * wall), np.full(300, -1000.0))

    inside = norm.cdf(wall)
    # beyond infinity lies the mirror image, which counts as much
    assert mean == pytest.approx(0, abs=0.01) and sigma == pytest.approx(1, abs=0.01)
    half = np.r_[np.full(150, 1000.0 * wall), np.full(150, 1000.0 * (wall + 20))]
    mean, sigma = _summed_up(half, np.full(300, -1000.0))
    expected = -norm.pdf(wall) / inside
    assert mean == pytest.approx(expected, abs=0.02)
    assert sigma**2 == pytest.approx(1 + wall * expected - expected**2, abs=0.02)


def test_points_far_before_the_camera_tell_nothing():
    mean, sigma = _summed_up(np.full(50, 30.0), np.linspace(-2, 2, 50))

    assert abs(mean) < 1e-6 and abs(sigma - 1) < 1e-6


def test_tracks_that_stand_for_no_point_do_not_decide():
    rng = np.random.default_rng(3)
    value, slope = np.full(300, 40.0), np.full(300, -3.0)
    astray = rng.choice(300, 9, replace=False)
    value[astray] = -rng.uniform(20, 50, 9)
    mean, sigma = _summed_up(value, slope)

    assert abs(mean) < 0.1 and abs(sigma - 1) < 0.1


def _displaced(fit, step):
    """Move the lens of an optimum by a step (k,), path and points following."""
    state, residual = moved_lens(fit, fit.state, step, fit.bundle.residuals(fit.state))
    return state, residual


def test_depths_follow_the_lens_as_adjustments_with_other_lenses_say():
    fit = _fit(1, (0.0, 0.03, 0.1), noise_px=0.02)
    lens = fit.bundle.unknowns.lens
    free = np.flatnonzero(fit.bundle.unknowns.free[lens])
    covariance = fit.covariance[lens, lens]
    step = 0.05 * covariance[:, 0] / np.sqrt(covariance[0, 0])
    depths = _depths(fit, free)
    ends = [_displaced(fit, sign * step)[0] for sign in (1, -1)]
    # the scale of the world is held by nothing: by the lever here
    after, before = (np.linalg.norm(one.path.translation[0]) * one.points[:, 3]
                     / np.linalg.norm(one.points[:, :3], axis=1) for one in ends)
    here = (after + before) / 2
    # over the sigma of each, which the displacement hardly changes
    expected = (after - before) / here * depths.value
    followed = 2 * depths.by_lens @ step[free]
    near = depths.value > 5
    assert near.sum() > 60
    assert np.corrcoef(expected[near], followed[near])[0, 1] > 0.98
    assert np.median(followed[near] / expected[near]) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize('seed', range(3))
def test_an_estimate_beyond_infinity_comes_back_to_where_points_can_be(seed):
    fit = _fit(seed, (0.0, -0.024, -0.08), depth_m=(1.5, 20.0))
    lens = fit.bundle.unknowns.lens
    covariance = fit.covariance[lens, lens]
    sigma = float(np.sqrt(covariance[0, 0]))
    # what the images could have said by chance: far points are beyond infinity there
    beyond, residual = _displaced(fit, 2 * covariance[:, 0] / sigma)
    behind = share_behind(replace(fit, state=beyond))
    at, share = points_ahead(fit, beyond, covariance, residual)

    assert behind > 0.05 and at is not None and share < 0.01
    known = float(np.sqrt(at.covariance[0, 0]))
    assert at.state.lens['f'] < beyond.lens['f'] - sigma and known < sigma
    assert abs(at.state.lens['f'] - 520) < 3 * known
    assert np.linalg.norm(at.residual, axis=1).mean() < 1.1 * np.linalg.norm(
        residual, axis=1).mean()
