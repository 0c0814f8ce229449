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
| charuco:COLSxROWS:SQUARE_M:MARKER_M[:DICTIONARY] | inner corners, row by row |
| tsai:COLSxROWS:SQUARE_M:GAP_M:MARGIN_M | two orthogonal planes of dark squares |
| points.csv | columns point,X,Y,Z: any points, found elsewhere |
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
import math
from pathlib import Path

import cv2
import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.features.tsai_grid import TsaiGrid
from selfcal_ros.values.known_object import KnownObject

_SHAPES = ('chessboard:COLSxROWS:SQUARE_M, charuco:COLSxROWS:SQUARE_M:MARKER_M, '
           'tsai:COLSxROWS:SQUARE_M:GAP_M:MARGIN_M or a points.csv (columns point,X,Y,Z)')
#: Dictionaries that are tried when none is named; each holds the smaller ones of its size.
DICTIONARIES = ('DICT_4X4_1000', 'DICT_5X5_1000', 'DICT_6X6_1000', 'DICT_7X7_1000',
                'DICT_ARUCO_ORIGINAL', 'DICT_APRILTAG_36h11', 'DICT_APRILTAG_25h9',
                'DICT_APRILTAG_16h5')
#: A point file beyond this is no list of an object's points.
MAX_POINTS = 1_000_000


def _plane(columns: int, rows: int, pitch: float) -> np.ndarray:
    """Corners of a board row by row, z = 0, shape (P, 3)."""
    y, x = np.mgrid[:rows, :columns].reshape(2, -1) * pitch
    return np.column_stack([x, y, np.zeros(x.size)])


@dataclass(frozen=True)
class Chessboard:
    """
    A chessboard of dark and light squares.

    Parameters
    ----------
    columns, rows : int
        Inner corners.
    square_m : float

    """

    columns: int
    rows: int
    square_m: float

    def __post_init__(self):
        """Refuse impossible boards."""
        if min(self.columns, self.rows) < 3:
            raise ArgumentError('A chessboard needs at least 3 x 3 inner corners (one less than '
                                f'squares), not {self.columns} x {self.rows}.')

    @property
    def known(self) -> KnownObject:
        """The corners, numbered row by row from 0."""
        return KnownObject(np.arange(self.columns * self.rows),
                           _plane(self.columns, self.rows, self.square_m))

    def find(self, image: np.ndarray, thorough: bool = True):
        """
        Find all corners in a grey image.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W)
        thorough : bool
            Search longer where a quick look shows no board.

        Returns
        -------
        identity : ndarray of int, shape (n,)
        xy : ndarray, shape (n, 2)
            Pixels; both empty where the board is not seen whole.

        """
        size = (self.columns, self.rows)
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCorners(image, size,
                                                   flags=flags | cv2.CALIB_CB_FAST_CHECK)
        if not found and thorough:
            found, corners = cv2.findChessboardCorners(image, size, flags=flags)
        if not found:
            return _nothing()
        corners = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
        grid = corners.reshape(self.rows, self.columns, 2)
        spacing = min(float(np.linalg.norm(np.diff(grid, axis=k), axis=2).min()) for k in (0, 1))
        # as much of the edges as belongs to this corner alone
        return np.arange(self.columns * self.rows), _refined(image, corners, 0.4 * spacing)


@dataclass(frozen=True)
class Charuco:
    """
    A chessboard with a marker in every light square; parts of it suffice.

    Parameters
    ----------
    columns, rows : int
        Inner corners.
    square_m, marker_m : float
        Sides of a square and of a marker.
    dictionary : str
        Name in `cv2.aruco`; empty: found out.

    Raises
    ------
    ArgumentError
        If a value is impossible.
    InputError
        If this OpenCV has no ArUco markers.

    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str = ''
    _boards: list = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self):
        """Refuse impossible boards, and prepare the possible ones."""
        if min(self.columns, self.rows) < 2:
            raise ArgumentError('A ChArUco board needs at least 2 x 2 inner corners (one less '
                                f'than squares), not {self.columns} x {self.rows}.')
        if not self.marker_m < self.square_m:
            raise ArgumentError('The markers of a ChArUco board must be smaller than its '
                                f'squares: {self.marker_m:g} m is not below {self.square_m:g} m.')
        aruco = getattr(cv2, 'aruco', None)
        if not (hasattr(aruco, 'CharucoDetector') or hasattr(aruco, 'interpolateCornersCharuco')):
            raise InputError(f'This OpenCV ({cv2.__version__}) comes without ChArUco boards; '
                             'install opencv-python-headless 4.7 or later, or use a chessboard.')
        if self.dictionary and not (self.dictionary.startswith('DICT_')
                                    and hasattr(aruco, self.dictionary)):
            raise ArgumentError(f'The marker dictionary {self.dictionary!r:.40} is unknown; use a '
                                'name of cv2.aruco such as DICT_5X5_100.')
        for name in [self.dictionary] if self.dictionary else DICTIONARIES:
            number = getattr(aruco, name, None)
            if number is None:
                continue
            markers = aruco.getPredefinedDictionary(number)
            capacity = len(markers.bytesList)
            if (self.columns + 1) * (self.rows + 1) // 2 <= capacity:
                self._boards.extend(_charuco_boards(self, markers))
        if not self._boards:
            raise ArgumentError('A ChArUco board of so many squares needs more markers than '
                                'the dictionary holds.')

    @property
    def known(self) -> KnownObject:
        """The inner corners, numbered row by row from 0, as OpenCV does."""
        return KnownObject(np.arange(self.columns * self.rows),
                           _plane(self.columns, self.rows, self.square_m))

    def find(self, image: np.ndarray, thorough: bool = True):
        """Find corners as `Chessboard.find` does; a part of the board suffices."""
        best = _nothing()
        for finder in list(self._boards):
            found = finder(image)
            if len(found[0]) > len(best[0]):
                best = found[0], _refined(image, found[1], self._clear_px(*found))
                # next time first, and alone once most of the board was seen
                self._boards.remove(finder)
                self._boards.insert(0, finder)
                if len(best[0]) > 0.5 * self.columns * self.rows:
                    del self._boards[1:]
                    break
        return best

    def _clear_px(self, identity: np.ndarray, xy: np.ndarray) -> float:
        """How far from a corner there is nothing but its own edges, pixels."""
        beside = (np.diff(identity) == 1) & (identity[1:] % self.columns > 0)
        if not beside.any():
            return 0.0
        spacing = float(np.linalg.norm(np.diff(xy, axis=0)[beside], axis=1).min())
        return 0.45 * (1 - self.marker_m / self.square_m) * spacing


def _refined(image: np.ndarray, corners: np.ndarray, clear_px: float) -> np.ndarray:
    """Bring corners to sub-pixel accuracy; OpenCV's own of ChArUco is half a pixel off in 4.6."""
    half = int(np.clip(clear_px, 2, 11))
    corners = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(
        image, corners.copy(), (half, half), (-1, -1),
        (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    ).reshape(-1, 2).astype(float)


def _charuco_boards(board: Charuco, markers) -> list:
    """Return functions image → (identity, xy), one for each way such a board was ever drawn."""
    aruco, squares = cv2.aruco, (board.columns + 1, board.rows + 1)
    if not hasattr(aruco, 'CharucoDetector'):
        make = aruco.CharucoBoard_create                # type: ignore[attr-defined]
        old = make(*squares, board.square_m, board.marker_m, markers)

        def find_old(image):
            corners, ids, _ = aruco.detectMarkers(image, markers)
            if ids is None or len(ids) < 2:
                return _nothing()
            _, xy, identity = aruco.interpolateCornersCharuco(corners, ids, image, old)
            return _found(identity, xy)

        return [find_old]
    finders = []
    # boards with an even number of rows began with a white square before OpenCV 4.6
    for legacy in (False, True) if squares[1] % 2 == 0 else (False,):
        new = aruco.CharucoBoard(squares, board.square_m, board.marker_m, markers)
        if legacy and not hasattr(new, 'setLegacyPattern'):
            continue
        if legacy:
            new.setLegacyPattern(True)
        detector = aruco.CharucoDetector(new)

        def find_new(image, detector=detector):
            xy, identity, _, _ = detector.detectBoard(image)
            return _found(identity, xy)

        finders.append(find_new)
    return finders


def _nothing():
    return np.empty(0, dtype=np.int64), np.empty((0, 2))


def _found(identity, xy):
    if identity is None or xy is None or len(identity) < 4:
        return _nothing()
    return (np.asarray(identity).ravel().astype(np.int64),
            np.asarray(xy, dtype=float).reshape(-1, 2))


@dataclass(frozen=True)
class PointList:
    """Points that are found elsewhere: the input must be a table of their tracks."""

    known: KnownObject
    find = None


Target = Chessboard | Charuco | TsaiGrid | PointList


def parse_target(text: str) -> Target:
    """
    Understand what `--object` names.

    Parameters
    ----------
    text : str
        See the table above.

    Returns
    -------
    Chessboard, Charuco, TsaiGrid or PointList

    Raises
    ------
    ArgumentError
        If the text is of no known form, or a number is impossible.
    InputError
        If the point file is wrong.

    """
    kind, colon, rest = text.partition(':')
    kind = kind.lower()
    lengths = {'chessboard': 1, 'charuco': 2, 'tsai': 3}
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
    return TsaiGrid(columns, rows, values[0], values[1], values[2])


def _form(kind: str) -> str:
    return next(form for form in _SHAPES.replace(' or ', ', ').split(', ')
                if form.startswith(kind))


def read_points(path) -> KnownObject:
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
