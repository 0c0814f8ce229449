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
Chessboards, seen whole.

OpenCV has two detectors. The classic one joins dark squares; it fails where motion or a lack of
focus parts or merges them, or where the paper's rim is cut off. The sector-based one looks for
corners; it fails on boards of many squares. Together they find more than either, and whichever
corners scatter least are taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.features.board_corners import best_corners, CLEARLY_LESS, nothing, plane
from selfcal_ros.values.known_object import KnownObject

#: Corners that scatter by more, pixels, are looked for by the other detector, too.
GOOD_SCATTER_PX = 0.25
#: Images are shrunk to this longer side for the sector-based detector, which is slow in large
#: ones and finds less; then it tries the whole image.
SECTOR_SIDE_PX = 1000
#: Squares of fewer pixels have no corners to be located; OpenCV fails on a few pixels.
LEAST_SQUARE_PX = 4
#: Beyond so many pixels a side no detector is asked at full size.
MOST_SIDE_PX = 4000


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

    def __post_init__(self) -> None:
        """Refuse impossible boards."""
        if min(self.columns, self.rows) < 3:
            raise ArgumentError('A chessboard needs at least 3 x 3 inner corners (one less than '
                                f'squares), not {self.columns} x {self.rows}.')

    @property
    def known(self) -> KnownObject:
        """The corners, numbered row by row from 0."""
        return KnownObject(np.arange(self.columns * self.rows),
                           plane(self.columns, self.rows, self.square_m))

    def find(self, image: np.ndarray, thorough: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """
        Find all corners in a grey image.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W)
        thorough : bool
            Search longer, with both detectors, where a quick look shows no board.

        Returns
        -------
        identity : ndarray of int, shape (n,)
        xy : ndarray, shape (n, 2)
            Pixels; both empty where the board is not seen whole.

        """
        if min(image.shape[:2]) < LEAST_SQUARE_PX * min(self.columns, self.rows):
            return nothing()
        xy, scatter_px = self._located(image, self._by_squares(image))
        if thorough and scatter_px > GOOD_SCATTER_PX:
            other, other_px = self._located(image, self._by_sectors(image))
            if xy is None or other_px < CLEARLY_LESS * scatter_px:
                xy = other
        if thorough and xy is None:
            xy, _ = self._located(image, self._by_squares(image, check=False))
        return nothing() if xy is None else (np.arange(self.columns * self.rows), xy)

    def _located(self, image: np.ndarray, corners: np.ndarray | None,
                 ) -> tuple[np.ndarray | None, float]:
        """Bring what a detector saw to sub-pixel accuracy; returns the scatter, too."""
        if corners is None:
            return None, np.inf
        return best_corners(image, [corners], self.columns, self.rows)

    def _by_squares(self, image: np.ndarray, check: bool = True) -> np.ndarray | None:
        """Ask the classic detector, which may first check for squares; returns (P, 2) or None."""
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        return self._checked(*cv2.findChessboardCorners(
            image, (self.columns, self.rows),
            flags=flags | (cv2.CALIB_CB_FAST_CHECK if check else 0)))

    def _by_sectors(self, image: np.ndarray) -> np.ndarray | None:
        """Ask the sector-based detector, where this OpenCV has it; returns (P, 2) or None."""
        detect = getattr(cv2, 'findChessboardCornersSB', None)
        if detect is None:
            return None
        longer = max(image.shape[:2])
        shares = [1.0] if longer <= SECTOR_SIDE_PX else [SECTOR_SIDE_PX / longer]
        if SECTOR_SIDE_PX < longer <= MOST_SIDE_PX:
            shares.append(1.0)
        for share in shares:
            small = image if share == 1.0 else cv2.resize(
                image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
            try:
                found, corners = detect(small, (self.columns, self.rows),
                                        flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
            except cv2.error:      # of very small images in some versions
                continue
            # between the centres of the first pixels there is half a pixel of each image
            real = np.divide(image.shape[1::-1], small.shape[1::-1])
            xy = self._checked(found, corners)
            if xy is not None:
                return (xy + 0.5) * real - 0.5
        return None

    def _checked(self, found: bool, corners: np.ndarray | None) -> np.ndarray | None:
        """Return the corners (P, 2) of a board that was found whole."""
        if not found or corners is None or len(corners) != self.columns * self.rows:
            return None
        xy = np.asarray(corners, dtype=float).reshape(-1, 2)
        return xy if np.isfinite(xy).all() else None
