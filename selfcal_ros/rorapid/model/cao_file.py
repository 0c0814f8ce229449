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
ViSP's ``.cao`` model files, all of their grammar.

A file is a version line, any number of ``load("other.cao", t=[x; y; z], tu=[a; b; c deg])``, and
six lists, each a count and as many records: points, lines, faces from lines, faces from points,
cylinders, circles. The last two may be missing, and all six after a ``load``. What follows
a record on its line are parameters (``name=``, ``minLineLengthThreshold=``,
``minPolygonAreaThreshold=``, ``useLod=``) or a remark in any form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import math
from pathlib import Path
import re
from typing import TypeVar

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.model.text_file import LARGEST_FILE_BYTES, read_text
from selfcal_ros.values.wireframe import (Conic, Cylinder, FACE_LIMIT, LIMIT, Polygon,
                                          WireframeModel)

#: No model may consist of more files, of more bytes all together, or load files so deep.
MAX_FILES, MAX_TOTAL, MAX_DEPTH = 1_000, LARGEST_FILE_BYTES, 50
#: ViSP's thresholds where ``useLod`` is on and none is given.
DEFAULT_LINE_LENGTH_PX = 50.0
DEFAULT_POLYGON_AREA_PX2 = 2500.0

_WORD = re.compile(r'[^\s,;#]+')
_PARAMETER = re.compile(r'\s*(name|minLineLengthThresh(?:old)?|minPolygonAreaThresh(?:old)?'
                        r'|useLod)\s*=\s*(?:"([^"]*)"|([^\s"#]*))')
_LOAD = re.compile(r'[lL]oad\s*\(\s*"([^"]+)"\s*((?:,\s*\w+\s*=\s*\[[^\]]*\]\s*)*)\)')
_ARGUMENT = re.compile(r',\s*(\w+)\s*=\s*\[([^\]]*)\]')

#: Of a record: whole numbers or others.
_Number = TypeVar('_Number', int, float)


@dataclass
class _Parts:
    """What the files read so far hold, in the frame of the outermost one."""

    vertices: list[np.ndarray] = field(default_factory=list)
    lines: list[tuple[int, int]] = field(default_factory=list)
    line_names: list[str] = field(default_factory=list)
    line_min_length_px: list[float] = field(default_factory=list)
    faces: list[Polygon] = field(default_factory=list)
    conics: list[Conic] = field(default_factory=list)
    cylinders: list[Cylinder] = field(default_factory=list)
    files: int = 0
    characters: int = 0


def read_cao(path: str | Path) -> WireframeModel:
    """
    Read a ``.cao`` file and all that it loads.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    WireframeModel
        Lines are those of the file and the borders of its faces. Loaded files are placed by
        their transforms: X' = R X + t.

    Raises
    ------
    InputError
        If a file cannot be read, or holds something that cannot be; the sentence names the
        file and the line.

    """
    path = Path(path)
    parts = _Parts()
    _read(path, np.eye(3), np.zeros(3), parts, ())
    try:
        return WireframeModel.build(
            np.array(parts.vertices), parts.lines, parts.faces, parts.line_names,
            parts.line_min_length_px, conics=parts.conics, cylinders=parts.cylinders,
            name=path.stem)
    except ArgumentError as error:
        raise InputError(f'{path} cannot be used: {error}') from None


class _Reader:
    """The records of one file, one after the other."""

    def __init__(self, path: Path) -> None:
        """Split the file into lines; comments and empty lines are passed over."""
        self.path = path
        text = read_text(path)
        self.length = len(text)
        self._lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1)
                       if line.strip() and not line.lstrip().startswith('#')]
        self._next = 0
        self.number = 1

    def fail(self, what: str) -> InputError:
        """Return an error that names the line read last."""
        return InputError(f'{self.path}, line {self.number}: {what}')

    def at_end(self) -> bool:
        """Tell whether all lines are read."""
        return self._next >= len(self._lines)

    def peek(self) -> str:
        """Return the next line without taking it."""
        return self._lines[self._next][1].strip()

    def line(self, what: str) -> str:
        """Take a line."""
        if self.at_end():
            raise self.fail(f'the file ends where {what} should come.')
        self.number, line = self._lines[self._next]
        self._next += 1
        return line

    def numbers(self, count: int, what: str, kind: Callable[[str], _Number], rest: str = '',
                ) -> tuple[list[_Number], str]:
        """
        Take `count` numbers, from more than one line where needed, starting in `rest`.

        Returns the numbers and what is left of the last line.
        """
        values: list[_Number] = []
        while len(values) < count:
            if not rest.strip() or rest.lstrip().startswith('#'):
                rest = self.line(what)
            word = _WORD.search(rest)
            if word is None:
                raise self.fail(f'{what} should come here, not {rest.strip()[:40]!r}.')
            values.append(self._number(word.group(), what, kind))
            rest = rest[word.end():]
        return values, rest

    def _number(self, word: str, what: str, kind: Callable[[str], _Number]) -> _Number:
        try:
            value = kind(word)
        except ValueError:
            raise self.fail(f'{what} should come here, not {word[:40]!r}.') from None
        if not math.isfinite(value):
            raise self.fail(f'{word[:40]!r} is no finite number.')
        return value

    def count(self, what: str) -> int:
        """Take the length of a list."""
        (count,), _ = self.numbers(1, f'the number of {what}', int)
        if not 0 <= count <= LIMIT:
            raise self.fail(f'{count} {what} are no sensible number; at most {LIMIT} may be.')
        return count

    def parameters(self, rest: str) -> dict[str, str]:
        """Read the parameters behind a record; anything else there is a remark."""
        found: dict[str, str] = {}
        at = 0
        while match := _PARAMETER.match(rest, at):
            key, quoted, plain = match.groups()
            key = key if key.endswith(('name', 'Lod', 'old')) else key + 'old'
            found[key] = quoted if quoted is not None else plain
            at = match.end()
        return found

    def threshold(self, parameters: dict[str, str], key: str, default: float) -> float:
        """Return the level-of-detail threshold of a record: 0 where ``useLod`` is not on."""
        if parameters.get('useLod', '').lower() not in ('true', '1'):
            return 0.0
        value = self._number(parameters.get(key, str(default)), f'{key}=', float)
        if value < 0:
            raise self.fail(f'{key} must not be negative.')
        return value


def _read(path: Path, rotation: np.ndarray, translation: np.ndarray, parts: _Parts,
          above: tuple[Path, ...]) -> None:
    """Add one file, placed by a rotation and a translation, to `parts`."""
    try:
        real = path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f'The model {str(path)[:200]!r} cannot be read: {error}.') from None
    if real in above:
        raise InputError(f'{above[-1]} loads {path}, which loads it in turn.')
    parts.files += 1
    if parts.files > MAX_FILES or len(above) > MAX_DEPTH:
        raise InputError(f'{path} is one model file too many; a model may consist of at most '
                         f'{MAX_FILES}, which load each other {MAX_DEPTH} deep.')
    reader = _Reader(path)
    parts.characters += reader.length
    if parts.characters > MAX_TOTAL:
        raise InputError(f'{path} makes the model longer than {MAX_TOTAL} characters.')
    version = re.match(r'\s*V(\d+)', reader.line('the version'))
    if version is None:
        raise reader.fail('a .cao file begins with its version, V1.')
    loaded = False
    while not reader.at_end() and reader.peek()[:4].lower() == 'load':
        inner, R, t = _load_arguments(reader)
        _read(path.parent / inner, rotation @ R, rotation @ t + translation, parts,
              above + (real,))
        loaded = True
    if not (loaded and reader.at_end()):
        _read_lists(reader, int(version.group(1)), rotation, translation, parts)


def _load_arguments(reader: _Reader) -> tuple[str, np.ndarray, np.ndarray]:
    """Take a ``load`` line: the file, and the rotation and translation that place it."""
    match = _LOAD.match(reader.line('a load').strip())
    if match is None:
        raise reader.fail('this is not of the form load("file.cao", t=[x; y; z], '
                          'tu=[a; b; c deg]).')
    R, t = np.eye(3), np.zeros(3)
    for key, text in _ARGUMENT.findall(match.group(2)):
        values = [_angle(reader, word) for word in re.split(r'[;,]', text)]
        if key == 't' and len(values) == 3:
            t = np.array(values)
        elif key == 'tu' and len(values) == 3:
            R = rotation_matrix(np.array(values))
        elif key == 'R' and len(values) == 9:
            R = np.array(values).reshape(3, 3)
            if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
                raise reader.fail('R=[...] is no rotation matrix.')
        else:
            raise reader.fail(f'{key}=[{text[:60]}] cannot be read; t and tu take three numbers, '
                              'R takes nine.')
    return match.group(1), R, t


def _angle(reader: _Reader, word: str) -> float:
    """Return a number, in radians where it says that it is in degrees."""
    word = word.strip()
    unit = next((unit for unit in ('deg', 'rad') if word.endswith(unit)), '')
    value = reader._number(word.removesuffix(unit).rstrip(), 'a number', float)
    return math.radians(value) if unit == 'deg' else value


def _read_lists(reader: _Reader, version: int, rotation: np.ndarray, translation: np.ndarray,
                parts: _Parts) -> None:
    """Take the six lists of one file."""
    first = len(parts.vertices)
    own: list[np.ndarray] = []
    for _ in range(reader.count('points')):
        # version 2 has the point's place in an image behind it, which is of no use here
        xyz, rest = reader.numbers(3, 'three coordinates', float)
        if version == 2:
            reader.numbers(2, 'two image coordinates', float, rest)
        if max(map(abs, xyz)) >= 1e6:
            raise reader.fail('coordinates are metres; a million of them is too far.')
        own.append(rotation @ xyz + translation)
    parts.vertices += own

    def point(index: int) -> int:
        if not 0 <= index < len(own):
            raise reader.fail(f'there is no point {index}; the file has {len(own)}, counted '
                              'from 0.')
        return index

    own_lines = []
    for _ in range(reader.count('lines')):
        pair, rest = reader.numbers(2, 'two points of a line', int)
        own_lines.append(_line(reader, parts, own, first, [point(i) for i in pair],
                               reader.parameters(rest)))
    for _ in range(reader.count('faces from lines')):
        (count,), rest = reader.numbers(1, 'the number of lines of a face', int)
        indices, rest = reader.numbers(_face_size(reader, count), 'a line of a face', int, rest)
        if not all(0 <= i < len(own_lines) for i in indices):
            raise reader.fail(f'a face names a line that does not exist; there are '
                              f'{len(own_lines)}, counted from 0.')
        loop = _loop(reader, [own_lines[i] for i in indices])
        parts.faces.append(_face(reader, first, loop, reader.parameters(rest)))
    for _ in range(reader.count('faces from points')):
        (count,), rest = reader.numbers(1, 'the number of points of a face', int)
        indices, rest = reader.numbers(_face_size(reader, count), 'a point of a face', int, rest)
        indices = [point(i) for i in indices]
        parameters = reader.parameters(rest)
        if count == 2:
            _line(reader, parts, own, first, indices, parameters)
        else:
            parts.faces.append(_face(reader, first, indices, parameters))
    if not reader.at_end():
        _read_cylinders(reader, own, point, parts)
    if not reader.at_end():
        _read_circles(reader, own, point, parts)
    if max(len(parts.vertices), len(parts.lines), len(parts.faces)) > LIMIT:
        raise reader.fail(f'a model may have at most {LIMIT} points, lines or faces.')


def _read_cylinders(reader: _Reader, own: list[np.ndarray], point: Callable[[int], int],
                    parts: _Parts) -> None:
    for _ in range(reader.count('cylinders')):
        ends, rest = reader.numbers(2, 'two points of an axis', int)
        (radius,), rest = reader.numbers(1, 'the radius', float, rest)
        parameters = reader.parameters(rest)
        try:
            parts.cylinders.append(Cylinder(
                own[point(ends[0])], own[point(ends[1])], radius, parameters.get('name', ''),
                reader.threshold(parameters, 'minLineLengthThreshold', DEFAULT_LINE_LENGTH_PX)))
        except ArgumentError as error:
            raise reader.fail(str(error)) from None


def _read_circles(reader: _Reader, own: list[np.ndarray], point: Callable[[int], int],
                  parts: _Parts) -> None:
    for _ in range(reader.count('circles')):
        (radius,), rest = reader.numbers(1, 'the radius', float)
        indices, rest = reader.numbers(3, 'three points of a circle', int, rest)
        centre, a, b = (own[point(i)] for i in indices)
        u, v = a - centre, b - centre
        normal = np.cross(u, v)
        size = np.linalg.norm(u) * np.linalg.norm(v)
        if not 0 < radius < 1e6 or not np.linalg.norm(normal) > 1e-6 * size or not size > 0:
            raise reader.fail('a circle needs a positive radius, its centre, and two points '
                              'that span its plane with it.')
        u = u / np.linalg.norm(u)
        v = np.cross(normal / np.linalg.norm(normal), u)
        parts.conics.append(Conic(centre, radius * u, radius * v,
                                  reader.parameters(rest).get('name', '')))


def _line(reader: _Reader, parts: _Parts, own: list[np.ndarray], first: int, pair: list[int],
          parameters: dict[str, str]) -> list[int]:
    """Add a line; returns its two points, numbered within the file."""
    if not np.linalg.norm(own[pair[1]] - own[pair[0]]) > 0:
        raise reader.fail('this line has no length.')
    parts.lines.append((first + pair[0], first + pair[1]))
    parts.line_names.append(parameters.get('name', ''))
    parts.line_min_length_px.append(
        reader.threshold(parameters, 'minLineLengthThreshold', DEFAULT_LINE_LENGTH_PX))
    return pair


def _face(reader: _Reader, first: int, indices: list[int], parameters: dict[str, str]) -> Polygon:
    if len(indices) < 3 or len(set(indices)) != len(indices):
        raise reader.fail('a face needs three points or more, none of them twice.')
    return Polygon(tuple(first + i for i in indices), parameters.get('name', ''),
                   reader.threshold(parameters, 'minPolygonAreaThreshold',
                                    DEFAULT_POLYGON_AREA_PX2))


def _face_size(reader: _Reader, count: int) -> int:
    if not 2 <= count <= FACE_LIMIT:
        raise reader.fail(f'a face of {count} points or lines cannot be; 2 to {FACE_LIMIT} may.')
    return count


def _loop(reader: _Reader, pairs: list[list[int]]) -> list[int]:
    """Join lines, in whatever order and direction, to one closed loop of points."""
    left = [list(pair) for pair in pairs]
    loop = left.pop(0)
    while left:
        following = next((pair for pair in left if loop[-1] in pair), None)
        if following is None:
            break
        left.remove(following)
        loop.append(following[0] if following[1] == loop[-1] else following[1])
    if left or loop[0] != loop.pop():
        raise reader.fail('the lines of this face do not close to one loop.')
    return loop
