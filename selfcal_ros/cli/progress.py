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
"""How far the work has come: a bar on a terminal, lines in a log."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import sys
import time
from typing import Any, TextIO

from selfcal_ros.cli.time_left import Courses, TimeLeft

#: Nothing is said of work that takes no longer, seconds.
PATIENCE_S = 10.0
#: Time between two lines, seconds.
PERIOD_S = 10.0


class Progress:
    """
    Shows how far long work has come, stage by stage; a context manager.

    A bar with the time that is left stands on a terminal. Elsewhere, as in a log, lines appear
    once the work takes long: when a stage begins and ends, and every some seconds between.

    Parameters
    ----------
    wanted : bool
        False: nothing is shown.
    stages : bool
        Lines for every stage with the time that it took, on a terminal as well.
    stream : text stream, optional
        By default standard error.
    clock : callable
        Returns seconds.
    courses : tuple
        Courses of stages, as of `time_left.TimeLeft`: the time that is left is that of all.

    """

    def __init__(self, wanted: bool = True, stages: bool = False, stream: TextIO | None = None,
                 clock: Callable[[], float] = time.monotonic, courses: Courses = ()) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._bar = _Bar(self._stream) if wanted and not stages and self._stream.isatty() else None
        self._lines = wanted and self._bar is None
        self._stages, self._clock = stages, clock
        self._text = ''
        self._told = False
        self._whole = TimeLeft(courses)
        self._start = self._began = self._last = clock()

    @classmethod
    def of(cls, args: argparse.Namespace, courses: Courses = ()) -> Progress:
        """Return what -q and -v ask for."""
        return cls(not getattr(args, 'quiet', False), bool(getattr(args, 'verbose', 0)),
                   courses=courses)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
        self._end_stage(self._clock())

    def __call__(self, text: str, done: float = 0, total: float | None = None) -> None:
        """Tell that so much of a stage is done; `total` is None where it is not known."""
        now = self._clock()
        whole_s = self._whole.seconds(text, done, total, now)
        if self._bar is not None:
            self._bar.show(text, done, total, '' if whole_s is None else
                           f'about {_duration(whole_s)} left in all')
        if not self._lines:
            return
        if text != self._text:
            self._end_stage(now)
            self._text, self._began, self._told = text, now, False
            if self._stages or now - self._start >= PATIENCE_S:
                self._say(now, f'{text} ...' + (
                    '' if whole_s is None else f' (about {_duration(whole_s)} left in all)'))
        elif done and now - self._start >= PATIENCE_S and now - self._last >= PERIOD_S:
            self._say(now, f'{text}: {_share(done, total)}'
                      f'{self._left(now, done, total, whole_s)}')

    def _end_stage(self, now: float) -> None:
        if self._told:
            took = _duration(now - self._began)
            # no figure where it would be zero
            self._say(now, f'{self._text}: done' + (f' in {took}' if took != '0.0 s' else ''))
        self._told = False

    def _left(self, now: float, done: float, total: float | None, whole_s: float | None) -> str:
        """Say how long all or else the stage will take from here, if it goes on as it went."""
        if whole_s is not None:
            return f', about {_duration(whole_s)} left in all'
        if not total or done >= total:
            return ''
        return f', about {_duration((now - self._began) * (total - done) / done)} left'

    def _say(self, now: float, text: str) -> None:
        self._last, self._told = now, True
        print(f'[{now - self._start:6.1f} s] {text}', file=self._stream, flush=True)


def _share(done: float, total: float | None) -> str:
    """Say how much is done; a total of 1.0 is a share."""
    if not total:
        return f'{done:.0f}'
    percent = f'{100 * done / total:.0f} %'
    return percent if isinstance(total, float) else f'{done:.0f} of {total:.0f} ({percent})'


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f'{seconds:.1f} s' if seconds < 10 else f'{seconds:.0f} s'
    return f'{seconds / 60:.0f} min' if seconds < 6000 else f'{seconds / 3600:.1f} h'


class _Bar:
    """A bar of tqdm, a new one for every stage."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._bar: Any = None
        self._text = ''

    def show(self, text: str, done: float, total: float | None, left: str) -> None:
        if self._bar is None or text != self._text:
            from tqdm import tqdm
            self.close()
            self._text = text
            kind = ('{desc} [{elapsed}{postfix}]' if not total and not done else
                    '{desc}: {percentage:3.0f}%|{bar}| [{elapsed}<{remaining}{postfix}]'
                    if isinstance(total, float) else None)
            self._bar = tqdm(desc=text, total=total, leave=False, file=self._stream,
                             dynamic_ncols=True, bar_format=kind)
        self._bar.set_postfix_str(left, refresh=False)
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
