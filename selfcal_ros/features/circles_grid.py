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
Grids of dark circles, in square or in staggered rows, seen whole.

The middle of a circle's image is not the image of its middle: perspective and lens draw the near
half larger. The way from the one to the other follows from the grid itself, and is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.features.board_corners import nothing
from selfcal_ros.values.known_object import KnownObject

#: A circle is looked at within this share of the distance to its nearest neighbour.
REACH = 0.5
#: Directions in which a circle's rim is sampled.
DIRECTIONS = 8
#: A grid is found by blobs of at most this share of the image.
LARGEST_BLOB = 0.05


@dataclass(frozen=True)
class CirclesGrid:
    """
    Dark circles on a light board.

    Parameters
    ----------
    columns, rows : int
        Circles in a row, and rows.
    spacing_m : float
        Distance of the rows. Along a row circles are as far apart, or twice as far where rows
        are staggered.
    staggered : bool
        Every other row is shifted by `spacing_m` (OpenCV: asymmetric).

    """

    columns: int
    rows: int
    spacing_m: float
    staggered: bool

    def __post_init__(self) -> None:
        """Refuse impossible grids."""
        if min(self.columns, self.rows) < 3:
            raise ArgumentError('A grid of circles has at least 3 x 3 of them, '
                                f'not {self.columns} x {self.rows}.')

    @property
    def known(self) -> KnownObject:
        """The centres, numbered row by row from 0, as OpenCV does."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        x = 2 * column + row % 2 if self.staggered else column
        return KnownObject(np.arange(len(row)), self.spacing_m * np.column_stack(
            [x, row, np.zeros(len(row))]))

    def find(self, image: np.ndarray, thorough: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """
        Find the centres of all circles in a grey image.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W)
        thorough : bool
            Search longer where a quick look shows no grid.

        Returns
        -------
        identity : ndarray of int, shape (n,)
        xy : ndarray, shape (n, 2)
            Images of the circles' centres, pixels; both empty where the grid is not seen whole.

        """
        pattern = cv2.CALIB_CB_ASYMMETRIC_GRID if self.staggered else cv2.CALIB_CB_SYMMETRIC_GRID
        if min(image.shape[:2]) < 4 * min(self.columns, self.rows):
            return nothing()
        detector = _blobs(image.size)
        for flags in (pattern, pattern | cv2.CALIB_CB_CLUSTERING)[:1 + thorough]:
            try:
                found, centres = cv2.findCirclesGrid(image, (self.columns, self.rows),
                                                     flags=flags, blobDetector=detector)
            except cv2.error:       # of images with a few blobs in some versions
                continue
            if found and centres is not None and len(centres) == self.columns * self.rows:
                xy = np.asarray(centres, dtype=float).reshape(-1, 2)
                break
        else:
            return nothing()
        flat = self.known.points[:, :2] / self.spacing_m
        xy, area = _measured(image, xy)
        return np.arange(len(xy)), xy - _eccentricity(flat, xy, area)


def _blobs(pixels: int) -> cv2.SimpleBlobDetector:
    """Return a detector of dark blobs of any size that circles may have."""
    parameters = cv2.SimpleBlobDetector_Params()        # type: ignore[attr-defined]
    parameters.minArea, parameters.maxArea = 12, LARGEST_BLOB * pixels
    parameters.minDistBetweenBlobs = 3
    parameters.filterByConvexity = parameters.filterByInertia = False
    detector: cv2.SimpleBlobDetector = (
        cv2.SimpleBlobDetector_create(parameters))      # type: ignore[attr-defined]
    return detector


def _measured(image: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Measure circles by the light that they lack.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W)
    xy : ndarray, shape (P, 2)
        Near their middles.

    Returns
    -------
    xy : ndarray, shape (P, 2)
        Middles of their images.
    area : ndarray, shape (P,)
        Pixels.

    """
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    reach = np.maximum(REACH * apart.min(axis=1), 2.0)
    half = int(np.ceil(reach.max()))
    v, u = np.mgrid[-half:half + 1, -half:half + 1]
    for _ in range(2):
        middle = np.rint(xy).astype(int)
        rows = np.clip(middle[:, 1, None, None] + v, 0, image.shape[0] - 1)
        columns = np.clip(middle[:, 0, None, None] + u, 0, image.shape[1] - 1)
        du, dv = u + (middle - xy)[:, 0, None, None], v + (middle - xy)[:, 1, None, None]
        near = np.hypot(du, dv) <= reach[:, None, None]
        grey = np.where(near, image[rows, columns], np.nan).reshape(len(xy), -1)
        light = np.nanpercentile(grey, 90, axis=1)[:, None]
        dark = np.nanpercentile(grey, 10, axis=1)[:, None]
        lack = np.nan_to_num(light - grey) / np.maximum(light - dark, 1.0)
        # what is light or dark all through carries noise only
        lack = np.clip((lack - 0.15) / 0.7, 0, 1)
        area = lack.sum(axis=1)
        shift = np.stack([(lack * d.reshape(len(xy), -1)).sum(axis=1) for d in (du, dv)], axis=1)
        xy = xy + shift / np.maximum(area, 1.0)[:, None]
    return xy, area


def _eccentricity(flat: np.ndarray, xy: np.ndarray, area: np.ndarray) -> np.ndarray:
    """
    Return how far the middles of the circles' images are from the images of their middles.

    A homography and, where there are circles enough, cubic polynomials of its pixels for the lens
    map the grid to the image. The image of a small disc is the mean over it, weighted by how much
    the map magnifies: to third order the mean over a circle of 1/√2 of its radius.

    Parameters
    ----------
    flat : ndarray, shape (P, 2)
        The grid, rows one apart.
    xy : ndarray, shape (P, 2)
        Pixels.
    area : ndarray, shape (P,)
        Of the circles' images, pixels.

    Returns
    -------
    ndarray, shape (P, 2)

    """
    H = cv2.findHomography(flat, xy, cv2.LMEDS)[0]
    if H is None:
        return np.zeros_like(xy)
    centre, scale = xy.mean(axis=0), max(float(xy.std()), 1.0)

    def terms(p: np.ndarray) -> np.ndarray:
        x, y = ((p - centre) / scale).T
        return np.column_stack([x**i * y**k for i in range(4) for k in range(4 - i)])

    def by_homography(p: np.ndarray) -> np.ndarray:
        x = np.column_stack([p, np.ones(len(p))]) @ H.T
        return x[:, :2] / x[:, 2:]

    rest = np.zeros((10, 2))
    if len(flat) >= 30:
        start = by_homography(flat)
        rest = np.linalg.lstsq(terms(start), xy - start, rcond=None)[0]

    def mapped(p: np.ndarray) -> np.ndarray:
        pixels = by_homography(p)
        return pixels + terms(pixels) @ rest

    def magnified(p: np.ndarray, step: float = 1e-3) -> np.ndarray:
        x, y = ((mapped(p + d) - mapped(p - d)) / (2 * step) for d in step * np.eye(2))
        area: np.ndarray = np.abs(x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0])
        return area

    radius = float(np.sqrt(np.median(area / magnified(flat)) / np.pi))
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ring = radius / np.sqrt(2) * np.column_stack([np.cos(angle), np.sin(angle)])
    weights = np.array([magnified(flat + d) for d in ring])
    places = np.array([mapped(flat + d) for d in ring])
    mean = np.sum(weights[..., None] * places, axis=0) / weights.sum(axis=0)[:, None]
    off: np.ndarray = mean - mapped(flat)
    return off
