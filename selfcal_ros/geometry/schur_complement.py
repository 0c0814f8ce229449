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
Least squares over many points, which are eliminated from the equations (Schur complement).

The unknowns are a few that every observation shares (g: calibration, axis), a few for each
view (v), and a few for each point (p). Points are eliminated first; the system that remains has
the size of g + views · v. Where the points are known it is the views' poses that are eliminated:
then a "point" is a view, and v is zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, csr_matrix

from selfcal_ros.geometry.chain_matrix import ChainMatrix
from selfcal_ros.geometry.reduced_system import ReducedSystem
from selfcal_ros.geometry.small_cholesky import inverse_cholesky
from selfcal_ros.geometry.view_blocks import ViewBlocks
from selfcal_ros.geometry.view_chain import chain_of_views, ViewChain

#: Points are reduced in groups that share a few views, so that the cost grows with the length of
#: the tracks and not with that of the sequence. Large groups take fewer calls, smaller ones fewer
#: products: where they need less than this share, they are taken.
GROUP_POINTS, PART_POINTS, WORTH_SPLITTING = 192, 64, 0.7
#: Of so many views a place may be seen on several laps: points are put beside those that the same
#: stretches of so many views see, and groups are smaller.
MANY_VIEWS, STRETCH, SMALLER_PART = 200, 32, 16
#: Stretches of views that are subtracted one by one, at most.
MOST_RUNS = 16


@dataclass(frozen=True)
class _Group:
    """
    Points that are eliminated together.

    Attributes
    ----------
    members : ndarray of int, shape (m,)
    rows, slot, column : ndarray of int, shape (c,)
        What is known of them in one view each: where among all, of which member, and in which
        of these views.
    window : ndarray of int, shape (w,)
        Views that any of them is seen in, ascending.

    """

    members: np.ndarray
    rows: np.ndarray
    slot: np.ndarray
    column: np.ndarray
    window: np.ndarray

    @property
    def products(self) -> int:
        """Tell how the work of the elimination grows."""
        return len(self.members) * len(self.window)**2

    @cached_property
    def stretches(self) -> list[tuple[int, int, int]]:
        """Begin and end in the window of views in a row, and the first of these views."""
        ends = np.flatnonzero(np.r_[np.diff(self.window) != 1, True]) + 1
        begins = np.r_[0, ends[:-1]]
        return list(zip(begins.tolist(), ends.tolist(), self.window[begins].tolist()))

    def places(self, g: int, v: int) -> slice | np.ndarray:
        """Tell where the unknowns of the window stand among all."""
        if len(self.stretches) == 1:
            (_, count, first), = self.stretches
            return slice(g + first * v, g + (first + count) * v)
        own: np.ndarray = (g + self.window[:, None] * v + np.arange(v)).ravel()
        return own

    def subtract(self, matrix: np.ndarray, gram: np.ndarray, g: int, v: int) -> None:
        """Subtract products (g + w v,) of what is shared and of the window, squared."""
        if len(self.stretches) >= MOST_RUNS:
            # numbers of a flat array take half the time of rows and columns
            rows = np.concatenate([np.arange(g), self.places(g, v)])
            matrix.reshape(-1)[rows[:, None] * len(matrix) + rows] -= gram
            return
        # a few stretches of views, as on several laps: whole rows are quicker than single numbers
        runs = [(slice(0, g), slice(0, g)), *(
            (slice(g + begin * v, g + end * v),
             slice(g + first * v, g + (first + end - begin) * v))
            for begin, end, first in self.stretches)]
        for part, at in runs:
            for other, there in runs:
                matrix[at, there] -= gram[part, other]


class PointBlocks:
    """
    Bookkeeping of one set of observations, made once and used in every iteration.

    Parameters
    ----------
    point, view : ndarray of int, shape (N,)
        Indices from zero, sorted by point, then view; every point occurs. A view may see a point
        more than once, as one of several cameras does.

    """

    def __init__(self, point: np.ndarray, view: np.ndarray):
        self.point, self.view = point, view
        self.point_count = int(point[-1]) + 1
        self.view_count = int(view.max()) + 1
        self.first = np.flatnonzero(np.r_[True, np.diff(point) > 0])
        self.length = np.diff(np.r_[self.first, len(point)])
        self._transposed: tuple[np.ndarray, np.ndarray, csr_array] | None = None

    # ------------------------------------------------------------------ made when asked for

    @cached_property
    def _rows_of_views(self) -> csr_matrix:
        """Observations of every view, as a matrix (V, N) of ones."""
        by_view = np.argsort(self.view, kind='stable')
        first = np.searchsorted(self.view[by_view], np.arange(self.view_count + 1))
        return csr_matrix((np.ones(len(by_view)), by_view, first),
                          shape=(self.view_count, len(by_view)))

    def _of_view(self, k: int) -> np.ndarray:
        """Return which observations a view has."""
        first, last = self._rows_of_views.indptr[k:k + 2]
        rows: np.ndarray = self._rows_of_views.indices[first:last]
        return rows

    @cached_property
    def chain(self) -> ViewChain | None:
        """Levels of the views, where they save much."""
        return chain_of_views(self.point, self.view, self.view_count)

    @cached_property
    def _cells(self) -> np.ndarray:
        """First observation of each point in each view: they are added up, and eliminated."""
        return np.flatnonzero(np.r_[
            True, (np.diff(self.point) != 0) | (np.diff(self.view) != 0)])

    @cached_property
    def groups(self) -> list[_Group]:
        """Points that are eliminated together."""
        place = self.view if self.chain is None else self.chain.place[self.view]
        order = _beside_alike(self.point, place, self.first)
        first = np.searchsorted(self._cells, self.first)
        cells = np.diff(np.r_[first, len(self._cells)])
        cell_place = place[self._cells]

        def group(members: np.ndarray) -> _Group:
            lengths = cells[members]
            rows = np.repeat(first[members], lengths) + (
                np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths))
            slot = np.repeat(np.arange(len(members)), lengths)
            seen = np.zeros(self.view_count, bool)
            seen[cell_place[rows]] = True
            return _Group(members, rows, slot, (np.cumsum(seen) - 1)[cell_place[rows]],
                          np.flatnonzero(seen))

        def split(whole: _Group, sizes: tuple[int, ...]) -> list[_Group]:
            if not sizes:
                return [whole]
            parts = [group(whole.members[at:at + sizes[0]])
                     for at in range(0, len(whole.members), sizes[0])]
            if sum(part.products for part in parts) >= WORTH_SPLITTING * whole.products:
                return [whole]
            return [smaller for part in parts for smaller in split(part, sizes[1:])]

        sizes = (PART_POINTS,) if self.view_count < MANY_VIEWS else (PART_POINTS, SMALLER_PART)
        return [part for start in range(0, self.point_count, GROUP_POINTS)
                for part in split(group(order[start:start + GROUP_POINTS]), sizes)]

    # ------------------------------------------------------------------ sums

    def sum_over_points(self, values: np.ndarray) -> np.ndarray:
        """Add rows (N, ...) of each point: (P, ...)."""
        return np.add.reduceat(values, self.first, axis=0)

    def sum_over_cells(self, values: np.ndarray) -> np.ndarray:
        """Add rows (N, ...) of one point in one view: (c, ...), as the groups count them."""
        if len(self._cells) == len(values):
            return values
        return np.add.reduceat(values, self._cells, axis=0)

    def sum_over_views(self, values: np.ndarray) -> np.ndarray:
        """Add rows (N, k) of each view: (V, k)."""
        total: np.ndarray = self._rows_of_views @ values
        return total

    def products_by_views(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Sum AᵀB over the observations of each view, of (N, m, v) and (N, m, q): (V, v, q)."""
        products = np.zeros((self.view_count, one.shape[2], other.shape[2]))
        for k in range(self.view_count):
            rows = self._of_view(k)
            np.matmul(one[rows].reshape(-1, one.shape[2]).T,
                      np.take(other, rows, axis=0).reshape(-1, other.shape[2]), out=products[k])
        return products

    def products_by_points(self, jac_point: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Sum JᵀB over the observations of each point, of (N, m, p) and (N, m, q): (P, p, q)."""
        products: np.ndarray = (self._sparse(jac_point) @ other.reshape(
            -1, other.shape[2])).reshape(self.point_count, jac_point.shape[2], -1)
        return products

    def point_equations(self, jac_point: np.ndarray, residual: np.ndarray, weight: np.ndarray,
                        ) -> tuple[np.ndarray, np.ndarray]:
        """
        Sum the normal equations of every point alone.

        Parameters
        ----------
        jac_point : ndarray, shape (N, m, p)
        residual : ndarray, shape (N, m)
        weight : ndarray, shape (N,)

        Returns
        -------
        ndarray, shape (P, p, p)
        ndarray, shape (P, p)

        """
        m, p = jac_point.shape[1:]
        weighted = jac_point * weight[:, None, None]
        H, b = np.empty((self.point_count, p, p)), np.empty((self.point_count, p))

        def summed(i: int, other: np.ndarray) -> np.ndarray:
            # entry by entry: sums over contiguous numbers are the quick ones
            products = weighted[:, 0, i] * other[:, 0]
            for k in range(1, m):
                products += weighted[:, k, i] * other[:, k]
            return self.sum_over_points(products)

        for i in range(p):
            for j in range(i + 1):
                H[:, i, j] = H[:, j, i] = summed(i, jac_point[:, :, j])
            b[:, i] = summed(i, residual)
        return H, b

    def _products(self, jac_point: np.ndarray, jac_shared: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray]:
        """Sum Jᵀ J (P, p, p) and Jᵀ S (P, p, g) over points that many observations see."""
        p, g = jac_point.shape[2], jac_shared.shape[2]
        H, cross = np.empty((self.point_count, p, p)), np.empty((self.point_count, p, g))
        for k, (first, length) in enumerate(zip(self.first, self.length)):
            J = jac_point[first:first + length].reshape(-1, p)
            np.matmul(J.T, J, out=H[k])
            np.matmul(J.T, jac_shared[first:first + length].reshape(-1, g), out=cross[k])
        return H, cross

    def _products_of_few(self, jac_point: np.ndarray, jac_shared: np.ndarray,
                         ) -> tuple[np.ndarray, np.ndarray]:
        """Sum Jᵀ J (P, p, p) and Jᵀ S (P, p, g) over points that few observations see each."""
        m, p = jac_point.shape[1:]
        J = self._sparse(jac_point)
        H, cross = ((J @ jac.reshape(len(self.point) * m, -1)).reshape(self.point_count, p, -1)
                    for jac in (jac_point, jac_shared))
        return H, cross

    def _sparse(self, jac_point: np.ndarray) -> csr_array:
        """Write Jᵀ of all points out, (P p, N m); it is written over by the next."""
        m, p = jac_point.shape[1:]
        if self._transposed is None or self._transposed[0].shape[1:] != (p, m):
            # entry (n, i, k) of Jᵀ: row i of the point's, column k of the observation's
            n, i, k = np.ogrid[:len(self.point), :p, :m]
            first = self.first[self.point][:, None, None]
            length = self.length[self.point][:, None, None]
            entry = m * (p * first + i * length + n - first) + k
            source, column = np.empty((2, entry.size), np.int32)
            source[entry], column[entry] = (n * m + k) * p + i, n * m + k
            rows = np.r_[0, np.cumsum(np.repeat(m * self.length, p))].astype(np.int32)
            self._transposed = entry, source, csr_array(
                (np.empty(entry.size), column, rows),
                (self.point_count * p, len(self.point) * m))
        _, source, J = self._transposed
        J.data = jac_point.ravel()[source]
        return J

    def _grams(self, full: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Return every view, and JᵀJ of its observations, from rows (N, m, g + v)."""
        for k in range(self.view_count):
            rows = self._of_view(k)
            if len(rows):
                J = np.take(full, rows, axis=0).reshape(-1, full.shape[2])
                yield k, J.T @ J

    def _summed(self, full: np.ndarray, g: int, v: int) -> ViewBlocks:
        """Sum the normal equations of all views, with the points held."""
        if not v:
            J = full.reshape(-1, g)
            return ViewBlocks(J.T @ J, np.zeros((0, g, 0)), np.zeros((0, 0, 0)))
        count = self.view_count
        blocks = ViewBlocks(np.zeros((g, g)), np.zeros((count, g, v)), np.zeros((count, v, v)))
        for k, gram in self._grams(full):
            blocks.corner[:] += gram[:g, :g]
            blocks.border[k], blocks.own[k] = gram[:g, g:], gram[g:, g:]
        return blocks

    def unreduced(self, jac_shared: np.ndarray, jac_view: np.ndarray, jac_point: np.ndarray,
                  residual: np.ndarray) -> UnreducedSystem:
        """
        Set up the normal equations of which the points can be eliminated.

        Parameters
        ----------
        jac_shared : ndarray, shape (N, m, g)
        jac_view : ndarray, shape (N, m, v)
        jac_point : ndarray, shape (N, m, p)
        residual : ndarray, shape (N, m)

        Returns
        -------
        UnreducedSystem

        """
        v = jac_view.shape[2]
        full = np.concatenate([jac_shared, jac_view], axis=2) if v else jac_shared
        return self.unreduced_rows(full, v, jac_point, residual)

    def unreduced_rows(self, full: np.ndarray, v: int, jac_point: np.ndarray,
                       residual: np.ndarray) -> UnreducedSystem:
        """
        Do as `unreduced`, of the rows that it puts together: no copy of many unknowns is made.

        Parameters
        ----------
        full : ndarray, shape (N, m, g + v)
            By what is shared, then by the unknowns of the view.
        v : int
        jac_point : ndarray, shape (N, m, p)
        residual : ndarray, shape (N, m)

        Returns
        -------
        UnreducedSystem

        """
        g = full.shape[2] - v
        full, jac_point = np.ascontiguousarray(full), np.ascontiguousarray(jac_point)
        matrix: ViewBlocks | ChainMatrix
        if self.chain is not None and v:
            matrix, place = ChainMatrix(self.chain, g, v), self.chain.place
            for k, gram in self._grams(full):
                matrix.add_gram(gram, place[k:k + 1])
        else:
            matrix = self._summed(full, g, v)
        cross = None
        if v:
            H, shared = self._products_of_few(jac_point, full)
            shared = shared[..., :g]
            cross = np.swapaxes(jac_point, 1, 2) @ full[:, :, g:]            # (N, p, v)
            cross = self.sum_over_cells(cross)
        else:
            H, shared = self._products(jac_point, full)
        return UnreducedSystem(self, self.groups, matrix, residual, full, jac_point, H, shared,
                               cross)


class UnreducedSystem(NamedTuple):
    """
    Normal equations before the points are eliminated, which no damping changes.

    Attributes
    ----------
    blocks : PointBlocks
    groups : list of _Group
        Points that are eliminated together.
    matrix : ViewBlocks or ChainMatrix
        With the points held.
    residual : ndarray, shape (N, m)
    jac_rest, jac_point : ndarray, shape (N, m, g + v), (N, m, p)
    by_points : ndarray, shape (P, p, p)
        Blocks of the points.
    shared : ndarray, shape (P, p, g)
        Products of the points' derivatives with those by what is shared.
    cross : ndarray, shape (c, p, v), or None
        The same by the unknowns of a view, one for each point in each view.

    """

    blocks: PointBlocks
    groups: list[_Group]
    matrix: ViewBlocks | ChainMatrix
    residual: np.ndarray
    jac_rest: np.ndarray
    jac_point: np.ndarray
    by_points: np.ndarray
    shared: np.ndarray
    cross: np.ndarray | None

    def reduced(self, damping: float = 0.0) -> ReducedSystem:
        """
        Eliminate the points; the equations here stay as they are.

        Parameters
        ----------
        damping : float
            Levenberg-Marquardt factor on the diagonal of the point blocks. The diagonal of the
            rest is left to the caller.

        Returns
        -------
        ReducedSystem

        """
        g, p = self.shared.shape[2], self.jac_point.shape[2]
        v = self.jac_rest.shape[2] - g
        matrix, H = self.matrix.to_be_reduced(), self.by_points.copy()
        diagonal = matrix.diagonal().copy()
        scale = np.einsum('pii->pi', H)      # a view: what is added to it is added to H
        # a floor keeps points without parallax invertible
        floor = scale * damping + 1e-12 * scale.sum(1, keepdims=True) + 1e-300
        scale += floor
        inverse_root = inverse_cholesky(H)
        factors = []
        for group in self.groups:
            members, window = group.members, group.window
            W = np.zeros((len(members), p, g + len(window) * v))
            W[..., :g] = self.shared[members]
            if self.cross is not None:
                by_view = W[..., g:].reshape(len(members), p, len(window), v)
                by_view[group.slot, :, group.column] = self.cross[group.rows]
            M = (inverse_root[members] @ W).reshape(-1, W.shape[2])
            gram = M.T @ M
            own: slice | np.ndarray
            if isinstance(matrix, ChainMatrix):
                matrix.add_gram(gram, window, -1.0)
                own = matrix.rows_of(window)
            else:
                own = group.places(g, v)
                group.subtract(matrix, gram, g, v)
            factors.append((members, M, own))
        system = ReducedSystem(self.blocks, matrix, diagonal, self.residual, self.jac_rest,
                               self.jac_point, inverse_root, factors, g)
        system.gradient, system.half_b = system.right_hand_side(self.residual)
        return system


def _beside_alike(point: np.ndarray, place: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Order points such that neighbours are seen from about the same views."""
    begin, last = np.minimum.reduceat(place, first), np.maximum.reduceat(place, first)
    keys = [last, begin]
    views = int(last.max()) + 1
    if views >= MANY_VIEWS:
        seen = np.zeros((len(first), -(-views // STRETCH)), bool)
        seen[point, place // STRETCH] = True
        # stretches as the digits of a number, those seen first before the others
        keys += list(~np.packbits(seen, axis=1).T[::-1])
    return np.lexsort(keys)
