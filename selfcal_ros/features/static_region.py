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
"""Parts of the image that stand still while the scene moves: the body of the robot."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.features.selection import image_speeds
from selfcal_ros.findings.finding import Finding
from selfcal_ros.values.tracks import Tracks

#: Cells along the longer side of the image.
_CELLS = 24
#: A body shakes by at most this share of the way of the scene, and of the image diagonal.
_SHAKE_OF_WAY, _SHAKE_OF_IMAGE = 0.1, 0.012
_STILL_PX = 0.5
#: Shorter tracks do not tell shaking from drifting.
_LEAST_VIEWS = 4
#: A drift of constant speed has 3.4 or more of these; shaking about a place has about one.
_MOST_DRIFT = 2.5
#: A cell is still with its neighbours where this share of their observations is.
_STILL_SHARE = 0.7
#: Smaller parts are left to the test of single tracks.
_LEAST_TRACKS, _LEAST_SHARE = 10, 0.01


@dataclass(frozen=True)
class _Histories:
    """Of every observation its track (0, 1, ...), of every track whether it is still, or tells."""

    of: np.ndarray
    still: np.ndarray
    known: np.ndarray


def drop_static_regions(tracks: Tracks, rest: Tracks) -> tuple[Tracks, list[Finding]]:
    """
    Drop what lies in parts of the image that stand still while the scene moves.

    The body of a robot reaches in from the border of the image. It shakes, its edges slide along
    others, and it shines, so that not each of its tracks is still enough by itself.

    Parameters
    ----------
    tracks : Tracks
        Before still tracks were dropped one by one.
    rest : Tracks
        After that.

    Returns
    -------
    Tracks
        What is left of the rest.
    findings : list of Finding
        One a region.

    """
    if tracks.image_size is None or not len(tracks) or not len(rest):
        return rest, []
    size = tracks.image_size
    histories = _histories(tracks, float(np.hypot(*size)))
    regions, cell_px = _regions(tracks, histories, size)
    if not regions:
        return rest, []
    row, column = _cell(rest.xy, cell_px, regions[0].shape)
    names = np.unique(tracks.track)[histories.still]
    still = np.isin(rest.track, names)
    findings, dropped = [], np.zeros(len(rest), bool)
    for region in regions:
        # at the edge of a region cells are mixed
        around = cv2.dilate(region.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        inside = region[row, column] | (around[row, column] & still)
        dropped |= inside
        rows, columns = np.nonzero(region)
        low = cell_px * np.array([columns.min(), rows.min()])
        high = np.minimum(cell_px * np.array([columns.max() + 1, rows.max() + 1]), size)
        findings.append(Finding('static_region', left_px=float(low[0]), top_px=float(low[1]),
                                right_px=float(high[0]), bottom_px=float(high[1]),
                                share=float(region.mean()), positions=int(inside.sum())))
    return rest.select(~dropped), findings


def _histories(tracks: Tracks, diagonal_px: float) -> _Histories:
    """Tell which tracks shake about a place while others go far."""
    _, of, count = np.unique(tracks.track, return_inverse=True, return_counts=True)
    of = of.ravel()

    def mean(values: np.ndarray, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        weight = np.maximum(np.bincount(of[rows], minlength=len(count)), 1)
        return np.stack([np.bincount(of[rows], values[rows, k], len(count)) / weight
                         for k in (0, 1)], axis=1)

    xy = tracks.xy
    reach = np.zeros(len(count))
    np.maximum.at(reach, of, np.linalg.norm(xy - mean(xy)[of], axis=1))
    # rows are sorted by track, then frame
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    early = np.arange(len(xy)) - first[of] < count[of] / 2
    begin, end = mean(xy, early), mean(xy, ~early)
    within = np.linalg.norm(xy - np.where(early[:, None], begin[of], end[of]), axis=1)
    scatter = np.sqrt(np.bincount(of, within ** 2) / count)
    drift = np.linalg.norm(end - begin, axis=1)
    way = _way_of_scene(tracks, first, count)
    shaking = ((reach < _SHAKE_OF_WAY * way) & (reach < _SHAKE_OF_IMAGE * diagonal_px)
               & (drift < _MOST_DRIFT * scatter))
    still = (count >= _LEAST_VIEWS) & (way > 12 * _STILL_PX) & ((reach < _STILL_PX) | shaking)
    return _Histories(of, still, (count >= _LEAST_VIEWS) & (way > 12 * _STILL_PX))


def _way_of_scene(tracks: Tracks, first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return how far the faster points of the scene go while each track is seen, pixels."""
    time, step, speed = image_speeds(tracks)
    # a body may cover most of the image: the median would be its own
    fast = np.array([np.percentile(speed[time[step] == k], 80)
                     if np.count_nonzero(time[step] == k) >= 20 else 0.0
                     for k in range(time.max() + 1)])
    total = np.concatenate([[0], np.cumsum(fast)])
    way: np.ndarray = total[time[first + count - 1]] - total[time[first]]
    return way


def _cell(xy: np.ndarray, cell_px: float, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the row and column of the cells of points."""
    column, row = (xy // cell_px).astype(int).T
    return np.clip(row, 0, shape[0] - 1), np.clip(column, 0, shape[1] - 1)


def _regions(tracks: Tracks, histories: _Histories, size: tuple[int, int],
             ) -> tuple[list[np.ndarray], float]:
    """Find the parts, as arrays of bool over cells, and the side of a cell in pixels."""
    cell_px = max(size) / _CELLS
    shape = (int(np.ceil(size[1] / cell_px)), int(np.ceil(size[0] / cell_px)))
    row, column = _cell(tracks.xy, cell_px, shape)

    def counted(which: np.ndarray) -> np.ndarray:
        cells = np.zeros(shape, np.float32)
        np.add.at(cells, (row[which], column[which]), 1)
        return cv2.boxFilter(cells, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)

    still = histories.still[histories.of]
    still_count, known_count = counted(still), counted(histories.known[histories.of])
    part = (still_count >= 2 * _LEAST_VIEWS) & (still_count >= _STILL_SHARE * known_count)
    number, labels = cv2.connectedComponents(part.astype(np.uint8), connectivity=4)
    regions = []
    for label in range(1, number):
        region = labels == label
        at_border = region[[0, -1]].any() or region[:, [0, -1]].any()
        there = np.unique(histories.of[still & region[row, column]])
        if at_border and len(there) >= _LEAST_TRACKS and region.mean() >= _LEAST_SHARE:
            regions.append(region)
    return regions, cell_px
