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
"""Stamps that go back: a little is a message overtaken, more is another run."""

import pytest

from selfcal_ros.pipeline.stamp_order import BACKWARD_JUMP_NS, stamp_order, StampOrder

NEWEST_NS = 10**18


@pytest.mark.parametrize('step_ns, order', [
    (0, StampOrder.IN_ORDER), (1, StampOrder.IN_ORDER), (10**12, StampOrder.IN_ORDER),
    (-1, StampOrder.OVERTAKEN), (1 - BACKWARD_JUMP_NS, StampOrder.OVERTAKEN),
    (-BACKWARD_JUMP_NS, StampOrder.JUMPED_BACK), (-NEWEST_NS, StampOrder.JUMPED_BACK)])
def test_stamps_against_the_newest_one(step_ns, order):
    assert stamp_order(NEWEST_NS + step_ns, NEWEST_NS) is order


def test_the_first_stamp_is_in_order():
    assert stamp_order(0, None) is StampOrder.IN_ORDER
