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
What an object hides of itself, and where it ends: its surface's points in the cells of an image.

The nearest point in each cell tells what is hidden behind it. An empty cell shows the background.
"""

from __future__ import annotations

import numpy as np

#: Cells along the object's longer side, and empty ones around it.
_CELLS, _AROUND = 60, 4
#: The object ends where cells so far beside it are empty, in cells.
_BESIDE = 1.5, 2.5


class DepthBuffer:
    """
    A coarse image of an object's depths.

    Parameters
    ----------
    surface : ndarray, shape (3, N)
        Points all over the surface, camera frame, metres: more than ten to a cell.

    """

    def __init__(self, surface: np.ndarray):
        """Find the nearest point in each cell."""
        # in rows, and in single precision: of thousands of points each step counts
        x, y, depth = surface.astype(np.float32)
        x /= depth
        y /= depth
        self._left, self._top = float(x.min()), float(y.min())
        self._step = max(float(x.max()) - self._left, float(y.max()) - self._top, 1e-12) / _CELLS
        self._side = _CELLS + 2 * _AROUND + 1
        self._nearest = np.full(self._side**2, np.inf, np.float32)
        cells = (((x - self._left) / self._step + _AROUND).astype(np.int32) * self._side
                 + ((y - self._top) / self._step + _AROUND).astype(np.int32))
        np.minimum.at(self._nearest, cells, depth)

    def hides(self, points: np.ndarray, nearer: float) -> np.ndarray:
        """
        Tell which points lie behind the surface.

        Parameters
        ----------
        points : ndarray, shape (3, M)
            Camera frame.
        nearer : float
            What is nearer than a point by more than this hides it, metres: the surface itself
            bends away within a cell.

        Returns
        -------
        ndarray of bool, shape (M,)

        """
        x, y, depth = points
        hidden: np.ndarray = depth > self._nearest[self._cells(x / depth, y / depth)] + nearer
        return hidden

    def ends_beside(self, points: np.ndarray, out: np.ndarray) -> np.ndarray:
        """
        Tell beside which points of the surface the background is seen.

        Parameters
        ----------
        points : ndarray, shape (3, M)
            Camera frame.
        out : ndarray, shape (3, M)
            Directions out of the surface.

        Returns
        -------
        ndarray of bool, shape (M,)

        """
        ends: np.ndarray = np.logical_and.reduce([
            np.isinf(depth) for depth in self._beside(points, out)])
        return ends

    def farther_beside(self, points: np.ndarray, out: np.ndarray, by: float) -> np.ndarray:
        """
        Tell beside which points another part of the surface is seen, farther away.

        Parameters
        ----------
        points : ndarray, shape (3, M)
            Camera frame.
        out : ndarray, shape (3, M)
            Directions out of the surface.
        by : float
            So much farther at the least, metres.

        Returns
        -------
        ndarray of bool, shape (M,)

        """
        farther: np.ndarray = np.logical_and.reduce([
            np.isfinite(depth) & (depth > points[2] + by) for depth in self._beside(points, out)])
        return farther

    def _beside(self, points: np.ndarray, out: np.ndarray) -> list[np.ndarray]:
        """Return the nearest depths (M,) in two cells beside points, infinite without any."""
        x, y = points[:2] / points[2]
        u, v = out[0] - x * out[2], out[1] - y * out[2]
        length = self._step / np.maximum(np.hypot(u, v), 1e-300)
        u *= length
        v *= length
        return [self._nearest[self._cells(x + far * u, y + far * v)] for far in _BESIDE]

    def _cells(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Numbers of the cells that places (M,) on the plane z = 1 lie in."""
        last = self._side - 1
        column = np.maximum((x - self._left) / self._step + _AROUND, 0).astype(int)
        row = np.maximum((y - self._top) / self._step + _AROUND, 0).astype(int)
        cell: np.ndarray = np.minimum(column, last) * self._side + np.minimum(row, last)
        return cell
