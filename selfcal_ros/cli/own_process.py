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
"""What a command owes to those around its process: streams that take anything, a clean end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import os
import signal
import sys
from types import FrameType
from typing import TextIO
import warnings

from selfcal_ros.cli.status import EXIT_INPUT


#: Signals that came. A library may swallow what a handler raises, and fail in a way of its own.
_CAME: list[int] = []


class EndedBySignal(BaseException):
    """The process is to end; what is temporary is removed on the way out."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def own_process(library_noise: bool = False, unfinished: str = '') -> Iterator[None]:
    """
    Run a command that has the process for itself.

    Parameters
    ----------
    library_noise : bool
        Let libraries of C, and other processes, write to standard error. What they have to say of
        a damaged file, we say in a sentence.
    unfinished : str
        What is said of an interrupt from the keyboard; empty where that is the usual end.

    SIGTERM and SIGHUP unwind it, so that temporary files and other processes go with it, and then
    end it as they would have. Closed streams lead nowhere, and what a terminal cannot show is
    escaped.
    """
    _usable_streams()
    if not library_noise:
        keep_standard_error()
        if not sys.warnoptions:
            warnings.simplefilter('ignore')
    for name in ('SIGTERM', 'SIGHUP'):
        number = getattr(signal, name, None)
        # whoever is ignored, as under nohup, stays so
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _end)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        try:
            yield
        finally:
            # nothing is left to be unwound: a late signal ends the process without a word
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            _flush()
    except EndedBySignal as ended:
        _leave(ended.number)
    except KeyboardInterrupt:
        with suppress(OSError):
            # the terminal shows ^C in that line
            print('\n' + unfinished if sys.stderr.isatty() else unfinished, file=sys.stderr)
        _leave(signal.SIGINT)


def _end(number: int, _: FrameType | None) -> None:
    # a second one must not break the unwinding
    signal.signal(number, signal.SIG_IGN)
    _CAME.append(number)
    raise EndedBySignal(number)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _CAME.append(number)
    signal.default_int_handler(number, frame)


def end_if_told_to() -> None:
    """End by the signal that came, whatever was made of what its handler raised."""
    if _CAME:
        raise EndedBySignal(_CAME[-1])


def _leave(number: int) -> None:
    """End as the signal would have ended the process; whoever started it can tell."""
    silence(sys.stdout)
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


def _flush() -> None:
    """Write what is left, of a help text for example, where there is room for it."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        silence(sys.stdout)
    except OSError as error:
        silence(sys.stdout)
        with suppress(OSError):
            print(f'selfcal: Cannot use standard output: {error.strerror}.', file=sys.stderr)
        sys.exit(EXIT_INPUT)


def silence(stream: TextIO | None) -> None:
    """Lead a stream nowhere, where not even the flush at the end of the process can fail."""
    if stream is None:
        return
    with suppress(OSError, AttributeError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def keep_standard_error() -> None:
    """Keep standard error to Python: libpng and others write to its number without being asked."""
    kept = os.dup(2)
    sys.stderr = open(kept, 'w', buffering=1, encoding=sys.stderr.encoding or 'utf-8',
                      errors='backslashreplace')
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _usable_streams() -> None:
    """Open what is closed, so that no file gets its number, and let no character be refused."""
    for number, name in enumerate(('stdin', 'stdout', 'stderr')):
        try:
            os.fstat(number)
        except OSError:
            # the lowest number that is free, which is this one
            os.open(os.devnull, os.O_RDWR)
        stream = getattr(sys, name)
        if stream is None:
            stream = open(os.devnull, 'r' if number == 0 else 'w', encoding='utf-8')
            setattr(sys, name, stream)
        if number and hasattr(stream, 'reconfigure'):
            stream.reconfigure(errors='backslashreplace')
