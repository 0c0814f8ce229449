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
"""How long a command of several stages will still take, with those that are yet to come."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

#: Courses of stages: the name of each, and what it costs.
Courses: TypeAlias = tuple[tuple[tuple[str, float | None], ...], ...]
#: Stages of a calibration, by the kind of its input, with what each costs: in images of the first
#: stage, as measured on the recordings of `bags/`. None: as many as the stage counts.
CALIBRATION: Courses = (
    (('tracking', None), ('estimating', 50), ('writing', 60)),
    (('features', None), ('matching', 50), ('registration', 50), ('estimating', 50),
     ('writing', 60)),
    (('Looking through the recording', None), ('Following the segments', 600),
     ('Calibrating the segments', 150), ('writing', 60)),
    (('Looking for the object', None), ('estimating', 10), ('writing', 60)))


def rig_courses(names: Sequence[str]) -> Courses:
    """
    Return the courses of cameras that move together; measured on `euroc_v101`, 20 instants.

    Parameters
    ----------
    names : sequence of str
        Of the cameras.

    """
    count = len(names)
    course: list[tuple[str, float | None]] = [(f'reading {name}', 20) for name in names[1:]]
    for name in names:
        course += [(f'features of {name}', 100), (f'matching of {name}', 100)]
    course += [('registration', 50 * count), *((f'estimating {name}', 150) for name in names),
               ('estimating the rig', 200 * count), ('writing', 20)]
    return ((f'tracking of {names[0]}', None), *course), tuple(course)


class TimeLeft:
    """
    Forecasts the end of a course of stages from what those before have taken.

    Parameters
    ----------
    courses : tuple of tuple of (str, float or None)
        Courses that there may be; that which begins with the first stage is followed.

    """

    def __init__(self, courses: Courses = ()) -> None:
        self._courses = courses
        self._course: dict[str, float | None] = {}
        self._past, self._text, self._total = 0.0, '', 0.0
        self._began = 0.0

    def seconds(self, text: str, done: float, total: float | None, now: float) -> float | None:
        """
        Return what is left of all stages; to be called whenever a stage begins or goes on.

        Parameters
        ----------
        text : str
            Name of the stage.
        done : float
        total : float or None
            None where it is not known; 1.0 where `done` is a share.
        now : float
            Seconds, by any clock.

        Returns
        -------
        float or None
            Seconds; None where the stage is of no known course, or nothing is done yet.

        """
        if text != self._text:
            self._enter(text, now)
        if text not in self._course:
            return None
        cost = self._course[text]
        if cost is None:
            cost = self._course[text] = float(total) if total else None
        if not cost:
            return None
        self._total = cost
        after = list(self._course)[list(self._course).index(text) + 1:]
        later = sum(self._course[name] or 0.0 for name in after)
        here = cost * min(done / total, 1.0) if total else 0.0
        units = self._past + here
        if not units or now <= self._began:
            return None
        if total:
            return (now - self._began) / units * (cost - here + later)
        # of a stage that does not say how far it is, those before tell the pace
        pace = self._pace
        spent = now - self._entered
        return max(pace * cost - spent, 0.0) + pace * later

    def _enter(self, text: str, now: float) -> None:
        """Begin a stage, and the course with the first."""
        if not self._course:
            self._course = next((dict(one) for one in self._courses if one[0][0] == text), {})
            self._began = now
        elif self._text in self._course:
            self._past += self._total
        self._total, self._text, self._entered = 0.0, text, now
        self._pace = (now - self._began) / self._past if self._past else 0.0
