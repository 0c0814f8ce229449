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
"""The states of a calibration session: their tables, and what no sequence of events may do."""

import numpy as np
import pytest

from selfcal_ros.pipeline.session_state import (after, ESTIMATE_TRANSITIONS, EstimateState,
                                                Schedule, SCHEDULE_TRANSITIONS, SessionEvent,
                                                UNDER_WAY, WILL_BE_DROPPED)


def walk(table, state, *events):
    for event in events:
        state = after(table, state, event)
    return state


@pytest.mark.parametrize('table, first', [(ESTIMATE_TRANSITIONS, EstimateState.IDLE),
                                          (SCHEDULE_TRANSITIONS, Schedule.AUTOMATIC)])
def test_every_state_can_be_reached_and_left(table, first):
    reached, front = {first}, [first]
    while front:
        here = front.pop()
        for (state, _), following in table.items():
            if state is here and following not in reached:
                reached.add(following)
                front.append(following)
    assert reached == set(type(first))
    assert {state for state, _ in table} == set(type(first))
    assert all(following is not state for (state, _), following in table.items()), \
        'what changes nothing is not listed'


def test_every_event_means_something():
    listed = {event for table in (ESTIMATE_TRANSITIONS, SCHEDULE_TRANSITIONS)
              for _, event in table}
    assert listed == set(SessionEvent)


@pytest.mark.parametrize('state', EstimateState)
def test_a_result_ends_what_is_under_way(state):
    assert after(ESTIMATE_TRANSITIONS, state, SessionEvent.RESULT) not in UNDER_WAY


@pytest.mark.parametrize('state', EstimateState)
def test_a_start_is_possible_only_when_nothing_is_under_way(state):
    listed = (state, SessionEvent.START) in ESTIMATE_TRANSITIONS
    assert listed == (state not in UNDER_WAY)


@pytest.mark.parametrize('event', [SessionEvent.OTHER_QUESTION, SessionEvent.HOLD])
@pytest.mark.parametrize('state', UNDER_WAY)
def test_what_is_under_way_is_dropped_when_it_answers_another_question(state, event):
    assert after(ESTIMATE_TRANSITIONS, state, event) in WILL_BE_DROPPED


def test_a_wish_outlives_the_estimate_that_is_dropped_and_ends_with_an_alarm():
    asked = walk(ESTIMATE_TRANSITIONS, EstimateState.IDLE, SessionEvent.START,
                 SessionEvent.OTHER_QUESTION, SessionEvent.WISH)
    assert walk(ESTIMATE_TRANSITIONS, asked, SessionEvent.RESULT) is EstimateState.WISHED
    for events in ((SessionEvent.HOLD, SessionEvent.RESULT),
                   (SessionEvent.RESULT, SessionEvent.HOLD)):
        assert walk(ESTIMATE_TRANSITIONS, asked, *events) is EstimateState.IDLE
    # while the result will be taken, a wish asks for nothing more
    assert after(ESTIMATE_TRANSITIONS, EstimateState.RUNNING,
                 SessionEvent.WISH) is EstimateState.RUNNING


@pytest.mark.parametrize('event', SessionEvent)
def test_an_alarm_holds_until_the_session_is_released(event):
    following = after(SCHEDULE_TRANSITIONS, Schedule.HELD, event)
    assert following is (Schedule.AUTOMATIC if event is SessionEvent.RELEASE else Schedule.HELD)


def test_no_sequence_of_events_takes_a_result_that_was_given_up():
    rng = np.random.default_rng(0)
    given_up = (SessionEvent.OTHER_QUESTION, SessionEvent.HOLD)
    for _ in range(200):
        state, void = EstimateState.IDLE, False
        for event in rng.choice(list(SessionEvent), 60):
            if event is SessionEvent.RESULT and state in UNDER_WAY:
                assert (state in WILL_BE_DROPPED) == void
            if event is SessionEvent.START and state not in UNDER_WAY:
                void = False
            elif event in given_up:
                void = state in UNDER_WAY
            state = after(ESTIMATE_TRANSITIONS, state, event)
