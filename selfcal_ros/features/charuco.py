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
"""ChArUco boards: a chessboard with a marker in every light square."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.features.board_corners import nothing, plane, refined
from selfcal_ros.values.known_object import KnownObject

#: Dictionaries that are tried when none is named; each holds the smaller ones of its size.
DICTIONARIES = ('DICT_4X4_1000', 'DICT_5X5_1000', 'DICT_6X6_1000', 'DICT_7X7_1000',
                'DICT_ARUCO_ORIGINAL', 'DICT_APRILTAG_36h11', 'DICT_APRILTAG_25h9',
                'DICT_APRILTAG_16h5')


#: Smoothing before corners are located, as a share of what is clear around them, and at most,
#: pixels: corners then scatter by a seventh to a half less. More mixes in the markers' edges.
SMOOTHING_SHARE, MOST_SMOOTHING_PX = 0.28, 1.0

#: Finds identities (n,) and places (n, 2) of corners in a grey image.
_Find = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass
class _Board:
    """
    One way in which such a board was ever drawn.

    Attributes
    ----------
    find : callable
    corners : int
        That were found so far, in all images.
    is_used : bool
        Whether an image was read so.

    """

    find: _Find
    corners: int = 0
    is_used: bool = False


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
    _boards: list[_Board] = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse impossible boards, and prepare the possible ones."""
        if min(self.columns, self.rows) < 2:
            raise ArgumentError('A ChArUco board needs at least 2 x 2 inner corners (one less '
                                f'than squares), not {self.columns} x {self.rows}.')
        if not self.marker_m < self.square_m:
            raise ArgumentError('The markers of a ChArUco board must be smaller than its '
                                f'squares: {self.marker_m:g} m is not below {self.square_m:g} m.')
        aruco = getattr(cv2, 'aruco', None)
        if aruco is None or not (hasattr(aruco, 'CharucoDetector')
                                 or hasattr(aruco, 'interpolateCornersCharuco')):
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
                self._boards.extend(map(_Board, _charuco_boards(self, markers)))
        if not self._boards:
            raise ArgumentError('A ChArUco board of so many squares needs more markers than '
                                'the dictionary holds.')

    @property
    def known(self) -> KnownObject:
        """The inner corners, numbered row by row from 0, as OpenCV does."""
        return KnownObject(np.arange(self.columns * self.rows),
                           plane(self.columns, self.rows, self.square_m))

    def find(self, image: np.ndarray, thorough: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """
        Find corners as `Chessboard.find` does; a part of the board suffices.

        A part of a board with an even number of rows may suit both layouts that such boards have
        had: see `is_read_alike`.
        """
        found = [board.find(image) for board in self._boards]
        counts = [len(identity) for identity, _ in found]
        # where several find as many, that which has found the most so far
        best = max(range(len(found)), key=lambda k: (counts[k], self._boards[k].corners))
        if not counts[best]:
            return nothing()
        self._boards[best].is_used = True
        for board, count in zip(self._boards, counts):
            board.corners += count
        most = max(board.corners for board in self._boards)
        self._boards[:] = [board for board in self._boards
                           if board.is_used or board.corners > most - self.rows]
        identity, xy = found[best]
        clear_px = self._clear_px(identity, xy)
        return identity, refined(_smoothed(image, clear_px), xy, clear_px)

    @property
    def is_read_alike(self) -> bool:
        """Whether all images so far were read as of the board that fits them best."""
        return sum(board.is_used for board in self._boards) < 2

    def settle(self) -> None:
        """Take the board that has fitted best for the only one; who asks searches again."""
        self._boards[:] = [max(self._boards, key=lambda board: board.corners)]

    def _clear_px(self, identity: np.ndarray, xy: np.ndarray) -> float:
        """How far from a corner there is nothing but its own edges, pixels."""
        beside = (np.diff(identity) == 1) & (identity[1:] % self.columns > 0)
        if not beside.any():
            return 0.0
        spacing = float(np.linalg.norm(np.diff(xy, axis=0)[beside], axis=1).min())
        return 0.45 * (1 - self.marker_m / self.square_m) * spacing


def _charuco_boards(board: Charuco, markers: cv2.aruco.Dictionary) -> list[_Find]:
    """Return functions image → (identity, xy), one for each way such a board was ever drawn."""
    aruco, squares = cv2.aruco, (board.columns + 1, board.rows + 1)
    if not hasattr(aruco, 'CharucoDetector'):
        make = aruco.CharucoBoard_create                # type: ignore[attr-defined]
        old = make(*squares, board.square_m, board.marker_m, markers)

        def find_old(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            corners, ids, _ = aruco.detectMarkers(        # type: ignore[attr-defined]
                image, markers)
            if ids is None or len(ids) < 2:
                return nothing()
            _, xy, identity = aruco.interpolateCornersCharuco(     # type: ignore[attr-defined]
                corners, ids, image, old)
            return _found(identity, xy)

        return [find_old]
    finders: list[_Find] = []
    # boards with an even number of rows began with a white square before OpenCV 4.6
    for legacy in (False, True) if squares[1] % 2 == 0 else (False,):
        new = aruco.CharucoBoard(squares, board.square_m, board.marker_m, markers)
        if legacy and not hasattr(new, 'setLegacyPattern'):
            continue
        if legacy:
            new.setLegacyPattern(True)
        detector = aruco.CharucoDetector(new)

        def find_new(image: np.ndarray,
                     detector: cv2.aruco.CharucoDetector = detector,
                     ) -> tuple[np.ndarray, np.ndarray]:
            xy, identity, _, _ = detector.detectBoard(image)
            return _found(identity, xy)

        finders.append(find_new)
    return finders


def _smoothed(image: np.ndarray, clear_px: float) -> np.ndarray:
    """Smooth an image as far as it leaves the corners' own edges alone."""
    sigma_px = min(SMOOTHING_SHARE * clear_px, MOST_SMOOTHING_PX)
    # the window of a corner is five pixels wide at least
    return cv2.GaussianBlur(image, (0, 0), sigma_px) if clear_px >= 2 else image


def _found(identity: np.ndarray | None, xy: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    if identity is None or xy is None or len(identity) < 4:
        return nothing()
    return (np.asarray(identity).ravel().astype(np.int64),
            np.asarray(xy, dtype=float).reshape(-1, 2))
