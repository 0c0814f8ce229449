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
Known objects: what they are called, where their points are, and how they are found in an image.

| text | object |
|---|---|
| chessboard:COLSxROWS:SQUARE_M | inner corners, row by row |
| aprilgrid:COLSxROWS:TAG_M:SPACING | four corners a tag; SPACING as a share of TAG_M |
| circles:COLSxROWS:SPACING_M | circles in square rows, row by row |
| acircles:COLSxROWS:SPACING_M | circles in staggered rows, SPACING_M between rows |
| charuco:COLSxROWS:SQUARE_M:MARKER_M[:DICTIONARY] | inner corners, row by row |
| tsai:COLSxROWS:SQUARE_M:GAP_M:MARGIN_M | two orthogonal planes of dark squares |
| points.csv | columns point,X,Y,Z: any points, found elsewhere |
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
import math
import os
from pathlib import Path

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.features.aprilgrid import AprilGrid
from selfcal_ros.features.charuco import Charuco
from selfcal_ros.features.chessboard import Chessboard
from selfcal_ros.features.circles_grid import CirclesGrid
from selfcal_ros.features.tsai_grid import TsaiGrid
from selfcal_ros.values.known_object import KnownObject

_SHAPES = ('chessboard:COLSxROWS:SQUARE_M, charuco:COLSxROWS:SQUARE_M:MARKER_M, '
           'aprilgrid:COLSxROWS:TAG_M:SPACING, circles:COLSxROWS:SPACING_M, '
           'acircles:COLSxROWS:SPACING_M, tsai:COLSxROWS:SQUARE_M:GAP_M:MARGIN_M or a '
           'points.csv (columns point,X,Y,Z)')
#: A point file beyond this is no list of an object's points.
MAX_POINTS = 1_000_000


@dataclass(frozen=True)
class PointList:
    """Points that are found elsewhere: the input must be a table of their tracks."""

    known: KnownObject


#: What can be found in an image.
Board = Chessboard | Charuco | AprilGrid | CirclesGrid | TsaiGrid
Target = Board | PointList


def parse_target(text: str) -> Target:
    """
    Understand what `--object` names.

    Parameters
    ----------
    text : str
        See the table above.

    Returns
    -------
    Chessboard, Charuco, AprilGrid, CirclesGrid, TsaiGrid or PointList

    Raises
    ------
    ArgumentError
        If the text is of no known form, or a number is impossible.
    InputError
        If the point file is wrong.

    """
    kind, colon, rest = text.partition(':')
    kind = kind.lower()
    lengths = {'chessboard': 1, 'charuco': 2, 'aprilgrid': 2, 'circles': 1, 'acircles': 1,
               'tsai': 3}
    if not colon or kind not in lengths:
        if text.lower().endswith('.csv'):
            return PointList(read_points(text))
        raise ArgumentError(f'The object {text!r:.80} is unknown; expected {_SHAPES}.')
    first, *numbers = rest.split(':')
    across, cross, down = first.lower().partition('x')
    dictionary = numbers.pop() if kind == 'charuco' and len(numbers) == 3 else ''
    try:
        columns, rows = int(across), int(down)
        values = [float(number) for number in numbers]
    except ValueError:
        columns, rows, values = 0, 0, []
    if not cross or len(values) != lengths[kind]:
        raise ArgumentError(f'The object {text!r:.80} is not of the form {_form(kind)}.')
    if not (1 <= columns <= 1000 and 1 <= rows <= 1000):
        raise ArgumentError(f'{columns} x {rows} is no size of a {kind}; give 1 to 1000 columns '
                            'and rows.')
    if not all(math.isfinite(value) and value > 0 for value in values):
        raise ArgumentError(f'The lengths in {text!r:.80} must be positive, in metres.')
    if kind == 'chessboard':
        return Chessboard(columns, rows, values[0])
    if kind == 'charuco':
        return Charuco(columns, rows, values[0], values[1], dictionary)
    if kind == 'aprilgrid':
        return AprilGrid(columns, rows, values[0], values[1])
    if kind in ('circles', 'acircles'):
        return CirclesGrid(columns, rows, values[0], staggered=kind == 'acircles')
    return TsaiGrid(columns, rows, values[0], values[1], values[2])


def _form(kind: str) -> str:
    return next(form for form in _SHAPES.replace(' or ', ', ').split(', ')
                if form.startswith(kind))


def read_points(path: str | os.PathLike[str]) -> KnownObject:
    """
    Read a CSV file with the columns point, X, Y, Z.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    KnownObject

    Raises
    ------
    InputError
        If the file is missing, or a row is wrong; the sentence names the line.

    """
    path = Path(path)
    identity, points = [], []
    try:
        with path.open(newline='', encoding='utf-8-sig', errors='replace') as stream:
            reader = csv.reader(stream)
            header = [name.strip().lower() for name in next(reader, [])]
            if header[:4] != ['point', 'x', 'y', 'z']:
                raise InputError(f'{path} must start with the columns point,X,Y,Z, '
                                 f'not {",".join(header)[:80]!r}.')
            for row in reader:
                if not row:
                    continue
                try:
                    number, place = int(row[0]), [float(value) for value in row[1:4]]
                except (ValueError, IndexError):
                    place = []
                if len(place) != 3 or not all(map(math.isfinite, place)) or (
                        abs(number) >= 2**62):
                    raise InputError(f'{path}, line {reader.line_num}: expected point,X,Y,Z as '
                                     'an integer and three finite numbers, '
                                     f'not {",".join(row)[:80]!r}.')
                identity.append(number)
                points.append(place)
                if len(points) > MAX_POINTS:
                    raise InputError(f'{path} holds more than {MAX_POINTS} points; is it the '
                                     "file of the object's points?")
    except OSError as error:
        raise InputError(f'{path} cannot be read: {error.strerror}.') from None
    except csv.Error as error:
        raise InputError(f'{path} is no CSV file ({error}).') from None
    if not points:
        raise InputError(f'{path} holds no points.')
    try:
        return KnownObject(identity, points)
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
