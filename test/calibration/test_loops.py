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
from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.bundle.motion import NEARLY_PLANAR, PLANAR
from selfcal_ros.calibration.bundle.plane_of_motion import choose_motion
from selfcal_ros.calibration.bundle.robust_fit import with_all_points
from selfcal_ros.calibration.estimators.model_selection import first_fit
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.estimators.one_motion import OneMotion, with_any_focal
from selfcal_ros.calibration.initialisation.multi_start import starts
from selfcal_ros.calibration.initialisation.problem import WINDOW_VIEWS
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.synthetic.lap_scenes import laps
from selfcal_ros.synthetic.pause_scenes import pauses
from selfcal_ros.synthetic.special_scenes import drive
from selfcal_ros.synthetic.zoomed_scenes import zoomed

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)


# both were refused: starts by a wrong focal length cannot close the loop, and points seen on the
# spot alone were put beside the camera; `bench loops` has a hundred of each
@pytest.mark.long
@pytest.mark.parametrize('drawn, seed', [(laps, 8), (pauses, 15)])
def test_a_drive_that_comes_back_or_pauses_is_calibrated(drawn, seed):
    scene = drawn(np.random.default_rng(seed))
    found = calibrate(scene.tracks, facts=FACTS)

    error = found.camera.parameters[[0, 2, 3]] - scene.camera.parameters[[0, 2, 3]]
    sigma = np.array([found.sigma[name] for name in ('fx', 'cx', 'cy')])
    assert (np.abs(error) < 3 * sigma).all()
    assert sigma[0] < 5e-3 * scene.camera.parameters[0]


def test_a_search_of_few_views_leaves_a_zoom_to_one_of_all():
    """An exception, on a drive that came back: few views took the instants of all for theirs."""
    rng = np.random.default_rng(2)
    scene = drive(rng, 0.3, 14, 200, 8)
    tracks = zoomed(scene, np.linspace(0.9, 1.1, 14), rng).tracks
    graph = build_view_graph(tracks, np.random.default_rng(0))
    problem = replace(problem_of(graph, (640, 480), FACTS), motion=NEARLY_PLANAR)
    found = OneMotion(problem, graph, [scene.camera], None, window_views=6).result()
    assert isinstance(found, NoEstimate) and found.kind == 'focal_not_constant'


@pytest.fixture(scope='module')
def long_drive():
    """Return a drive of more views than searches begin with: scene, graph, problem and fit."""
    scene = drive(np.random.default_rng(2), 0.3, WINDOW_VIEWS + 8, 900, 12)
    graph = build_view_graph(scene.tracks, np.random.default_rng(0))
    problem = replace(problem_of(graph, (640, 480), FACTS), motion=NEARLY_PLANAR)
    (start, _), = starts(problem, iter([scene.camera]))
    fit = first_fit(problem, problem.observations, with_all_points(start, problem.observations))
    return scene, graph, problem, fit


@pytest.mark.long
def test_a_fit_of_all_views_is_no_start_for_some_of_them(long_drive):
    """An exception before: it has a pose for views that the search has not."""
    scene, graph, problem, fit = long_drive
    assert len(fit.state.path) > problem.window().views
    found = with_any_focal(problem, graph, [scene.camera], fit)
    assert abs(found.camera.K[0, 0] - scene.camera.K[0, 0]) < 4 * found.sigma['fx']


def test_a_plane_that_is_exact_already_is_no_matter_of_choice(long_drive):
    """A division by zero before, where the adjustment ended a little higher once more."""
    *_, problem, _ = long_drive
    exact = replace(problem, motion=PLANAR)
    (start, _), = starts(exact, iter([long_drive[0].camera]))
    fit = first_fit(exact, exact.observations, with_all_points(start, exact.observations))
    chosen, is_exact = choose_motion(fit)
    assert is_exact and chosen is fit
