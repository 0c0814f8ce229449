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
"""Corners followed from frame to frame, and held to their first appearance against drift."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from selfcal_ros.features.mask import ImageMask
from selfcal_ros.features.registration import DoubledImage, PatchRegistration, Templates

#: Where the flow looks first: at the place itself.
_NO_GUESS: Any = None
#: Options of the flow.
_FLOW: dict[str, Any] = {
    'winSize': (11, 11), 'maxLevel': 4,
    'criteria': (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 15, 0.03)}

#: A position less certain than this is not worth an observation.
_SIGMA_LIMIT_PX = 0.25
#: Corners are looked for where fewer than this share of those after the last search are followed,
#: and in one of so many images at least: others may have come into view.
_STILL_FULL, _SEARCH_EVERY = 0.8, 15


def corners(grey: np.ndarray, cell_px: int, occupied: np.ndarray | None = None,
            quality: float = 0.002, border_px: int = 10, mask: ImageMask | None = None,
            ) -> np.ndarray:
    """
    Find the best Shi-Tomasi corner of every free cell of a grid.

    Parameters
    ----------
    grey : ndarray of uint8, shape (H, W)
    cell_px : int
        Side of a cell.
    occupied : ndarray, shape (M, 2), optional
        Pixels; their cells stay empty.
    quality : float
        Least response, as a share of the strongest in the image.
    border_px : int
        Corners keep this far from the border.
    mask : ImageMask, optional
        Corners keep their patches within.

    Returns
    -------
    ndarray of float, shape (N, 2)
        Whole pixels.

    """
    response = cv2.cornerMinEigenVal(grey, 5, ksize=3)
    rows, columns = grey.shape[0] // cell_px, grey.shape[1] // cell_px
    if not rows or not columns:
        return np.empty((0, 2))
    highest = cv2.dilate(response, np.ones((5, 5), np.uint8))
    if mask is not None:
        response[~mask.inside()] = 0
    # the strongest few pixels must not decide for the whole image
    floor = quality * float(np.partition(response.ravel()[::7], -20)[-20])
    peak = (response >= highest) & (response > floor)
    peak[:border_px] = peak[-border_px:] = peak[:, :border_px] = peak[:, -border_px:] = False
    value = np.where(peak, response, 0)[:rows * cell_px, :columns * cell_px]
    value = value.reshape(rows, cell_px, columns, cell_px).swapaxes(1, 2)
    value = value.reshape(rows * columns, -1)
    best = value.argmax(axis=1)
    free = value[np.arange(len(best)), best] > 0
    if occupied is not None and len(occupied):
        column, row = (occupied // cell_px).astype(int).T
        inside = (column < columns) & (row < rows) & (column >= 0) & (row >= 0)
        free[row[inside] * columns + column[inside]] = False
    cell = np.flatnonzero(free)
    xy = np.stack([cell % columns * cell_px + best[cell] % cell_px,
                   cell // columns * cell_px + best[cell] // cell_px], axis=1).astype(float)
    if occupied is not None and len(occupied) and len(xy):
        free_px: np.ndarray = np.ones(grey.shape, np.uint8)
        near = np.clip(np.round(occupied).astype(int), 0, np.array(grey.shape[::-1]) - 1)
        free_px[near[:, 1], near[:, 0]] = 0
        reach = cell_px // 2 | 1
        free_px = cv2.erode(free_px, np.ones((reach, reach), np.uint8))
        at = xy.astype(int)
        xy = xy[free_px[at[:, 1], at[:, 0]] > 0]
    return xy


def flow(before: np.ndarray, after: np.ndarray, xy: np.ndarray, tolerance_px: float = 1.0,
         ) -> tuple[np.ndarray, np.ndarray]:
    """
    Follow points from one image to the next and back.

    Parameters
    ----------
    before, after : ndarray of uint8, shape (H, W)
    xy : ndarray, shape (N, 2)
        Pixels in `before`.
    tolerance_px : float
        A point that does not come back this close to its start is lost.

    Returns
    -------
    xy : ndarray, shape (N, 2)
        Pixels in `after`.
    followed : ndarray of bool, shape (N,)

    """
    if not len(xy):
        return np.empty((0, 2)), np.zeros(0, bool)
    start = np.ascontiguousarray(xy, dtype=np.float32).reshape(-1, 1, 2)
    there, status, _ = cv2.calcOpticalFlowPyrLK(before, after, start, _NO_GUESS, **_FLOW)
    back, status_back, _ = cv2.calcOpticalFlowPyrLK(after, before, there, _NO_GUESS, **_FLOW)
    followed = (status.ravel() > 0) & (status_back.ravel() > 0)
    followed &= np.linalg.norm((back - start).reshape(-1, 2), axis=1) < tolerance_px
    there = there.reshape(-1, 2).astype(float)
    followed &= np.isfinite(there).all(axis=1)
    followed &= ((there >= 0) & (there <= np.array(after.shape[::-1]) - 1)).all(axis=1)
    return there, followed


def followed_share(before: np.ndarray, after: np.ndarray, mask: ImageMask | None = None,
                   ) -> tuple[float, float]:
    """Share of corners that can be followed between two images, and their median step in px."""
    xy = corners(before, max(16, int(np.sqrt(before.size / 500))), mask=mask)
    there, followed = flow(before, after, xy, 0.5)
    if followed.sum() < 20:
        return 0.0, float('inf')
    return (float(followed.mean()),
            float(np.median(np.linalg.norm(there - xy, axis=1)[followed])))


@dataclass(frozen=True)
class Appearances:
    """
    What N points were first seen as, and how they are seen now.

    Attributes
    ----------
    anchors : ndarray, shape (N, 2)
        Where the templates were taken, pixels.
    affine : ndarray, shape (N, 2, 2)
        Warps since.
    response : ndarray, shape (N, 2, 6)
        `Templates.response`.

    """

    anchors: np.ndarray
    affine: np.ndarray
    response: np.ndarray


class KltTracker:
    """
    Follow corners through a video, frame by frame.

    Tracking from frame to frame finds roughly where a point went; registering its first
    appearance there with an affine warp then fixes the position, so that errors do not add up.

    Parameters
    ----------
    most : int
        Corners aimed at: one a cell of a grid with so many cells. May be changed between images.
    least_correlation : float
        A point less alike to its first appearance is lost.
    mask : ImageMask, optional
        Points are found and followed within; may be changed between images.
    renews : bool
        Whether templates that are seen at another scale are taken anew at once, or only by
        `renew`.
    first_id : int
        Ids are given from here on.

    """

    def __init__(self, most: int = 700, least_correlation: float = 0.8,
                 mask: ImageMask | None = None, renews: bool = True, first_id: int = 0):
        """Start without an image."""
        self.renews, self._next = renews, first_id
        self.most = most
        self.least_correlation = least_correlation
        self.mask = mask
        self._registration = PatchRegistration(half_px=7)
        self.reset()

    @property
    def appearances(self) -> Appearances:
        """First appearances of the points, and their warps since."""
        response = np.empty((0, 2, 6)) if self._templates is None else self._templates.response
        return Appearances(self._anchors.copy(), self._affine.copy(), response.copy())

    def reset(self) -> None:
        """Forget everything but the counter of ids: ids never come twice."""
        self._grey: np.ndarray | None = None
        self._smooth: DoubledImage | None = None
        self._ids = np.empty(0, np.int64)
        self._xy = np.empty((0, 2))
        self._affine = np.empty((0, 2, 2))
        self._residue = np.empty((0, 2))
        self._anchors = np.empty((0, 2))
        self._templates: Templates | None = None
        self._full, self._searched_before = self.most, _SEARCH_EVERY
        self._searched: tuple[int, ImageMask | None] = (self.most, self.mask)

    def add(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Take the next image.

        Parameters
        ----------
        grey : ndarray of uint8, shape (H, W)
            A change of size starts anew.

        Returns
        -------
        ids : ndarray of int64, shape (N,)
            Ascending; a point keeps its id while it is followed.
        xy : ndarray of float64, shape (N, 2)
            Pixels.

        Raises
        ------
        InputError
            If the mask has another size.

        """
        if self.mask is not None:
            self.mask.check(grey.shape)
        if self._grey is not None and self._grey.shape != grey.shape:
            self.reset()
        self._smooth = smooth = DoubledImage.smoothed(grey)[0]
        if len(self._ids):
            self._follow(grey, smooth)
        if self.most < self._searched[0]:
            self._thin_out(self._cell_px(grey))
        self._replenish(grey, smooth)
        self._grey = grey
        return self._ids.copy(), self._xy.copy()

    def _follow(self, grey: np.ndarray, smooth: DoubledImage) -> None:
        """Predict by optical flow, then register the first appearance."""
        assert self._grey is not None and self._templates is not None
        there, followed = flow(self._grey, grey, self._xy)
        self._keep(followed)
        there = there[followed]
        if not len(there):
            return
        begin = there - (self._affine @ self._residue[:, :, None])[:, :, 0]
        found, affine, correlation, step = self._registration.register(
            self._templates, smooth, begin, self._affine, iterations=5, tolerance_px=0.02)
        found = found + (affine @ self._residue[:, :, None])[:, :, 0]
        size = np.sqrt(np.abs(np.linalg.det(affine)))
        sigma = self._templates.position_sigma(correlation)
        good = ((correlation > self.least_correlation) & (step < 0.1) & (sigma < _SIGMA_LIMIT_PX)
                & (np.linalg.norm(found - there, axis=1) < 2.0) & (size > 0.4) & (size < 2.5))
        margin = self._registration.half_px
        limit = np.array(grey.shape[::-1]) - 1 - margin
        good &= ((found >= margin) & (found <= limit)).all(axis=1)
        if self.mask is not None:
            good &= self.mask.allows(found)
        self._xy, self._affine = found, affine
        self._keep(good)
        if self.renews:
            self.renew()

    def renew(self) -> None:
        """Take templates anew where they are seen at another scale: their detail is not there."""
        size = np.sqrt(np.abs(np.linalg.det(self._affine)))
        if self._smooth is not None:
            self._anchor(np.flatnonzero((size < 0.6) | (size > 1.6)), self._smooth)

    def _keep(self, mask: np.ndarray) -> None:
        """Drop the tracks where mask is false."""
        if mask.all():
            return
        assert self._templates is not None
        self._ids, self._xy = self._ids[mask], self._xy[mask]
        self._affine, self._residue = self._affine[mask], self._residue[mask]
        self._anchors = self._anchors[mask]
        self._templates = self._templates.select(mask)

    def _anchor(self, rows: np.ndarray, smooth: DoubledImage) -> None:
        """Take new templates of some tracks where they are now."""
        if not len(rows):
            return
        assert self._templates is not None
        whole = np.round(self._xy[rows])
        self._templates.replace(rows, self._registration.templates(smooth, whole))
        self._residue[rows] = self._xy[rows] - whole
        self._anchors[rows] = self._xy[rows]
        self._affine[rows] = np.eye(2)

    def _cell_px(self, grey: np.ndarray) -> int:
        """Side of the cells of the grid."""
        return max(12, int(np.sqrt(grey.size / self.most)))

    def _thin_out(self, cell_px: int) -> None:
        """Keep one point a cell: that which was followed longest."""
        cells = (self._xy // cell_px).astype(int)
        # ids ascend, and the first of each is kept
        kept = np.zeros(len(cells), bool)
        kept[np.unique(cells, axis=0, return_index=True)[1]] = True
        self._keep(kept)

    def _replenish(self, grey: np.ndarray, smooth: DoubledImage) -> None:
        """Fill empty cells with new corners."""
        cell = self._cell_px(grey)
        self._searched_before += 1
        wanted = (self.most, self.mask)
        if (len(self._ids) > _STILL_FULL * self._full and wanted == self._searched
                and self._searched_before < _SEARCH_EVERY):
            return
        xy = corners(grey, cell, self._xy, mask=self.mask)
        self._full, self._searched_before = len(self._ids) + len(xy), 0
        self._searched = wanted
        if not len(xy):
            return
        fresh = self._registration.templates(smooth, xy)
        count = len(xy)
        self._ids = np.concatenate([self._ids, self._next + np.arange(count)])
        self._next += count
        self._xy = np.concatenate([self._xy, xy])
        self._affine = np.concatenate([self._affine, np.tile(np.eye(2), (count, 1, 1))])
        self._residue = np.concatenate([self._residue, np.zeros((count, 2))])
        self._anchors = np.concatenate([self._anchors, xy])
        self._templates = (fresh if self._templates is None or not len(self._templates)
                           else self._templates.extended(fresh))
