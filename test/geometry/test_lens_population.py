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
"""The prior over real lenses holds published lenses, and lenses that it was made from."""

from bench.inputs import data_folder
from bench.lenses.lens_population import equidistant_lenses, read_profiles
import numpy as np
import pytest
from scipy.stats import chi2
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses.population import lens_population, TANGENTIAL_SIGMA
from selfcal_ros.geometry.lenses.population_table import KNOTS

#: Lenses of cameras that robots carry, and designs: model, coefficients, corner.
PUBLISHED = {
    'euroc': ('plumb_bob', (-0.283, 0.074, 0.0002, 0.00002, 0), 0.98),
    'barrel': ('plumb_bob', (-0.35, 0.15, 0, 0, -0.04), 0.95),
    'kitti, raw': ('plumb_bob', (-0.373, 0.204, 0.0022, 0.0014, -0.072), 0.75),
    'kinect': ('plumb_bob', (0.2312, -0.7849, -0.0033, -0.0001, 0.9172), 0.77),
    'euroc, two': ('radial2', (-0.28, 0.07), 0.98),
    'kinect azure': ('rational', (0.515, -2.731, 0.0009, -0.0002, 1.608, 0.392, -2.545, 1.53),
                     1.21),
    'full circle': ('equidistant', (-0.0388, 0.0087, -0.0110, 0.0025), 2.13),
}
#: Series of the designs in powers of the angle.
DESIGNS = {
    'equidistant': (0, 0, 0, 0),
    'stereographic': (1 / 12, 1 / 120, 17 / 20160, 31 / 362880),
    'equisolid': (-1 / 24, 1 / 1920, -1 / 322560, 0),
    'perspective': (1 / 3, 2 / 15, 17 / 315, 62 / 2835),
}
MODELS = ('radial1', 'radial2', 'radial3', 'plumb_bob', 'rational', 'equidistant')


def _level(model, values, corner):
    """Share of the prior that is nearer its middle than the values."""
    mean, covariance = lens_population(model, corner)
    away = np.asarray(values) - mean
    return chi2.cdf(away @ np.linalg.solve(covariance, away), len(away))


@pytest.mark.parametrize('name', PUBLISHED)
def test_published_lenses_are_likely(name):
    assert _level(*PUBLISHED[name]) < 0.95


@pytest.mark.parametrize('corner', [0.1, 0.3, 0.7, 1.1, 1.5, 2.1, 2.6])
def test_designs_of_every_width_are_likely(corner):
    for name, values in DESIGNS.items():
        # a perspective this wide has no such series
        if name != 'perspective' or corner < 1.5:
            assert _level('equidistant', values, corner) < 0.95, name
    assert _level('plumb_bob', np.zeros(5), corner) < 0.95


def test_measured_lenses_lie_where_they_should():
    folder = data_folder('fisheye_room')
    if folder is None or not (folder.parent / 'lens_profiles.csv').exists():
        pytest.skip('../shared/data/lens_profiles.csv is not there')
    lenses = equidistant_lenses(read_profiles(folder.parent / 'lens_profiles.csv'))[::20]
    levels = np.array([
        _level('equidistant', scaled / corner**np.array([2, 4, 6, 8]), corner)
        for scaled, corner in zip(lenses.scaled, lenses.corner)])
    assert 0.97 < np.mean(levels < 0.99) <= 1
    # the middle is too wide, as it is said to be, but not a hundred times
    assert 0.6 < np.mean(levels < 0.6) < 0.99


@pytest.mark.parametrize('model', MODELS)
def test_prior_changes_steadily_and_is_a_covariance(model):
    for corner in np.geomspace(0.05, 3, 40):
        mean, covariance = lens_population(model, corner)
        sigma = np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(sigma, sigma))[0] > 0
        near_mean, near = lens_population(model, corner * (1 + 1e-6))
        assert np.allclose(covariance, near, rtol=1e-3)
        assert np.allclose(mean, near_mean, rtol=1e-3, atol=1e-9)


def test_spread_beyond_the_table_and_of_decentring():
    widest = lens_population('equidistant', KNOTS[-1])
    assert np.allclose(lens_population('equidistant', 2 * KNOTS[-1])[1], widest[1])
    narrow, narrower = (lens_population('radial1', KNOTS[0] / d) for d in (1, 2))
    assert narrower[1] == pytest.approx(16 * narrow[1])
    covariance = lens_population('plumb_bob', 0.8)[1]
    assert np.allclose(np.sqrt(np.diag(covariance)[2:4]), TANGENTIAL_SIGMA)
    assert not covariance[2:4][:, [0, 1, 4]].any()
    assert lens_population('none', 0.8)[0].shape == (0,)


def test_what_has_no_prior_is_said():
    with pytest.raises(ArgumentError, match='no prior over lenses'):
        lens_population('fov', 1.0)
    with pytest.raises(ArgumentError, match='no prior over lenses'):
        lens_population('radial1', 0.0)
