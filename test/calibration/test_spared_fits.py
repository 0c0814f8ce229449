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
"""Fits that cannot change a decision are not made: by what is known before them."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle import plane_of_motion
from selfcal_ros.calibration.bundle.motion import NEARLY_PLANAR
from selfcal_ros.calibration.bundle.robust_fit import with_all_points
from selfcal_ros.calibration.estimators.model_selection import as_uneven_as_told, first_fit
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.initialisation import multi_start
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.hard_scenes import s_curve, scene, short_tracks
from selfcal_ros.synthetic.scenes import pitched_mount, planar_poses

NOISE_PX, TILT_DEG = 0.1, 1.0


def drive_over(tilt_deg):
    """Return the camera of a drive over ground that tilts every view so much, and the problem."""
    rng = np.random.default_rng(3)
    turns, places = s_curve(20)
    tilt = np.radians(tilt_deg) * rng.standard_normal((len(turns), 3)) * [1, 1, 0]
    poses = (pitched_mount(np.radians(20)) @ rotation_matrix(tilt)
             @ planar_poses(np.eye(3), turns, places))
    drawn = scene(rng, poses, noise_px=NOISE_PX, count=150, seen=short_tracks(rng, 6))
    graph = build_view_graph(drawn.tracks, np.random.default_rng(0))
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0)
    return drawn.camera, replace(problem_of(graph, (640, 480), facts), motion=NEARLY_PLANAR,
                                 supposes_plane=True)


@pytest.fixture(scope='module')
def uneven():
    """A drive over ground that tilts every view by a degree: its camera, and the problem."""
    return drive_over(TILT_DEG)


@pytest.fixture(scope='module')
def fitted(uneven):
    """Fit that drive, as uneven as it is."""
    camera, problem = uneven
    (start, _), = multi_start.starts(problem, iter([camera]))
    fit = first_fit(problem, problem.observations, with_all_points(start, problem.observations))
    return as_uneven_as_told(fit, problem.observations)


def counting(monkeypatch, module, name):
    """Count the calls of a function, which does what it does."""
    function, calls = getattr(module, name), []

    def counted(*arguments):
        calls.append(arguments)
        return function(*arguments)

    monkeypatch.setattr(module, name, counted)
    return calls


def test_free_motion_that_explains_the_images_ends_the_sweep(uneven, monkeypatch):
    camera, problem = uneven
    # pairs of views may absorb errors that no path does
    problem = replace(problem, noise_px=problem.noise_px / 1.3)
    tried = counting(monkeypatch, multi_start, 'supposed_camera')
    start, noise_px = multi_start.best_start(problem, [])

    # what the plane leaves would have called for all focal lengths
    assert noise_px > multi_start.GOOD_ENOUGH * problem.noise_px
    assert abs(start.lens['f'] / camera.K[0, 0] - 1) < multi_start.ALIKE
    # once in the plane, once freely
    assert len(tried) == 2


def test_a_plane_that_is_hopeless_is_not_fitted(fitted, monkeypatch):
    refits = counting(monkeypatch, plane_of_motion, 'refit')
    _, is_exact = plane_of_motion.choose_motion(fitted)
    assert not is_exact and all(motion.tilt_sigma_rad > 0 for _, motion, *_ in refits)


@pytest.mark.parametrize('tilt_deg', [0.0, 0.02])
def test_what_a_plane_costs_is_known_before_it_is_fitted(tilt_deg):
    camera, problem = drive_over(tilt_deg)
    (start, _), = multi_start.starts(problem, iter([camera]))
    fit = first_fit(problem, problem.observations, with_all_points(start, problem.observations))
    flat = replace(fit.state, path=fit.state.path.flat())
    exact = plane_of_motion.refit(fit, plane_of_motion.PLANAR, flat)

    supposed = plane_of_motion._supposed_excess(fit)
    np.testing.assert_allclose(2 * (exact.cost - fit.cost), supposed, rtol=0.2)
