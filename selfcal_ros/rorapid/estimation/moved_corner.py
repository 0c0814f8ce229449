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
Is a corner of the object elsewhere than the model has it, by more than a pose can follow?

A robust fit leaves the lines of such a corner aside, as it leaves clutter. Here the corner is
moved along one of its lines by a share s. Edges are counted where its lines would lie then, and
where the model has them. Clutter is seldom where a moved corner asks for it, image after image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

#: Shares that are asked for, in steps.
STEP = 0.005
SHARES = STEP * np.concatenate([np.arange(-30, -5), np.arange(6, 31)])
#: An edge is where a line asks for it, and a place counts that would move by more, pixels.
_AT_PX, _MOVES_PX = 1.0, 2.5
#: Of the places of a line so many have an edge where the moved corner asks for it, and no more
#: where the model has it. Where more than the last share have one there, the corner stands.
_SEEN, _LEFT, _STANDS = 0.6, 0.3, 0.5
#: A line has as many places before it counts; so many more edges ask for a corner than for none.
_PLACES, _EVIDENCE = 8.0, 12.0
#: An image counts for so many places of a line at most: one image is no proof.
_OF_AN_IMAGE = 3.0
#: Memory of what earlier images showed.
MEMORY = 0.95


class MovedCorner(NamedTuple):
    """
    A corner that is elsewhere.

    Attributes
    ----------
    pattern : int
        Of those that were given.
    share : float
        By which the object is longer there than the model, to a step of `STEP`.

    """

    pattern: int
    share: float


class MovedCorners:
    """
    Counts of edges where lines of a moved corner would lie, over images.

    Parameters
    ----------
    patterns, lines : int
        How many ways a corner may be moved, and lines of the model.

    """

    def __init__(self, patterns: int, lines: int) -> None:
        """Begin without an image."""
        self._lines = lines
        #: Places that count; those with an edge if moved; those with one as it stands.
        self._counts = np.zeros((3, patterns * lines, len(SHARES)))
        self._said: int | None = None

    def look(self, distance: np.ndarray, slopes: np.ndarray, line: np.ndarray,
             reach_px: float) -> None:
        """
        Take in an image.

        Parameters
        ----------
        distance : ndarray, shape (C, candidates)
            Of the edges of each control point from it, along the normal, at the pose; pixels.
        slopes : ndarray, shape (C, K)
            Motion along the normal for s = 1 of each pattern, pixels.
        line : ndarray of int, shape (C,)
        reach_px : float
            Edges were searched as far.

        """
        point, pattern = np.nonzero(np.abs(slopes) * SHARES[-1] > _MOVES_PX)
        self._counts *= MEMORY
        if not len(point):
            return
        row = pattern * self._lines + line[point]
        order = np.argsort(row, kind='stable')
        point, pattern, row = point[order], pattern[order], row[order]
        moved = slopes[point, pattern][:, None] * SHARES
        counts = (np.abs(moved) > _MOVES_PX) & (np.abs(moved) < reach_px - _AT_PX)
        there = (np.abs(distance[point][:, :, None] - moved[:, None]) < _AT_PX).any(axis=1)
        stands = (np.abs(distance[point]) < _AT_PX).any(axis=1)[:, None]
        first = np.flatnonzero(np.r_[True, row[1:] != row[:-1]])
        of_lines = np.add.reduceat(np.stack([counts, counts & there, counts & stands],
                                            dtype=float), first, axis=1)
        self._counts[:, row[first]] += of_lines * np.minimum(
            1.0, _OF_AN_IMAGE / np.maximum(of_lines[0], 1.0))

    def found(self) -> MovedCorner | None:
        """Return the corner that most edges ask for, until it is refuted; None without one."""
        if not self._counts.size:
            return None
        places, there, stands = self._counts.reshape(3, -1, self._lines, len(SHARES))
        enough = places > _PLACES
        asks = enough & (there > _SEEN * places) & (stands < _LEFT * places)
        refuted = (enough & (stands > _STANDS * places)).any(axis=1)
        evidence = np.where(refuted, 0.0, (asks * (there - stands)).sum(axis=1)).ravel()
        if self._said is not None and refuted.ravel()[self._said]:
            self._said = None
        if evidence.max() > _EVIDENCE:
            self._said = int(evidence.argmax())
        if self._said is None:
            return None
        pattern, k = divmod(self._said, len(SHARES))
        return MovedCorner(pattern, float(SHARES[k]))
