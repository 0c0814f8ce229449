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
"""AprilGrids, as Kalibr prints them: tags of the family 36h11, joined by black squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.features.board_corners import nothing, refined
from selfcal_ros.values.known_object import KnownObject

#: Tags of the family.
TAGS = 587
#: Widths of the black border that are tried, in bits: Kalibr's, and everyone else's.
BORDER_BITS = (2, 1)
#: A tag is 6 bits wide, without its border.
_INNER_BITS = 6
#: Most corners lie within this share of a tag's side of one homography, in wide lenses, too.
MISFIT = 1.0

#: Finds tags (n,) and their corners (n, 4, 2) in a grey image.
_Detect = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class AprilGrid:
    """
    Rows of AprilTags with black squares between their corners; parts of it suffice.

    Parameters
    ----------
    columns, rows : int
        Tags.
    tag_m : float
        Side of a tag, its black border included.
    spacing : float
        Space between tags, as a share of `tag_m`.

    Raises
    ------
    ArgumentError
        If a value is impossible.
    InputError
        If this OpenCV has no AprilTags.

    """

    columns: int
    rows: int
    tag_m: float
    spacing: float
    _detectors: list[tuple[int, _Detect]] = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse impossible grids, and prepare the possible ones."""
        if self.columns * self.rows < 2 or self.columns * self.rows > TAGS:
            raise ArgumentError(f'An AprilGrid has 2 to {TAGS} tags, not {self.columns} x '
                                f'{self.rows}.')
        if not self.spacing <= 2:
            raise ArgumentError('The spacing of an AprilGrid is a share of the side of its tags, '
                                f'such as 0.3, not {self.spacing:g}.')
        self._detectors.extend((bits, _detector(bits)) for bits in BORDER_BITS)

    @property
    def known(self) -> KnownObject:
        """
        Four corners a tag, numbered 4 · tag + corner.

        Tags count from the lower left, row by row upwards; corners from the tag's lower left,
        anticlockwise. The origin is the corner 0 of tag 0, x to the right, y up, as in Kalibr.
        """
        return KnownObject(np.arange(4 * self.columns * self.rows),
                           np.insert(self._corners(upward=True).reshape(-1, 2), 2, 0.0, axis=1))

    def _corners(self, upward: bool) -> np.ndarray:
        """Return the corners of all tags (tags, 4, 2), anticlockwise where y is up."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        row = row if upward else self.rows - 1 - row
        first = np.column_stack([column, row]) * (1 + self.spacing) * self.tag_m
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * self.tag_m
        corners: np.ndarray = first[:, None] + square
        return corners

    def find(self, image: np.ndarray, thorough: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """
        Find corners of tags in a grey image; a part of the grid suffices.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W)
        thorough : bool
            Makes no difference.

        Returns
        -------
        identity : ndarray of int, shape (n,)
        xy : ndarray, shape (n, 2)
            Pixels; both empty where fewer than two tags are seen.

        """
        tag, corners, border = np.empty(0, dtype=np.int64), np.empty((0, 4, 2)), BORDER_BITS[0]
        for bits, detect in list(self._detectors):
            seen, places = detect(image)
            mine = seen < self.columns * self.rows
            # a tag that is seen twice is none of the grid, or beside it
            mine &= np.bincount(seen, minlength=1)[seen] == 1
            if np.count_nonzero(mine) > len(tag):
                tag, corners, border = seen[mine], places[mine], bits
            if len(tag) >= min(4, self.columns * self.rows):
                # this border next time, too
                self._detectors[:] = [one for one in self._detectors if one[0] == border]
                break
        if len(tag) < 2:
            return nothing()
        identity, corners = self._numbered(tag, corners)
        if len(identity) < 2:
            return nothing()
        side = float(np.linalg.norm(np.diff(corners, axis=1), axis=2).min())
        clear = min(self.spacing or 1.0, border / (_INNER_BITS + 2 * border))
        return (identity.ravel(), refined(image, corners, 0.8 * clear * side))

    def _numbered(self, tag: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Number the corners as in `known`; returns them by tag, (n, 4) and (n, 4, 2).

        Programs differ in which corner of a tag is the first, and in whether rows count upwards.
        Only one way fits the grid.
        """
        best, least = nothing(), np.inf
        side = np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2))
        # anticlockwise before a viewer, as the corners of the object are
        corners = corners[:, ::-1]
        for upward in (True, False):
            flat = self._corners(upward)[tag]
            for turn in range(4):
                turned = np.roll(corners, turn, axis=1)
                misfit = float(np.median(_off(flat, turned)))
                if misfit < 0.9 * least:
                    row, column = np.divmod(tag, self.columns)
                    number = (row if upward else self.rows - 1 - row) * self.columns + column
                    best = 4 * number[:, None] + np.arange(4), turned
                    least = misfit
        return best if least < MISFIT * side else nothing()


def _off(flat: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return how far corners (n, 4, 2) are from a homography of the grid, (n, 4)."""
    H = cv2.findHomography(flat.reshape(-1, 2), corners.reshape(-1, 2), cv2.LMEDS)[0]
    if H is None:
        return np.full(corners.shape[:2], np.inf)
    x = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], axis=2) @ H.T
    with np.errstate(divide='ignore', invalid='ignore'):
        off = np.linalg.norm(x[..., :2] / x[..., 2:] - corners, axis=2)
    return np.where(np.isfinite(off), off, np.inf)


def _detector(border_bits: int) -> _Detect:
    """Return a function image → (tags (n,), corners (n, 4, 2)) for tags of such a border."""
    if not hasattr(getattr(cv2, 'aruco', None), 'DICT_APRILTAG_36h11'):
        raise InputError(f'This OpenCV ({cv2.__version__}) comes without AprilTags; install '
                         'opencv-python-headless 4.7 or later, or use a chessboard.')
    aruco = cv2.aruco
    markers = aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11)
    make = getattr(aruco, 'DetectorParameters_create', None)
    parameters = make() if make else aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    new = hasattr(aruco, 'ArucoDetector') and aruco.ArucoDetector(markers, parameters)

    def find(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if min(image.shape[:2]) < 8:
            return np.empty(0, dtype=np.int64), np.empty((0, 4, 2))
        if new:
            corners, tags, _ = new.detectMarkers(image)
        else:
            corners, tags, _ = aruco.detectMarkers(     # type: ignore[attr-defined]
                image, markers, parameters=parameters)
        if tags is None or not len(tags):
            return np.empty(0, dtype=np.int64), np.empty((0, 4, 2))
        return (np.asarray(tags).ravel().astype(np.int64),
                np.asarray(corners, dtype=float).reshape(-1, 4, 2))

    return find
