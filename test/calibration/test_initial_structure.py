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
"""The order in which a start attaches views."""

import numpy as np
import pytest

from selfcal_ros.calibration.initialisation.initial_structure import PairGeometry, spanning_order


def pair(first, second, matches):
    return PairGeometry(first, second, np.eye(3), np.arange(matches), np.empty(0), np.empty(0))


def one_after_another(pairs, views):
    """Look through all pairs for each view: the definition of the order."""
    order, standing = [], {0}
    waiting = sorted(range(len(pairs)), key=lambda k: (pairs[k].second - pairs[k].first,
                                                       -len(pairs[k].track)))
    while len(standing) < views:
        leading = [k for k in waiting if (pairs[k].first in standing)
                   != (pairs[k].second in standing)]
        if not leading:
            break
        a, b = pairs[leading[0]].first, pairs[leading[0]].second
        order.append((leading[0], a, b) if a in standing else (leading[0], b, a))
        standing |= {a, b}
    return order


@pytest.mark.parametrize('seed', range(40))
def test_views_are_attached_to_their_neighbours_first(seed):
    rng = np.random.default_rng(seed)
    views = int(rng.integers(1, 14))
    # few counts of matches, so that some are alike; some graphs fall apart
    pairs = [pair(a, b, int(rng.integers(20, 24))) for a in range(views)
             for b in range(a + 1, views) if rng.random() < rng.choice([0.15, 0.5, 1.0])]
    rng.shuffle(pairs)
    for wanted in (views, max(views // 2, 1)):
        assert spanning_order(pairs, wanted) == one_after_another(pairs, wanted)
