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
"""A lamp that changes is told from other edges."""

import numpy as np
import pytest

from selfcal_ros.rorapid.edges.edge_choice import change_of_light

WANTED = np.random.default_rng(0).uniform(15, 90, 40) * np.repeat([1, -1], 20)


@pytest.mark.parametrize('factor', (0.25, 0.6, 1.0, 3.0))
def test_one_factor_for_all_contrasts_is_that_of_the_lamp(factor):
    noisy = factor * WANTED + np.random.default_rng(1).normal(size=40)
    assert change_of_light(noisy, WANTED) == pytest.approx(factor, rel=0.1)


def test_edges_that_are_others_or_few_are_no_change_of_light():
    rng = np.random.default_rng(2)
    assert change_of_light(rng.uniform(15, 90, 40), WANTED) == 1
    assert change_of_light(0.05 * WANTED, WANTED) == 1
    few = np.where(np.arange(40) < 10, WANTED, 0)
    assert change_of_light(0.3 * few, few) == 1
    spread = WANTED * np.exp(rng.normal(size=40))
    assert change_of_light(spread, WANTED) == 1
