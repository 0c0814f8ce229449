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
Poses of a body from a table (CSV), whose header names the columns.

When: `stamp_ns` (or `stamp_s`), `frame` (number of the image, from 0), or `image` (file name).
Where: `tx,ty,tz` in metres with `qw,qx,qy,qz`, with a rotation vector `rx,ry,rz` in radians, or
with a matrix `r11` to `r33`; or `x,y,theta` of a robot on the floor, which is odometry.
"""

from __future__ import annotations

import csv
from pathlib import Path
import re

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.robot.pose_checks import in_order, UNIT_LENGTH
from selfcal_ros.pipeline.robot.rate_topics import COLUMNS
from selfcal_ros.values.angular_rates import AngularRates
from selfcal_ros.values.body_poses import ABSOLUTE, BodyPoses, ODOMETRY
from selfcal_ros.values.foreign_files import read_limited

#: No table of poses is larger: an hour at 200 Hz takes a tenth.
MAX_BYTES = 1 << 29
PLACE = ('tx', 'ty', 'tz')
QUATERNION, VECTOR = ('qw', 'qx', 'qy', 'qz'), ('rx', 'ry', 'rz')
MATRIX = tuple(f'r{i}{j}' for i in (1, 2, 3) for j in (1, 2, 3))
PLANAR = ('x', 'y', 'theta')
WHEN = ('image', 'stamp_ns', 'stamp_s', 'frame')
#: A number whose decimals follow a comma.
_DECIMAL_COMMA = re.compile(r'^(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)$')
#: A longer rotation vector is in degrees.
LONGEST_VECTOR_RAD = 2.5 * np.pi
EXPECTED = ('stamp_ns, frame or image; then tx,ty,tz with qw,qx,qy,qz or rx,ry,rz (radians), or '
            'x,y,theta; or of a gyro gyro_x,gyro_y,gyro_z (rad/s)')


def read_pose_table(path: str | Path, images: list[str] | None = None, by_stamp: bool = False,
                    ) -> BodyPoses | AngularRates:
    """
    Read a table of poses, or of the rates of a gyro.

    Parameters
    ----------
    path : str or Path
    images : list of str, optional
        File names of the images, in the order of their frames; needed for the column image.
    by_stamp : bool
        Of two columns, the stamp is taken rather than the frame.

    Returns
    -------
    BodyPoses or AngularRates

    Raises
    ------
    InputError
        If the table is no such table; the sentence names the line.

    """
    path = Path(path)
    names, rows = _cells(path)
    when = _column_of_time(path, names, images, by_stamp)
    numbers = _numbers(path, names, rows)
    if COLUMNS[0] in numbers:
        instants, _ = _instants(path, names, rows, when)
        if instants is None:
            raise InputError(f'{path} gives rates by frame; a gyro needs stamp_ns or stamp_s.')
        return AngularRates(instants, np.column_stack([numbers[name] for name in COLUMNS]))
    line = np.arange(2, len(rows) + 2)
    stamps: np.ndarray | None = None
    frames: np.ndarray | None = None
    if when == 'image':
        found, known = _frames_of(path, [row[names.index('image')] for row in rows], images or [])
        order = np.argsort(found, kind='stable')
        frames = found[order]
        numbers = {name: column[known][order] for name, column in numbers.items()}
        line = line[known][order]
        if (np.diff(frames) == 0).any():
            twice = (images or [])[frames[int(np.argmax(np.diff(frames) == 0))]]
            raise InputError(f'{path} has two poses of the image {twice}; keep one of them.')
    else:
        stamps, frames = _instants(path, names, rows, when)
    rotation, position, kind = _poses(path, numbers, line)
    return BodyPoses(rotation, position, stamps, frames, kind)


def _cells(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the names of the columns, and the rows."""
    text = read_limited(path, MAX_BYTES, 'The table of poses').decode('utf-8-sig', 'replace')
    try:
        head = next((line for line in text.splitlines() if line.strip()), '')
        # spreadsheets of half of Europe part cells by semicolons
        parted_by = max(',;\t', key=head.count)
        lines = [row for row in csv.reader(text.splitlines(), delimiter=parted_by)
                 if any(cell.strip() for cell in row)]
        if parted_by != ',':
            # and write decimal commas
            lines[1:] = [[_DECIMAL_COMMA.sub(r'\1.\2', cell) for cell in row]
                         for row in lines[1:]]
    except csv.Error as error:
        raise InputError(f'{path} is no CSV file ({error}).') from None
    if len(lines) < 3:
        raise InputError(f'{path} needs a header and two poses at least.')
    names = [name.strip().lower().lstrip('#').strip() for name in lines[0]]
    if len(set(names)) < len(names):
        raise InputError(f'{path} names a column twice.')
    for k, row in enumerate(lines[1:], 2):
        if len(row) != len(names):
            raise InputError(f'{path}, line {k} has {len(row)} cells, and the header '
                             f'{len(names)}; write a cell a column, and decimal points where '
                             'commas part the cells.')
    return names, lines[1:]


def _column_of_time(path: str | Path, names: list[str], images: list[str] | None, by_stamp: bool,
                    ) -> str:
    """Choose the column that says when."""
    there = [name for name in WHEN if name in names and (name != 'image' or images)]
    if not there:
        if 'image' in names:
            raise InputError(f'{path} names images, and INPUT is no folder of images; give a '
                             'column stamp_ns or frame.')
        raise InputError(f'{path} does not say when a pose was: it has the columns '
                         f'{", ".join(names[:20])}; needed are {EXPECTED}.')
    if 'frame' in there and not by_stamp and there[0] != 'image':
        return 'frame'
    return there[0]


def _numbers(path: str | Path, names: list[str], rows: list[list[str]]) -> dict[str, np.ndarray]:
    """Return the columns of the poses."""
    for wanted in ((*PLACE, *QUATERNION), (*PLACE, *VECTOR), (*PLACE, *MATRIX), PLANAR, COLUMNS):
        if set(wanted) <= set(names):
            break
    else:
        raise InputError(f'{path} has the columns {", ".join(names[:20])}; needed are {EXPECTED}.')
    found = {}
    for name in wanted:
        cells = [row[names.index(name)] for row in rows]
        try:
            column = np.array(cells, float)
        except ValueError:
            bad = next(k for k, cell in enumerate(cells) if not _is_number(cell))
            raise InputError(f'{path}, line {bad + 2}: {name} is {cells[bad]!r:.30}, no number.'
                             ) from None
        if not np.isfinite(column).all():
            bad = int(np.argmin(np.isfinite(column)))
            raise InputError(f'{path}, line {bad + 2}: {name} is not finite; remove the line.')
        found[name] = column
    return found


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _frames_of(path: str | Path, cells: list[str], images: list[str],
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return the frames of named images, and which rows have one."""
    place = {name: k for k, name in enumerate(images)}
    place |= {Path(name).stem: k for k, name in enumerate(images)}
    found = np.array([place.get(Path(cell.strip()).name, place.get(Path(cell.strip()).stem, -1))
                      for cell in cells])
    if not (found >= 0).any():
        raise InputError(f'{path} names no image of INPUT: it has {cells[0].strip()}, and INPUT '
                         f'has {images[0]}.')
    return found[found >= 0], np.flatnonzero(found >= 0)


def _instants(path: str | Path, names: list[str], rows: list[list[str]], when: str,
              ) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return stamps or frames, in the order of the table."""
    cells = [row[names.index(when)].strip() for row in rows]
    try:
        if when == 'stamp_s':
            # digits as they are: a double holds no nanoseconds of today
            values = np.array([_nanoseconds(cell) for cell in cells], np.int64)
        else:
            values = np.array([int(cell) for cell in cells], np.int64)
    except (ValueError, OverflowError):
        wanted = {'stamp_s': 'seconds', 'stamp_ns': 'whole nanoseconds (of seconds, name the '
                  'column stamp_s)'}.get(when, 'whole numbers')
        raise InputError(f'{path}: {when} must be {wanted}; {cells[0]!r:.40} is the first.'
                         ) from None
    in_order(values, when, str(path))
    return (None, values) if when == 'frame' else (values, None)


def _nanoseconds(cell: str) -> int:
    from decimal import Decimal, InvalidOperation
    try:
        return int((Decimal(cell) * 10**9).to_integral_value())
    except InvalidOperation:
        raise ValueError(cell) from None


def _poses(path: str | Path, numbers: dict[str, np.ndarray], line: np.ndarray,
           ) -> tuple[np.ndarray, np.ndarray, str]:
    """Return rotations, positions and kind."""
    if 'theta' in numbers:
        x, y, theta = (numbers[name] for name in PLANAR)
        return (Rotation.from_euler('z', theta[:, None]).as_matrix(),
                np.column_stack([x, y, np.zeros_like(x)]), ODOMETRY)
    position = np.column_stack([numbers[name] for name in PLACE])
    if 'qw' in numbers:
        wxyz = np.column_stack([numbers[name] for name in QUATERNION])
        length = np.linalg.norm(wxyz, axis=1)
        wrong = np.abs(length - 1) > UNIT_LENGTH
        if wrong.any():
            bad = int(np.argmax(wrong))
            raise InputError(f'{path}, line {line[bad]}: the quaternion has the length '
                             f'{length[bad]:.3g} instead of 1; correct how it was written.')
        return Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).as_matrix(), position, ABSOLUTE
    if 'r11' in numbers:
        matrices = np.column_stack([numbers[name] for name in MATRIX]).reshape(-1, 3, 3)
        return _rotations(path, matrices, line), position, ABSOLUTE
    vectors = np.column_stack([numbers[name] for name in VECTOR])
    longest = int(np.argmax(np.linalg.norm(vectors, axis=1)))
    if np.linalg.norm(vectors[longest]) > LONGEST_VECTOR_RAD:
        raise InputError(f'{path}, line {line[longest]}: rx,ry,rz is a rotation vector of '
                         f'{np.linalg.norm(vectors[longest]):.3g} rad, more than a turn; if it '
                         'is in degrees, convert it to radians.')
    return Rotation.from_rotvec(vectors).as_matrix(), position, ABSOLUTE


def _rotations(path: str | Path, matrices: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Make matrices orthogonal that are so but for their digits."""
    left = np.linalg.det(matrices) < 0
    if left.any():
        raise InputError(f'{path}, line {line[int(np.argmax(left))]}: the matrix is left-handed; '
                         'turn the sign of one axis, so that x forward, y left and z up are a '
                         'right-handed frame.')
    defect = np.abs(matrices @ np.swapaxes(matrices, 1, 2) - np.eye(3)).max(axis=(1, 2))
    if (defect > UNIT_LENGTH).any():
        raise InputError(f'{path}, line {line[int(np.argmax(defect > UNIT_LENGTH))]}: the matrix '
                         'is no rotation; correct how it was written.')
    nearest: np.ndarray = Rotation.from_matrix(matrices).as_matrix()
    return nearest
