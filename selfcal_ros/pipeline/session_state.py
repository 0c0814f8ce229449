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
"""
The states of a calibration session, and what moves it from one to another.

A session is in two states at once. `EstimateState` says what is under way; `Schedule` says whether
estimates begin by themselves. Each has a table of transitions; an event that a state does not list
leaves it as it is.
"""

from __future__ import annotations

from enum import Enum
from typing import TypeVar


class EstimateState(Enum):
    """What is under way."""

    #: No estimate is under way.
    IDLE = 'idle'
    #: One is under way, and its result will be taken.
    RUNNING = 'running'
    #: One is under way, but its result will be dropped: it answers another question.
    ABANDONED = 'abandoned'
    #: As before, and somebody asked for another one, which follows it.
    SUPERSEDED = 'superseded'
    #: None is under way; the one that was asked for is due.
    WISHED = 'wished'


class Schedule(Enum):
    """Whether estimates begin by themselves."""

    #: When there is enough that is new.
    AUTOMATIC = 'automatic'
    #: Not any more: the calibration is precise, and rests on all that is kept.
    SETTLED = 'settled'
    #: Not until the session is released: the camera has changed.
    HELD = 'held'


class SessionEvent(Enum):
    """What happens to a session."""

    #: A request was handed out.
    START = 'start'
    #: An estimate was asked for, and cannot start now.
    WISH = 'wish'
    #: An estimate was asked for, and there are too few keyframes.
    TOO_FEW = 'too few'
    #: A result came, whatever it is.
    RESULT = 'result'
    #: The result that was taken is precise, and rests on as many keyframes as are kept.
    PRECISE = 'precise'
    #: The result that was taken is a calibration, but not that good.
    IMPRECISE = 'imprecise'
    #: Motion or facts were changed.
    OTHER_QUESTION = 'other question'
    #: More keyframes may be kept than before.
    MORE_ROOM = 'more room'
    #: The camera has changed.
    HOLD = 'hold'
    #: The session goes on with what shows the changed camera.
    RELEASE = 'release'


#: By state and event.
ESTIMATE_TRANSITIONS = {
    (EstimateState.IDLE, SessionEvent.START): EstimateState.RUNNING,
    (EstimateState.RUNNING, SessionEvent.RESULT): EstimateState.IDLE,
    (EstimateState.RUNNING, SessionEvent.OTHER_QUESTION): EstimateState.ABANDONED,
    (EstimateState.RUNNING, SessionEvent.HOLD): EstimateState.ABANDONED,
    (EstimateState.ABANDONED, SessionEvent.RESULT): EstimateState.IDLE,
    (EstimateState.ABANDONED, SessionEvent.WISH): EstimateState.SUPERSEDED,
    (EstimateState.SUPERSEDED, SessionEvent.RESULT): EstimateState.WISHED,
    (EstimateState.SUPERSEDED, SessionEvent.HOLD): EstimateState.ABANDONED,
    (EstimateState.SUPERSEDED, SessionEvent.TOO_FEW): EstimateState.ABANDONED,
    (EstimateState.WISHED, SessionEvent.START): EstimateState.RUNNING,
    (EstimateState.WISHED, SessionEvent.HOLD): EstimateState.IDLE,
    (EstimateState.WISHED, SessionEvent.TOO_FEW): EstimateState.IDLE,
}
#: By state and event.
SCHEDULE_TRANSITIONS = {
    (Schedule.AUTOMATIC, SessionEvent.PRECISE): Schedule.SETTLED,
    (Schedule.AUTOMATIC, SessionEvent.HOLD): Schedule.HELD,
    (Schedule.SETTLED, SessionEvent.IMPRECISE): Schedule.AUTOMATIC,
    (Schedule.SETTLED, SessionEvent.OTHER_QUESTION): Schedule.AUTOMATIC,
    (Schedule.SETTLED, SessionEvent.MORE_ROOM): Schedule.AUTOMATIC,
    (Schedule.SETTLED, SessionEvent.HOLD): Schedule.HELD,
    (Schedule.SETTLED, SessionEvent.RELEASE): Schedule.AUTOMATIC,
    (Schedule.HELD, SessionEvent.RELEASE): Schedule.AUTOMATIC,
}
#: An estimate is being computed.
UNDER_WAY = (EstimateState.RUNNING, EstimateState.ABANDONED, EstimateState.SUPERSEDED)
#: Its result will be dropped.
WILL_BE_DROPPED = (EstimateState.ABANDONED, EstimateState.SUPERSEDED)

State = TypeVar('State', EstimateState, Schedule)


def after(table: dict[tuple[State, SessionEvent], State], state: State,
          event: SessionEvent) -> State:
    """Return the state that follows an event: the same where the table does not list it."""
    return table.get((state, event), state)
