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
"""A phrase of the tables of words, and how values are put into it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from string import Formatter
from typing import Any


@dataclass(frozen=True)
class Phrase:
    """
    The words of one kind of finding.

    Attributes
    ----------
    sentence : str
        What is said, with the names of values in braces.
    means : str
        What lies behind it, for the page of troubleshooting.
    advice : str
        What to do; a refusal says it after its sentence.

    """

    sentence: str
    means: str
    advice: str


class _Words(Formatter):
    """
    Formats as `str.format` does, and knows lists and some endings.

    Specifications of its own: `one|many` (the first word where the number is one, else the
    second), `percent` (a fraction, without decimals), `plural` (an s unless the number is one),
    `number` (a small one as a word), `times` (a factor; what is more than 1 is never said to be
    1.0), `and`, `axes`, `or_state` (facts that would help), `frames`, `names` (of files, say),
    `motion` (a key of `MOTIONS`), `sigmas` (what would be reached), `measured` (a value with its
    sigma), `later` (a time, or a share of one), `changes` (several, by name), `preferred` (values
    in place of those stated), `clause` (another finding, without its full stop).
    """

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        return kwargs[str(key)]

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec in _ENDINGS:
            return _ENDINGS[format_spec](value)
        if '|' in format_spec:
            one, many = format_spec.split('|')
            return one if value == 1 else many
        if format_spec.endswith('%') and value is not None:
            return f'{100 * value:{format_spec[:-1]}f} %'
        if isinstance(value, (list, tuple)):
            return ', '.join(str(one).replace('_', ' ') for one in value)
        return 'unknown' if value is None else format(value, format_spec)


def _frames(frames: Sequence[int]) -> str:
    """Name up to five frames."""
    named = ', '.join(str(frame) for frame in frames[:5])
    return f'{"frame" if len(frames) == 1 else "frames"} {named}' + (
        ' and others' if len(frames) > 5 else '')


def _names(names: Sequence[str]) -> str:
    """Name up to six things as they are called."""
    more = len(names) - 6
    return ', '.join(names[:6]) + (f' and {more} more' if more > 0 else '')


def _digits(sigma: float) -> int:
    """Return the decimals up to the second digit of a sigma."""
    return min(max(1 - math.floor(math.log10(sigma)), 0), 6) if sigma > 0 else 2


def _measured(measured: Mapping[str, Any]) -> str:
    """Write a value and its sigma with the digits that the sigma leaves."""
    digits = _digits(measured['sigma'])
    return f'{measured["value"]:.{digits}f} ± {measured["sigma"]:.{digits}f}'


def _later(apart: Mapping[str, Any]) -> str:
    """Write how much later something was: a share of an interval, whose seconds may be known."""
    size, seconds = abs(apart['share']), apart['interval_s']
    return ((f'{100 * size:.2g} % of the time between two instants' if seconds is None
             else f'{1e3 * size * seconds:.2g} ms')
            + (' later' if apart['share'] > 0 else ' earlier'))


def _changes(changes: Sequence[Mapping[str, Any]]) -> str:
    """Name what changed, by how much, and how surely."""
    return ', '.join(f'{one["name"]} {one["value"]:+.{_digits(one["sigma"])}f} ± '
                     f'{one["sigma"]:.{_digits(one["sigma"])}f} {one["unit"]}' for one in changes)


def _preferred(preferred: Sequence[Mapping[str, Any]]) -> str:
    """Write what the images prefer, with the digits that the sigmas leave, and what was stated."""
    return ', '.join(f'{one["name"]} = {one["value"]} in place of {one["stated"]}'
                     if isinstance(one['value'], str) else
                     f'{one["name"]} = {_measured(one)} in place of {one["stated"]:g}'
                     for one in preferred)


#: Motions that are suggested, in words that fit after 'in which you'.
MOTIONS = {
    's_20': 'drive an S, 20 degrees to the left and to the right',
    's_45': 'drive an S, 45 degrees to the left and to the right',
    'curve_60': 'drive one curve of 60 degrees',
    'straight_near': 'drive straight on, past structure at a third of the distance',
    's_20_near': 'drive an S, 20 degrees to each side, past structure at a third of the distance',
    'pitch': 'turn 20 degrees up and down',
    'yaw': 'turn 20 degrees to the left and to the right',
    'roll': 'roll 20 degrees about the optical axis',
    'pitch_yaw': 'turn 20 degrees up and down, then to the left and to the right',
    'pitch_roll': 'turn 20 degrees up and down, then roll as much',
    'translation': 'move without turning',
}
_NUMBERS = ('no', 'one', 'two', 'three', 'four', 'five')
_ENDINGS: dict[str, Callable[[Any], str]] = {
    'percent': lambda share: f'{100 * share:.0f}',
    'plural': lambda count: '' if count == 1 else 's',
    'number': lambda count: _NUMBERS[count],
    'and': lambda names: ' and '.join(str(name).replace('_', ' ') for name in names),
    'motion': MOTIONS.__getitem__,
    'axes': lambda axes: ' and about '.join(f'the {axis} axis' for axis in axes),
    'or_state': lambda helps: f', or state the {" or the ".join(helps)}' if helps else '',
    'frames': _frames,
    'names': _names,
    'times': lambda ratio: f'{ratio:.1f}' if ratio >= 1.05 else f'{ratio:.2f}',
    'sigmas': lambda sigma: ', '.join(f'{name} to ± {value:.2g}'
                                      for name, value in sigma.items()),
    'measured': _measured,
    'later': _later,
    'changes': _changes,
    'preferred': _preferred,
    'clause': lambda finding: finding.clause,
}
_WORDS = _Words()


def put_in_words(text: str, values: Mapping[str, Any]) -> str:
    """Put values into a sentence of a table."""
    return _WORDS.vformat(text, (), values)
