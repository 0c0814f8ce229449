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
"""One step from the optimum without a stretch of views is the estimate without it."""

from dataclasses import replace

import numpy as np
import pytest

from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.information import inverse_information
from selfcal_ros.calibration.bundle.motion import PLANAR
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, refit, with_all_points
from selfcal_ros.calibration.estimators.model_selection import choose_model, first_fit
from selfcal_ros.calibration.initialisation.multi_start import best_start
from selfcal_ros.calibration.initialisation.problem import observations_of, SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.calibration.uncertainty.group_jackknife import delete_a_group, SEGMENTS
from selfcal_ros.geometry.selection_matrix import selection_matrix
from selfcal_ros.synthetic.hard_scenes import HARD_SCENES


def fit_of(name):
    """Fit a scene, distortion chosen, exactly planar."""
    sequence = HARD_SCENES[name](np.random.default_rng([0, 5]))
    graph = build_view_graph(sequence.tracks, np.random.default_rng(0))
    problem = SelfCalibrationProblem(observations_of(graph.tracks, graph.frames), graph.pairs,
                                     sequence.tracks.image_size, CameraFacts(1.0, 0.0),
                                     graph.noise_px)
    start, _ = best_start(problem, [])
    fit = first_fit(problem, problem.observations, with_all_points(start, problem.observations))
    fit = choose_model(problem, fit, 1.0).fit
    return refit(fit, PLANAR)


def optimised_without(fit, stretch):
    """Estimate anew, with iterations, without a stretch."""
    views = len(fit.state.path)
    of_view = np.arange(views) * SEGMENTS // views
    rest, points = fit.observations.select(of_view[fit.observations.view] != stretch)
    kept, view = np.unique(rest.view, return_inverse=True)
    bundle = bundle_of(replace(rest, view=view), fit.motion, fit.bundle.priors,
                       fit.bundle.sigma_px)
    state = bundle.optimise(replace(fit.state, path=fit.state.path.of_views(kept),
                                    points=fit.state.points[points]), 60, 1e-6)
    return (state.lens.values - fit.state.lens.values,
            bundle.information(state).lens_covariance)


@pytest.mark.long
@pytest.mark.parametrize('name', ['floor and wall', 'rolling shutter, a tenth of the interval'])
def test_one_step_does_what_the_iterations_do(name):
    fit = fit_of(name)
    shifts, covariances = delete_a_group(fit)
    iterated, theirs = zip(*(optimised_without(fit, k) for k in range(SEGMENTS)))
    sigma = np.sqrt(np.diag(fit.lens_covariance))
    free = sigma > 0
    iterated = np.array(iterated)[:, free] / sigma[free]
    shifts = shifts[:, free] / sigma[free]

    # to a sixth of the shift, of which there are up to ten sigmas with the shutter
    assert np.linalg.norm(shifts - iterated) < 0.17 * np.linalg.norm(iterated)
    assert np.sum(shifts * iterated) == pytest.approx(np.sum(iterated**2), rel=0.1)
    np.testing.assert_allclose(covariances[:, 0, 0], np.array(theirs)[:, 0, 0], rtol=0.1)


def test_what_nothing_measures_comes_out_very_large():
    information = np.diag([4.0, 25.0, 25.0, 1.0])
    information[1, 2] = information[2, 1] = 25       # the sum of two unknowns is all that is seen
    unknowns = selection_matrix(np.array([True, True, True, False]))

    covariance = inverse_information(information, unknowns)

    assert covariance[0, 0] == pytest.approx(0.25)
    assert 1e9 < covariance[1, 1] < np.inf
    assert np.array([0, 1, 1, 0]) @ covariance @ [0, 1, 1, 0] < 1
    assert not covariance[3].any()
