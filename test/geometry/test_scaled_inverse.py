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
"""Inverses of matrices whose unknowns differ in unit by many orders of magnitude."""

import numpy as np
import pytest
from selfcal_ros.geometry.scaled_inverse import (is_regular, scaled_inverse,
                                                 scaled_pseudo_inverse, squared_distance,
                                                 unit_diagonal)

UNITS = np.array([1e-9, 1.0, 1e8, 1e3])


@pytest.fixture
def covariance():
    """A covariance of four unknowns in such units."""
    A = np.random.default_rng(0).normal(size=(4, 12))
    return A @ A.T * np.outer(UNITS, UNITS)


def test_the_diagonal_is_one_and_the_scale_brings_it_back(covariance):
    scaled, scale = unit_diagonal(covariance)
    assert np.allclose(np.diag(scaled), 1, rtol=1e-12)
    assert np.allclose(scaled * np.outer(scale, scale), covariance, rtol=1e-12)


def test_inverses_do_not_depend_on_units(covariance):
    for invert in (scaled_inverse, scaled_pseudo_inverse):
        alike = invert(covariance / np.outer(UNITS, UNITS)) / np.outer(UNITS, UNITS)
        assert np.allclose(invert(covariance), alike, rtol=1e-9, atol=0)
        assert np.allclose(invert(covariance) @ covariance * np.outer(UNITS, 1 / UNITS),
                           np.eye(4), atol=1e-9)


def test_what_is_not_measured_has_no_part_in_the_pseudo_inverse(covariance):
    covariance[2] = covariance[:, 2] = 0
    found = scaled_pseudo_inverse(covariance)
    rest = [0, 1, 3]
    assert not found[2].any() and np.isfinite(found).all()
    assert np.allclose(found[np.ix_(rest, rest)], scaled_inverse(covariance[np.ix_(rest, rest)]),
                       rtol=1e-9, atol=0)
    with pytest.raises(np.linalg.LinAlgError):
        scaled_inverse(covariance)


def test_a_distance_is_that_of_the_inverse_and_never_negative(covariance):
    d = UNITS * [0.5, -2.0, 1.0, 3.0]
    assert np.isclose(squared_distance(d, covariance), d @ scaled_inverse(covariance) @ d,
                      rtol=1e-9)
    # two unknowns whose difference nothing tells, and rounding to the wrong side
    alike = np.eye(4)
    alike[0, 1] = alike[1, 0] = 1 + 1e-13
    apart, along = np.array([[1.0, -1.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0]])
    assert apart @ np.linalg.solve(alike, apart) < 0
    alike *= np.outer(UNITS, UNITS)
    assert squared_distance(UNITS * apart, alike) == pytest.approx(0, abs=1e-9)
    assert squared_distance(UNITS * along, alike) == pytest.approx(1)
    assert squared_distance(np.zeros(4), alike) == 0


def test_the_least_eigenvalue_tells_dependence_and_not_units(covariance):
    least = np.linalg.eigvalsh(unit_diagonal(covariance)[0])[0]
    assert is_regular(covariance, 0.99 * least) and not is_regular(covariance, 1.01 * least)
    assert least > 1e-2
    covariance[1] = covariance[0] * UNITS[1] / UNITS[0]
    covariance[:, 1] = covariance[:, 0] * UNITS[1] / UNITS[0]
    assert not is_regular(covariance, 1e-12)
    assert not is_regular(np.zeros((2, 2)), 1e-12)
