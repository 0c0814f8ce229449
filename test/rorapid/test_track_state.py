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
"""What a measurement does to the state of an object, and what is said where it is rejected."""

from types import SimpleNamespace

import numpy as np
import pytest

from selfcal_ros.rorapid.estimation.track_state import (
    ALONE, GUIDED, rejection_reason, TrackStateMachine)
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.tracked_frame import TrackerState


def measured(share, determined=True, found=40):
    return SimpleNamespace(share=share, determined=determined, reason='', state=None,
                           recognised=True, found=np.arange(60) < found)


@pytest.mark.parametrize('what, open_turn, words', (
    (measured(1.0), True, 'a rotation stays open'),
    (measured(1.0, False, 4), True, '4 places on edges do not determine'),
    (measured(1.0), False, 'too little of the object to recognise'),
    (measured(0.1), True, 'Only 10 %'), (measured(0.1, False), False, 'Only 10 %')))
def test_a_refusal_names_its_cause(what, open_turn, words):
    said = rejection_reason(what, '', open_turn, TrackerOptions())
    assert words in said and '100 %' not in said and said.endswith('.')


def test_what_is_degraded_by_an_open_turn_is_said_to_be():
    said = TrackStateMachine().confirm(measured(0.95), False, '', TrackerOptions())
    assert 'a rotation stays open' in said
    assert 'Only 40 %' in TrackStateMachine().confirm(measured(0.4), False, '', TrackerOptions())


def followed():
    track = TrackStateMachine()
    track.begin(lost=False)
    track.confirm(measured(0.9), True, '', TrackerOptions())
    return track


def test_a_part_of_a_pose_is_accepted_only_where_other_cameras_guide():
    part, options = measured(0.9, determined=False), TrackerOptions()
    assert followed().accepts(part, False, GUIDED, options)
    assert not followed().accepts(part, False, ALONE, options)


def test_a_start_that_nothing_confirms_is_given_up_after_some_images():
    track, options = TrackStateMachine(), TrackerOptions(frames_to_lost=3)
    track.begin(lost=False)
    assert [track.gives_up(False, False, options) for _ in range(2)] == [False, False]
    # what is near counts anew
    assert not track.gives_up(True, False, options) and track.misses == 0
    assert track.state is TrackerState.INITIALISING
    assert track.gives_up(True, True, options) and track.state is TrackerState.LOST
