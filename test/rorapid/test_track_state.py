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
"""A rejection names its cause: too little, an open turn, or edges that are not found."""

from types import SimpleNamespace

import numpy as np
import pytest

from selfcal_ros.rorapid.estimation.track_state import rejection_reason, TrackStateMachine
from selfcal_ros.rorapid.options import TrackerOptions


def measured(share, determined=True, found=40):
    return SimpleNamespace(share=share, determined=determined, reason='', state=None,
                           found=np.arange(60) < found)


@pytest.mark.parametrize('what, open_turn, words', (
    (measured(1.0), True, 'a rotation stays open'),
    (measured(1.0, False, 4), True, '4 places on edges do not determine'),
    (measured(1.0), False, 'too little of the object to recognise'),
    (measured(0.1), True, 'Only 10 %'), (measured(0.1, False), False, 'Only 10 %')))
def test_a_refusal_names_its_cause(what, open_turn, words):
    said = rejection_reason(what, False, open_turn, TrackerOptions())
    assert words in said and '100 %' not in said and said.endswith('.')


def test_what_is_degraded_by_an_open_turn_is_said_to_be():
    said = TrackStateMachine().confirm(measured(0.95), False, '', TrackerOptions())
    assert 'a rotation stays open' in said
    assert 'Only 40 %' in TrackStateMachine().confirm(measured(0.4), False, '', TrackerOptions())
