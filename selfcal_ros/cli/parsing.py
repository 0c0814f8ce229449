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
"""Arguments that are wrong are answered with one sentence, and with what may have been meant."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import re
from typing import Any, NoReturn

from selfcal_ros.cli.machine_output import STANDARD_OUTPUT
from selfcal_ros.cli.status import EXIT_INPUT


def add_seed_argument(parser: argparse._ActionsContainer) -> None:
    """Add the option --seed to a verb."""
    parser.add_argument('--seed', type=_seed, default=0, metavar='N',
                        help='what is drawn at random, the samples of RANSAC, is drawn from this '
                             'number: the same one gives the same result to the byte (default 0)')


def text(value: str) -> str:
    """
    Take words that messages and files will carry, which hold UTF-8 alone.

    Raises
    ------
    argparse.ArgumentTypeError
        If they hold bytes that are none, or a control character.

    """
    if any(0xd800 <= ord(letter) < 0xe000 or not letter.isprintable() for letter in value):
        raise argparse.ArgumentTypeError(f'{ascii(value):.40} is not plain text')
    return value


def topic_name(value: str) -> str:
    """
    Take the name of a topic to write.

    Raises
    ------
    argparse.ArgumentTypeError
        If ROS does not take it.

    """
    if not re.fullmatch(r'(/?[A-Za-z_][A-Za-z0-9_]*)(/[A-Za-z_][A-Za-z0-9_]*)*', value):
        raise argparse.ArgumentTypeError(f'{ascii(value):.60} is no name of a topic; use letters, '
                                         'digits, _ and /')
    return value


def start_pose(value: str) -> str:
    """
    Take what --init takes, which is a single word.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is the first of six numbers.

    """
    try:
        float(value)
    except ValueError:
        return value
    raise argparse.ArgumentTypeError('the six numbers go in quotes: --init '
                                     '"0.1 0 0.4 2.1 0.8 0.1"')


def _seed(text: str) -> int:
    """Take a whole number that every generator takes."""
    if not text.isdecimal() or len(text) > 10 or int(text) >= 2**32:
        raise argparse.ArgumentTypeError(f'{text!r:.40} is no whole number from 0 to 4294967295')
    return int(text)


def _path(value: str) -> Path:
    """Take a path of a file or folder."""
    if not value:
        raise argparse.ArgumentTypeError("'' is no name of a file or folder")
    return Path(value)


def output_path(value: str) -> Path:
    """Take the name of an output; only --json prints to the standard output."""
    if value == STANDARD_OUTPUT:
        raise argparse.ArgumentTypeError(f'{STANDARD_OUTPUT!r} is for --json alone; name a file, '
                                         f'or ./{STANDARD_OUTPUT} for one of that name')
    return _path(value)


class SentenceParser(argparse.ArgumentParser):
    """An argparse parser that does not print its whole usage for a slip of the finger."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Take no empty path, which pathlib makes the current folder."""
        super().__init__(*args, **kwargs)
        self.register('type', Path, _path)
        # argparse takes -2e-5 for an option before Python 3.14
        self._negative_number_matcher = re.compile(r'^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$')

    # argparse also lets callers give a namespace class of their own, which nobody does here
    def parse_args(self, args: Sequence[str] | None = None,  # type: ignore[override]
                   namespace: argparse.Namespace | None = None) -> argparse.Namespace:
        """Let the verb that was given speak of words that nobody takes."""
        found, rest = self.parse_known_args(args, namespace)
        if rest:
            verb = getattr(found, 'verb', None)
            speaker = next((action.choices[verb] for action in self._actions
                            if isinstance(action.choices, dict) and verb in action.choices), self)
            speaker.error(f'unrecognized arguments: {" ".join(rest)}')
        return found

    def error(self, message: str) -> NoReturn:
        """Say in one sentence what is wrong, and end."""
        from selfcal_ros.cli.colours import complaint
        message = self._in_full(message)
        sentence = f'{message}; {self._meant(message)}{self.prog} --help tells more.'
        self.exit(EXIT_INPUT, complaint(self.prog, sentence) + '\n')

    def _in_full(self, message: str) -> str:
        """Say what argparse says in words of a program, or too briefly, in those of a user."""
        message = re.sub(r"invalid (int|float) value: ('.*')",
                         lambda one: f'{one[2]} is no {"whole " * (one[1] == "int")}number',
                         message, flags=re.DOTALL)
        found = re.match(r'ambiguous option: (\S+?)(?:=.*)? could match (.*)', message, re.DOTALL)
        if not found:
            return message
        takes = {name: f'{name} {action.metavar}' if isinstance(action.metavar, str) else name
                 for action in self._actions for name in action.option_strings}
        named = [takes.get(name, name) for name in sorted(found[2].split(', '))]
        return (f'{found[1]} may be {", ".join(named[:-1])} or {named[-1]}; write the one that '
                'you mean in full')

    def _meant(self, message: str) -> str:
        """Name the word that is closest to a wrong one."""
        from difflib import get_close_matches
        wrong = re.search(r"invalid choice: '([^']*)'|unrecognized arguments: (\S+)", message)
        if not wrong:
            return ''
        word = wrong[2].partition('=')[0] if wrong[1] is None else wrong[1]
        near = get_close_matches(word, self._words(), 1, 0.7)
        return f'did you mean {near[0]}? ' if near else ''

    def _words(self) -> list[str]:
        """List the options and choices of this parser and of the verb that was given."""
        words: list[str] = []
        for action in self._actions:
            words += action.option_strings
            for choice in action.choices or ():
                words.append(str(choice))
                if isinstance(action.choices, dict):
                    words += action.choices[choice]._words()
        return words
