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
"""Colours for a person at a terminal, and for nobody else."""

from __future__ import annotations

import os
import re
import sys
from typing import TextIO

_BOLD, _RED, _GREEN, _GREY, _RESET = '\033[1m', '\033[31m', '\033[32m', '\033[90m', '\033[0m'
_AMBER = '\033[33m'
#: What is said of parameters and recordings, and in which colour.
_WORDS = ((re.compile(r'\b(estimated|calibrated)$'), _GREEN),
          (re.compile(r'\bheld( by .*)?$'), _GREY),
          (re.compile(r'\b(hint: .*|estimated, if .* is exact)$'), _AMBER),
          (re.compile(r'\b(unobservable|contradicts the others|not calibrated.*)$'), _RED))


def wants_colour(stream: TextIO | None) -> bool:
    """Tell whether a stream is a terminal that shows colours (https://no-color.org)."""
    if os.environ.get('NO_COLOR') or os.environ.get('TERM') == 'dumb':
        return False
    try:
        return stream is not None and stream.isatty()
    except (AttributeError, ValueError):
        return False


def coloured(text: str, stream: TextIO | None = None) -> str:
    """
    Colour a result for a terminal; the same text for anything else.

    Parameters
    ----------
    text : str
        A verdict in its first line, then rows that end in a status.
    stream : file, optional
        Where it will be printed; standard output by default.

    """
    if not wants_colour(sys.stdout if stream is None else stream):
        return text
    first, *rest = text.split('\n')
    tone = (_RED if first.startswith('Not calibrated') else
            _AMBER if first.startswith('A hint') else '')
    return '\n'.join([f'{_BOLD}{tone}{first}{_RESET}', *map(_row, rest)])


def complaint(command: str, sentence: str) -> str:
    """Return an error as one line for standard error."""
    name = f'{command}:'
    if wants_colour(sys.stderr):
        name = f'{_RED}{name}{_RESET}'
    return f'{name} {sentence}'


def _row(line: str) -> str:
    """Colour the status at the end of a row."""
    # the longer phrase first: 'not calibrated' ends in 'calibrated'
    for pattern, colour in reversed(_WORDS):
        found = pattern.search(line)
        if found:
            return f'{line[:found.start()]}{colour}{found.group()}{_RESET}'
    return line
