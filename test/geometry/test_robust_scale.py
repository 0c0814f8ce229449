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
"""The median absolute deviation gives the noise, and gross errors do not move it."""

import numpy as np
import pytest
from selfcal_ros.geometry.robust_scale import robust_sigma, robust_sigma_of_lengths


def test_sigma_of_normal_noise():
    noise = np.random.default_rng(0).normal(scale=0.3, size=200_000)
    assert robust_sigma(noise) == pytest.approx(0.3, rel=0.01)


def test_sigma_of_a_coordinate_follows_from_lengths():
    noise = np.random.default_rng(2).normal(scale=0.3, size=(200_000, 2))
    noise[::50] = 1e6
    assert robust_sigma_of_lengths(np.linalg.norm(noise, axis=1)) == pytest.approx(0.3, rel=0.02)


def test_gross_errors_move_it_little():
    noise = np.random.default_rng(1).normal(size=(2, 100_000))
    noise[:, ::10] = 1e6
    assert robust_sigma(noise, axis=1) == pytest.approx([1.2, 1.2], rel=0.1)


def test_missing_values_are_left_out_and_the_axis_may_stay():
    values = np.array([[1.0, np.nan, 1.0], [2.0, 2.0, 2.0]])
    assert robust_sigma(values, axis=1, keepdims=True) == pytest.approx(
        np.array([[1.4826], [2.9652]]))
