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
"""Which share of the tracks that were given contradicts an optimum."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.robust_fit import Observations, with_all_points
from selfcal_ros.calibration.estimators.acceptance import FEW_AS_WHOLES
from selfcal_ros.calibration.estimators.contradictions import (Contradictions,
                                                               contradictions_of)
from selfcal_ros.calibration.estimators.model_selection import first_fit
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.estimators.zoom_selection import settle_zoom, zooming
from selfcal_ros.calibration.initialisation.multi_start import starts
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.calibration.moving.track_judgement import distances, scene_of
from selfcal_ros.synthetic.special_scenes import drive
from selfcal_ros.synthetic.zoomed_scenes import zoomed

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)
VIEWS = 10


@pytest.fixture(scope='module')
def beside_a_zoom():
    """Fit a zoom without some tracks that miss the last views: fit, graph, and these tracks."""
    rng = np.random.default_rng(3)
    scene = drive(rng, 0.0, VIEWS, 600, 7)
    tracks = zoomed(scene, 1 + 0.03 * np.linspace(-1, 1, VIEWS), rng).tracks
    missing = ((tracks.track % 3 == 0)
               & ~np.isin(tracks.track, tracks.track[tracks.frame >= VIEWS - 2]))
    graph = build_view_graph(tracks, np.random.default_rng(0))
    few = replace(graph, tracks=tracks.select(~missing))
    problem = zooming(problem_of(few, (640, 480), FACTS))
    (start, _), = starts(problem, iter([scene.camera]))
    fit = first_fit(problem, problem.observations, with_all_points(start, problem.observations))
    fit = settle_zoom(fit, FACTS, problem.size)
    assert fit.motion.zoom.is_steady
    return fit, replace(graph, given=tracks), tracks.select(missing).with_at_least(4)


def test_tracks_of_a_zoom_that_miss_the_last_views_are_judged(beside_a_zoom):
    # their views were fewer than the instants of the zoom, which raised an exception
    fit, graph, missing = beside_a_zoom
    assert missing.frame.max() < VIEWS - 2
    assert contradictions_of(fit, graph).share < 0.05

    of_missing = np.isin(graph.given.track, missing.track)
    off_px = np.where(of_missing & (graph.given.frame % 2 == 0), 20.0, 0.0)
    moved = replace(graph.given, xy=graph.given.xy + off_px[:, None])
    assert contradictions_of(fit, replace(graph, given=moved)).share > 0.5 * np.mean(of_missing)


@pytest.mark.parametrize(('gross', 'moving'), [(0.2, 0.0), (0.3, 0.0), (0.02, 0.2), (0.2, 0.2)])
def test_gross_errors_are_told_from_tracks_that_contradict_as_wholes(gross, moving):
    rng = np.random.default_rng([7, int(100 * gross)])
    length = rng.integers(4, 14, 400)
    lost = rng.binomial(length, gross)
    moves = rng.random(len(length)) < moving
    lost[moves] = length[moves]
    found = Contradictions(length, lost)

    assert found.share == pytest.approx(moving + gross * (1 - moving), abs=0.05)
    assert found.share_as_wholes == pytest.approx(moving, abs=0.06)
    assert (found.share_as_wholes < FEW_AS_WHOLES) == (not moving)


def test_tracks_of_which_none_agrees_are_no_gross_errors():
    assert Contradictions(np.array([5, 6]), np.array([5, 6])).share_as_wholes == 1


def test_a_scene_of_tracks_that_miss_the_last_views_has_as_many_views(beside_a_zoom):
    fit, graph, missing = beside_a_zoom
    observations = Observations.of(missing, graph.frames)
    scene, state = scene_of(fit.bundle, fit.state, observations)

    assert len(state.path) == observations.view.max() + 1 < VIEWS
    assert np.median(distances(scene, state)) < 2
