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
A search as a list of attempts: what is tried, when, and which result ends it.

An attempt reads what those before it found, and adds its own. So each can be read alone, and the
order, with its reasons, stands in one place: in the list.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import logging
from typing import Generic, TypeVar

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.no_estimate import NoEstimate

_LOGGER = logging.getLogger(__name__)
#: What the attempts of one search found so far, a value that they replace.
SoFar = TypeVar('SoFar')


def always(_: object) -> bool:
    """Let an attempt be tried whatever was found."""
    return True


def never_last(_: object) -> None:
    """Let the search go on, whatever an attempt found."""


@dataclass(frozen=True)
class Attempt(Generic[SoFar]):
    """
    One step of a search.

    Attributes
    ----------
    name : str
        For the log.
    tried_when : callable
        Tells from what was found so far whether this is tried.
    make : callable
        Returns what was found so far, with what this finds.
    accepted : callable
        Returns the result that ends the search, of what was found with this attempt. None where
        the search goes on.

    """

    name: str
    tried_when: Callable[[SoFar], bool]
    make: Callable[[SoFar], SoFar]
    accepted: Callable[[SoFar], Calibration | NoEstimate | None] = never_last


def first_accepted(attempts: Sequence[Attempt[SoFar]], so_far: SoFar,
                   ) -> tuple[Calibration | NoEstimate | None, SoFar]:
    """
    Make attempts one after the other until one is accepted.

    Parameters
    ----------
    attempts : sequence of Attempt
        In order.
    so_far
        What is known before the first.

    Returns
    -------
    Calibration or NoEstimate or None
        The accepted result, which may be a refusal. None where the attempts run out.
    so_far
        What was found until then.

    """
    for attempt in attempts:
        if not attempt.tried_when(so_far):
            continue
        so_far = attempt.make(so_far)
        result = attempt.accepted(so_far)
        _LOGGER.debug('%s: %s', attempt.name, 'goes on' if result is None else 'accepted')
        if result is not None:
            return result, so_far
    return None, so_far
