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
Make the man page docs/selfcal.1 from the parsers of the command line.

Run this from the root of the repository after changing an option; a test compares.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from selfcal_ros.cli.main import build_parser, VERBS
from selfcal_ros.version import SOFTWARE

PAGE = Path(__file__).with_name('selfcal.1')
#: Options that every verb has; they stand in one place.
COMMON = ('-h', '-v')
BEGINNING = r"""
.SH NAME
selfcal \- calibrate a camera from what it sees while it moves
.SH SYNOPSIS
.B selfcal
.I COMMAND
.RI [ ARGUMENTS ]
.br
.B selfcal
.I COMMAND
.B \-\-help
.SH DESCRIPTION
A recording of a camera that moves goes in.
Out comes a calibrated camera with the uncertainty of every parameter, or a sentence that says
which motion is missing.
No target and no ROS are needed.
Where the package was built with colcon, the command is
.BR "ros2 run selfcal_ros selfcal" .
"""
ENDING = r"""
.SH EXIT STATUS
.TP
.B 0
Done.
.TP
.B 1
The data do not suffice to calibrate or to track, or for a file that was asked for, and a sentence
says why; or calibrations differ by more than
.BR \-\-sigmas .
.TP
.B 2
The input or the arguments are wrong, and a sentence says what to do.
.TP
.B 70
A fault of the program.
.SH EXAMPLES
.nf
selfcal calibrate drive.mcap \-\-topic /camera/image_raw \-\-report report.html
selfcal compare old.yaml new.yaml \-\-sigmas 4 \-\-picture difference.png
selfcal convert camera.yaml camera.xml
.fi
.SH SEE ALSO
.BR man (1)
does not have the documents: they lie in the folder docs of the repository, beginning with its
README.md.
"""


def page() -> str:
    """Return the text of the man page."""
    lines = [r'.\" Made by docs/make_man.py from the parsers of the command line.',
             f'.TH SELFCAL 1 "" "{SOFTWARE}" "User Commands"',
             BEGINNING.strip(), '.SH OPTIONS OF EVERY COMMAND']
    parsers = {verb: _parser_of(verb) for verb in VERBS}
    first = next(iter(parsers.values()))
    for action in first._actions:
        if action.option_strings and action.option_strings[0] in COMMON:
            lines += _option(action)
    lines += ['.SH COMMANDS']
    for verb, parser in parsers.items():
        lines += [f'.SS selfcal {verb}', _plain(f'{VERBS[verb].capitalize()}.')]
        for group in parser._action_groups:
            shown = [action for action in group._group_actions if _is_shown(action)]
            if not shown:
                continue
            if group.title not in ('positional arguments', 'options'):
                lines += ['.PP', rf'.I "{_plain(str(group.title))}"']
                lines += ['.br', _plain(group.description)] if group.description else []
            for action in shown:
                lines += _option(action)
    return '\n'.join([*lines, ENDING.strip()]) + '\n'


def _parser_of(verb: str) -> argparse.ArgumentParser:
    """Return the parser of a verb, with its arguments."""
    return next(action.choices[verb] for action in build_parser(verb)._actions
                if isinstance(action, argparse._SubParsersAction))


def _is_shown(action: argparse.Action) -> bool:
    common = bool(action.option_strings) and action.option_strings[0] in COMMON
    return action.help != argparse.SUPPRESS and not common


def _option(action: argparse.Action) -> Iterator[str]:
    """Yield the entry of an option or of an argument."""
    values = ' '.join(rf'\fI{_plain(name)}\fR' for name in _values(action))
    names = ', '.join(rf'\fB{_plain(name)}\fR' for name in action.option_strings)
    yield '.TP'
    yield f'{names} {values}'.strip() if names else values
    text = (action.help or '') % {**vars(action), 'prog': 'selfcal'}
    yield _plain(text[:1].upper() + text[1:] + '.')


def _values(action: argparse.Action) -> Iterator[str]:
    """Yield the names of the values that follow an option."""
    if action.nargs == 0:
        return
    named = action.metavar
    if named is None:
        named = ('{' + ','.join(map(str, action.choices)) + '}' if action.choices else
                 action.dest.upper())
    names = list(named) if isinstance(named, tuple) else [named] * (
        action.nargs if isinstance(action.nargs, int) else 1)
    if action.nargs == '?':
        names = [f'[{name}]' for name in names]
    yield from names
    if action.nargs in ('+', '*'):
        yield '...'


def _plain(text: str) -> str:
    """Escape what roff would take for its own, and what is beyond ASCII."""
    text = text.replace('\\', r'\e').replace('-', r'\-')
    text = ''.join(c if ord(c) < 128 else rf'\[u{ord(c):04X}]' for c in ' '.join(text.split()))
    return rf'\&{text}' if text[:1] in ('.', "'") else text


if __name__ == '__main__':
    PAGE.write_text(page(), encoding='utf-8')
