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
"""Ways out of the plane that views in a row share tell less than so many independent ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.motion import NEARLY_PLANAR
from selfcal_ros.calibration.bundle.plane_of_motion import choose_motion
from selfcal_ros.calibration.bundle.robust_fit import with_all_points
from selfcal_ros.calibration.estimators.model_selection import first_fit
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.initialisation.multi_start import starts
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.calibration.uncertainty.uneven_ground import likely_processes, uneven_ground
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.hard_scenes import s_curve, scene, short_tracks
from selfcal_ros.synthetic.scenes import pitched_mount, planar_poses

TILT_DEG, NOISE_PX = 0.5, 0.5
#: Standard deviation of the filter that makes a ground rise slowly, in views.
SLOW = 2.0


def on_rough_ground(seed: int, slow: bool):
    """Fit a drive whose vehicle pitches and rolls; return the fit and the true focal length."""
    rng = np.random.default_rng(seed)
    turns, places = s_curve(20)
    tilt = rng.standard_normal((len(turns), 3)) * [1, 1, 0]
    if slow:
        tilt = gaussian_filter1d(tilt, SLOW, axis=0, mode='wrap')
    tilt *= np.radians(TILT_DEG) / tilt[:, :2].std()
    poses = (pitched_mount(np.radians(20)) @ rotation_matrix(tilt)
             @ planar_poses(np.eye(3), turns, places))
    sequence = scene(rng, poses, noise_px=NOISE_PX, count=150, seen=short_tracks(rng, 6))
    graph = build_view_graph(sequence.tracks, np.random.default_rng(0))
    problem = replace(problem_of(graph, (640, 480), CameraFacts(aspect_ratio=1.0, skew=0.0)),
                      motion=NEARLY_PLANAR)
    (start, _), = starts(problem, iter([sequence.camera]))
    fit = first_fit(problem, problem.observations, with_all_points(start, problem.observations))
    fit, exact = choose_motion(fit)
    assert not exact
    return fit, sequence.camera.parameters[0]


def in_sigmas(seeds, slow: bool) -> np.ndarray:
    """Errors of the focal length in sigmas, without and with what the ground adds."""
    found = []
    for seed in seeds:
        fit, truth = on_rough_ground(seed, slow)
        alone, more = fit.lens_covariance[0, 0], uneven_ground(fit)[0, 0]
        found.append((fit.state.lens['f'] - truth) / np.sqrt([alone, alone + more]))
    return np.array(found)


@pytest.mark.long
def test_sigmas_hold_over_a_ground_that_rises_slowly():
    alone, with_ground = np.sum(in_sigmas(range(100, 110), slow=True)**2, axis=0)
    # of 10 squared errors: chance stays below 23 in 99 of 100
    assert alone > 23 > with_ground


def test_an_uneven_ground_of_independent_views_costs_little():
    alone, with_ground = in_sigmas(range(2), slow=False).T
    assert np.all(np.abs(alone / with_ground) < 1.1)


@pytest.mark.parametrize('length', [0.0, 2.0, 5.0])
def test_how_long_a_process_remembers_is_found(length):
    views, series, rng = 40, 2, np.random.default_rng(3)
    lag = np.abs(np.arange(views) - np.arange(views)[:, None])
    true = np.exp(-0.5 * (lag / length)**2) if length else np.eye(views)
    x = rng.multivariate_normal(np.zeros(views), true, series)
    # the images know every value to 0.3; the estimate has variance 1 beforehand
    told = 1 / 0.3**2
    seen = x + 0.3 * rng.standard_normal(x.shape)
    covariance = np.eye(x.size) / (told + 1)
    found = sum(variance * (np.exp(-0.5 * (lag / size)**power) if size else np.eye(views))
                for variance, size, power in likely_processes(
                    told / (told + 1) * seen, covariance))
    assert found[0, 0] == pytest.approx(1, abs=0.4)
    for apart in (1, 3):
        assert found[0, apart] / found[0, 0] == pytest.approx(true[0, apart], abs=0.2)
