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
"""The bench of lenses draws what it says and judges against the truth; its runs take longer."""

from types import SimpleNamespace

from bench.lenses import lens_runs, lenses
from bench.lenses.lens_population import profile_path
import numpy as np
import pytest
from selfcal_ros import Camera
from selfcal_ros.calibration.result import NotCalibrated

TRUTH = Camera([[500, 0, 322], [0, 500, 238], [0, 0, 1]], (-0.2, 0.05, 0.001, 0, 0), 640, 480)
SIGMA = np.array([0.5, 0.5, 0.4, 0.4, 0, 0.002, 0.004, 0.0002, 0.0002, 0.002])


def _calibration(parameters, model='plumb_bob'):
    camera = Camera.from_parameters(parameters, 640, 480, model)
    names = camera.parameter_names
    sigma = SIGMA[:len(names)]
    covariance = np.diag(sigma**2)
    covariance[0, 1] = covariance[1, 0] = 0.999 * sigma[0]**2
    return SimpleNamespace(
        camera=camera, parameter_names=names, covariance=covariance,
        sigma=dict(zip(names, sigma)), facts=SimpleNamespace(distortion=model),
        status={name: 'held' if name == 'skew' else 'estimated' for name in names})


@pytest.mark.parametrize('lens', lens_runs.LENSES)
def test_drawn_lenses_see_their_image(lens):
    if profile_path() is None:
        pytest.skip('../shared/data/lens_profiles.csv is not there')
    camera = lens_runs.draw_camera(np.random.default_rng(5), lens)
    assert np.isfinite(camera.rays([[0, camera.K[1, 2]], camera.K[:2, 2]])).all()
    across = np.degrees(camera.field_of_view()[0])
    if lens.startswith('equidistant'):
        assert across == pytest.approx(float(lens.split()[1]), abs=3)
    assert camera.lens.is_perspective != lens.startswith('equidistant')


def test_true_draws_lie_inside_as_often_as_they_should():
    rng = np.random.default_rng(1)
    outcomes = []
    for _ in range(40):
        away = SIGMA * rng.standard_normal(len(SIGMA))
        away[1] = away[0]
        outcomes.append(lens_runs.compared(_calibration(TRUTH.parameters + away), TRUTH))
    assert np.mean([one.distance for one in outcomes]) == pytest.approx(8, rel=0.25)
    assert 0.4 < lenses.inside(outcomes)[0] < 0.8 < lenses.inside(outcomes)[-1]
    assert outcomes[0].size == 8 and outcomes[0].same_family
    corners = np.concatenate([one.rays['corners'] for one in outcomes])
    assert np.mean(corners) == pytest.approx(2, rel=0.4)


def test_another_family_is_judged_by_its_matrix_and_its_rays():
    fisheye = np.r_[TRUTH.parameters[:5], 0.2, 0, 0, 0]
    outcome = lens_runs.compared(_calibration(fisheye, 'equidistant'), TRUTH)
    assert not outcome.same_family and outcome.size == 3 and outcome.distance == 0
    assert outcome.ray_px['corners'].max() > 5 > 0.01 > outcome.ray_px['middle'].max()
    refused = NotCalibrated('why', kind='straight_motion')
    assert lens_runs.compared(refused, TRUTH).reason == 'straight_motion'


def test_runs_that_lie_in_the_cache_are_not_made_again(tmp_path, monkeypatch):
    rng, made = np.random.default_rng(2), []

    def one_run(task):
        made.append(task)
        return lens_runs.compared(_calibration(TRUTH.parameters + 1e-4 * rng.random(10)), TRUTH)

    monkeypatch.setattr(lens_runs, 'one_run', one_run)
    options = SimpleNamespace(cache=tmp_path / 'runs', processes=1)
    first = lens_runs.kept_outcomes([('none', 'drive', 0)], options)
    both = lens_runs.kept_outcomes([('none', 'drive', 0), ('none', 'drive', 1)], options)
    assert made == [('none', 'drive', 0), ('none', 'drive', 1)]
    again, before = both['none', 'drive', 0], first['none', 'drive', 0]
    assert again.distance == before.distance
    np.testing.assert_array_equal(again.rays['corners'], before.rays['corners'])
