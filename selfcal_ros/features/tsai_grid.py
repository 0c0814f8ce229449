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
Find a Tsai grid: two orthogonal planes of dark squares (thesis 3.2).

Squares are found and counted off; then a line is fitted by orthogonal regression to the edge
points of each row and column of squares. The corners are where these lines meet. A line may bend a
little (a parabola), since lenses do that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.resection import resect_linear
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.values.known_object import KnownObject

#: Edge points of one side of a square, and the part of it near the corners that is left out.
EDGE_POINTS, CORNER_FRACTION = 16, 0.15
#: Smallest square that is looked for, pixels.
MIN_SIDE_PX = 8
#: A neighbouring square may differ so much from the expected place and shape.
TOLERANCE = 0.35


@dataclass(frozen=True)
class TsaiGrid:
    """
    Two orthogonal planes of dark squares on light ground that meet in a fold.

    The object's z axis runs along the fold; the squares of one plane lie in y = 0, x > 0, those
    of the other in x = 0, y > 0.

    Parameters
    ----------
    columns, rows : int
        Squares across and along the fold, on each plane.
    square_m, gap_m, margin_m : float
        Side of a square, gap between squares, and distance of the first edge from the fold.

    """

    columns: int
    rows: int
    square_m: float
    gap_m: float
    margin_m: float

    @property
    def known(self) -> KnownObject:
        """The corners: plane by plane, along the fold, then away from it."""
        across, along = (np.repeat(np.arange(n), 2) * (self.square_m + self.gap_m)
                         + np.tile([0, self.square_m], n) for n in (self.columns, self.rows))
        w, u = (part.ravel() for part in np.meshgrid(along, across + self.margin_m,
                                                     indexing='ij'))
        zero = np.zeros(u.size)
        points = np.concatenate([np.column_stack([u, zero, w]), np.column_stack([zero, u, w])])
        return KnownObject(np.arange(len(points)), points)

    def find(self, image: np.ndarray, thorough: bool = True, bend: bool = True,
             ) -> tuple[np.ndarray, np.ndarray]:
        """
        Find all corners in a grey image.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W)
        thorough : bool
            Try further thresholds where the first ones do not show the grid.
        bend : bool
            Let the fitted lines bend, as a lens with distortion makes them.

        Returns
        -------
        identity : ndarray of int, shape (n,)
        xy : ndarray, shape (n, 2)
            Pixels; both empty where the grid is not seen whole.

        """
        for quads in _dark_quads(image, thorough):
            corners = self._counted_off(quads)
            if corners is None:
                continue
            corners = _at_line_intersections(image, corners, bend)
            if corners is None:
                continue
            # the fold may be seen from inside or outside: only one order of the planes is no
            # mirror image
            for planes in (corners, corners[::-1]):
                P = resect_linear(self.known.points, planes.reshape(-1, 2))
                if not isinstance(P, NoEstimate) and np.linalg.det(P[:, :3]) > 0:
                    return np.arange(planes.size // 2), planes.reshape(-1, 2)
        return np.empty(0, dtype=np.int64), np.empty((0, 2))

    def _counted_off(self, quads: np.ndarray) -> np.ndarray | None:
        """Return rough corners, shape (2, 2 rows, 2 columns, 2), or None."""
        if len(quads) < 2 * self.columns * self.rows:
            return None
        grids = []
        for lattice in _lattices(quads, 1 + self.gap_m / self.square_m):
            grids += self._planes(lattice)
        if len(grids) != 2:
            return None
        sides = [grid.mean(axis=(0, 1)) for grid in grids]
        result = []
        for grid, other in zip(grids, sides[::-1]):
            if self.columns == self.rows and not _faces_across(grid, other):
                grid = np.swapaxes(grid, 0, 1)
            # away from the fold is away from the other plane
            if np.linalg.norm(grid[:, 0] - other, axis=-1).mean() > np.linalg.norm(
                    grid[:, -1] - other, axis=-1).mean():
                grid = grid[:, ::-1]
            result.append(grid)
        directions = [(grid[-1] - grid[0]).mean(axis=0) for grid in result]
        if directions[0] @ directions[1] < 0:
            result[1] = result[1][::-1]
        return np.array(result)

    def _planes(self, lattice: np.ndarray) -> list[np.ndarray]:
        """Cut a lattice (rows, columns, 2) of corners into planes of the right size."""
        whole, wide = (2 * self.rows, 2 * self.columns), (2 * self.rows, 4 * self.columns)
        for one in (lattice, np.swapaxes(lattice, 0, 1)):
            if one.shape[:2] == whole:
                return [one]
            if one.shape[:2] == wide:
                return [one[:, :wide[1] // 2], one[:, wide[1] // 2:]]
        return []


def _faces_across(grid: np.ndarray, other: np.ndarray) -> bool:
    """Tell whether the other plane lies beyond the ends of the second axis of this one."""
    middle = grid.mean(axis=(0, 1))
    axes = np.column_stack([(grid[-1] - grid[0]).mean(axis=0),
                            (grid[:, -1] - grid[:, 0]).mean(axis=0)])
    along, across = np.abs(np.linalg.solve(axes, other - middle))
    return bool(across > along)


def _dark_quads(image: np.ndarray, thorough: bool) -> Iterator[np.ndarray]:
    """Yield the dark convex quadrilaterals (n, 4, 2) that a threshold shows, one after another."""
    smaller = min(image.shape[:2])
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    # blocks must be larger than a square
    for share in (0.25, 0.5, None, 0.12) if thorough else (0.25, None):
        if share is None:
            _, dark = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)
        else:
            dark = cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C,
                                         cv2.THRESH_BINARY_INV, int(share * smaller) | 1, 10)
        contours = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[-2]
        quads = []
        for contour in contours:
            if len(contour) < 3 * MIN_SIDE_PX:
                continue
            shape = cv2.approxPolyDP(contour, 0.06 * cv2.arcLength(contour, True), True)
            area = abs(cv2.contourArea(shape))
            if len(shape) == 4 and cv2.isContourConvex(shape) and (
                    MIN_SIDE_PX**2 / 2 < area < image.size / 8):
                quads.append(shape.reshape(4, 2))
        yield np.array(quads, dtype=float).reshape(-1, 4, 2)


def _lattices(quads: np.ndarray, pitch: float) -> list[np.ndarray]:
    """
    Chain squares with their neighbours, and return the corners of every full rectangle of them.

    Parameters
    ----------
    quads : ndarray, shape (n, 4, 2)
    pitch : float
        Distance of neighbouring squares in units of their side.

    Returns
    -------
    list of ndarray, shape (2 rows, 2 columns, 2)

    """
    middle = quads.mean(axis=1)
    # sides of every square, in each of the eight ways to call its corners
    ways = np.array([np.roll(order, k) for order in ([0, 1, 2, 3], [3, 2, 1, 0])
                     for k in range(4)])
    named = quads[:, ways]                                       # (n, 8, 4, 2)
    first = (named[:, :, 1] - named[:, :, 0] + named[:, :, 2] - named[:, :, 3]) / 2
    second = (named[:, :, 3] - named[:, :, 0] + named[:, :, 2] - named[:, :, 1]) / 2
    left = set(range(len(quads)))
    lattices = []
    while left:
        seed = left.pop()
        place, way, queue = {(0, 0): seed}, {seed: 0}, [(0, 0, seed)]
        while queue:
            i, j, k = queue.pop(0)
            a, b = first[k, way[k]], second[k, way[k]]
            for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                if (i + di, j + dj) in place or not left:
                    continue
                step = pitch * (di * a + dj * b)
                rest = np.fromiter(left, int)
                away = np.linalg.norm(middle[rest] - middle[k] - step, axis=1)
                found = rest[np.argmin(away)]
                misfit = (np.linalg.norm(first[found] - a, axis=1) / np.linalg.norm(a)
                          + np.linalg.norm(second[found] - b, axis=1) / np.linalg.norm(b))
                if away.min() < TOLERANCE * np.linalg.norm(step) and (
                        misfit.min() < 2 * TOLERANCE):
                    left.discard(int(found))
                    way[found] = int(np.argmin(misfit))
                    place[i + di, j + dj] = int(found)
                    queue.append((i + di, j + dj, int(found)))
        ij = np.array(list(place))
        low, size = ij.min(axis=0), np.ptp(ij, axis=0) + 1
        if len(place) < max(2, np.prod(size)):
            continue
        corners = np.empty((2 * size[1], 2 * size[0], 2))
        for (i, j), k in place.items():
            c = named[k, way[k]]
            i, j = 2 * (i - low[0]), 2 * (j - low[1])
            corners[j:j + 2, i:i + 2] = [[c[0], c[1]], [c[3], c[2]]]
        lattices.append(corners)
    return lattices


def _at_line_intersections(image: np.ndarray, corners: np.ndarray,
                           bend: bool) -> np.ndarray | None:
    """Move rough corners (2, m, n, 2) to where the lines through them meet; None: no lines."""
    smooth = cv2.GaussianBlur(image, (0, 0), 0.7)
    for reach in (3.0, 2.0, 2.0):
        down = _fitted_lines(smooth, np.swapaxes(corners, 1, 2), reach, bend)     # (2, n)
        along = _fitted_lines(smooth, corners, reach, bend)                       # (2, m)
        if down is None or along is None:
            return None
        for _ in range(3):
            n1, d1 = _tangent(down, corners, 1)
            n2, d2 = _tangent(along, corners, 2)
            A, b = np.stack([n1, n2], axis=-2), np.stack([d1, d2], axis=-1)
            determinant = np.linalg.det(A)
            if not (np.abs(determinant) > 0.05).all():
                return None
            corners = np.linalg.solve(A, b[..., None])[..., 0]
    return corners


@dataclass(frozen=True)
class _Lines:
    """Parabolas in frames of their own: origin, direction (2, n, 2), half length, (2, n, 3)."""

    origin: np.ndarray
    direction: np.ndarray
    half: np.ndarray
    bend: np.ndarray


def _fitted_lines(image: np.ndarray, corners: np.ndarray, reach: float, bend: bool,
                  ) -> _Lines | None:
    """
    Fit a line along each row of squares to their edge points.

    Parameters
    ----------
    corners : ndarray, shape (2, lines, 2 k, 2)
        Corners in order along each line; the sides of squares are every other stretch.
    reach : float
        How far from the expected edge to look, pixels.

    """
    start, end = corners[:, :, 0::2], corners[:, :, 1::2]
    share = np.linspace(CORNER_FRACTION, 1 - CORNER_FRACTION, EDGE_POINTS)[:, None]
    sides = start[:, :, :, None] * (1 - share) + end[:, :, :, None] * share
    points = sides.reshape(*corners.shape[:2], -1, 2)
    origin = (corners[:, :, 0] + corners[:, :, -1]) / 2
    direction = corners[:, :, -1] - corners[:, :, 0]
    half = np.linalg.norm(direction, axis=-1) / 2
    direction = direction / (2 * half[..., None])
    normal = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
    offsets = np.arange(-reach, reach + 0.01, 0.5)
    xy = points[..., None, :] + offsets[:, None] * normal[:, :, None, None]
    flat = xy.reshape(-1, len(offsets), 2).astype(np.float32)
    # remap takes no more than 32767 rows
    profile = np.concatenate([
        cv2.remap(image, part[..., 0], part[..., 1], cv2.INTER_LINEAR,
                  borderMode=cv2.BORDER_REPLICATE)
        for part in (flat[k:k + 30000] for k in range(0, len(flat), 30000))])
    profile = profile.reshape(xy.shape[:-1]).astype(float)
    slope = np.diff(profile, axis=-1)
    # the squares lie on one side of their line: all its edges rise, or all fall
    slope *= np.sign(slope.sum(axis=(-1, -2), keepdims=True))
    weight = np.maximum(slope, 0)**2
    total = weight.sum(axis=-1)
    contrast = np.ptp(profile, axis=-1)
    good = (total > 0) & (contrast > 0.3 * np.median(contrast))
    if not (good.mean(axis=-1) > 0.5).all():
        return None
    middle = (offsets[1:] + offsets[:-1]) / 2
    away = (weight @ middle) / np.maximum(total, 1e-300)
    edge = points + away[..., None] * normal[:, :, None]
    relative = edge - origin[:, :, None]
    s = np.einsum('lpnk,lpk->lpn', relative, direction) / half[..., None]
    d = np.einsum('lpnk,lpk->lpn', relative, normal)
    basis = np.stack([np.ones_like(s), s] + [s * s] * bend, axis=-1)
    w = good.astype(float)
    for _ in range(4):
        A = np.einsum('lpni,lpn,lpnj->lpij', basis, w, basis)
        b = np.einsum('lpni,lpn,lpn->lpi', basis, w, d)
        fit = np.linalg.solve(A, b[..., None])
        miss = np.abs((basis @ fit)[..., 0] - d)
        limit = 2 * robust_sigma(miss, axis=-1, keepdims=True) + 1e-6
        w = good * np.minimum(1, limit / np.maximum(miss, 1e-12))
    coefficients = np.zeros((*fit.shape[:2], 3))
    coefficients[..., :fit.shape[2]] = fit[..., 0]
    return _Lines(origin, direction, half, coefficients)


def _tangent(lines: _Lines, corners: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the tangents n · p = d of lines near corners (2, m, n, 2); axis: that is spread."""
    origin, direction = (np.expand_dims(v, axis) for v in (lines.origin, lines.direction))
    half, bend = np.expand_dims(lines.half, axis), np.expand_dims(lines.bend, axis)
    normal = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
    s = np.einsum('...k,...k->...', corners - origin, direction) / half
    height = bend[..., 0] + s * (bend[..., 1] + s * bend[..., 2])
    rise = (bend[..., 1] + 2 * s * bend[..., 2]) / half
    n = normal - rise[..., None] * direction
    n = n / np.linalg.norm(n, axis=-1, keepdims=True)
    foot = origin + (s * half)[..., None] * direction + height[..., None] * normal
    return n, np.einsum('...k,...k->...', n, foot)
