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
Normal matrix of a long recording: blocks of neighbouring levels, and what all views share.

Its memory and the work of its factor grow with the number of views, not with its square and cube.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.geometry.view_chain import ViewChain


class ChainMatrix:
    """
    Symmetric matrix that is block-tridiagonal by levels of views, with a border.

    The order of rows is that of a dense matrix: what is shared, then every view.

    Parameters
    ----------
    chain : ViewChain
    shared, of_view : int
        g, unknowns that all views share, and v, those of each view.

    Attributes
    ----------
    rows : list of ndarray of int
        Which rows of the whole belong to each level.
    own : list of ndarray, shapes (q, q)
        Blocks on the diagonal.
    below : list of ndarray, shapes (q of the next level, q)
    border : list of ndarray, shapes (q, g)
    corner : ndarray, shape (g, g)

    """

    ndim = 2

    def __init__(self, chain: ViewChain, shared: int, of_view: int):
        self.chain, self.shared, self.of_view = chain, shared, of_view
        views = np.split(chain.order, chain.first[1:-1])
        self.rows = [shared + (one[:, None] * of_view + np.arange(of_view)).ravel()
                     for one in views]
        sizes = [len(one) for one in self.rows]
        self.own = [np.zeros((size, size)) for size in sizes]
        self.below = [np.zeros((after, size)) for size, after in zip(sizes, sizes[1:])]
        self.border = [np.zeros((size, shared)) for size in sizes]
        self.corner = np.zeros((shared, shared))

    def __len__(self) -> int:
        """Count the rows."""
        return self.shared + len(self.chain.order) * self.of_view

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return len(self), len(self)

    def copy(self) -> ChainMatrix:
        """Return the same numbers, to be changed."""
        other = ChainMatrix(self.chain, self.shared, self.of_view)
        for name in ('own', 'below', 'border'):
            setattr(other, name, [block.copy() for block in getattr(self, name)])
        other.corner = self.corner.copy()
        return other

    def to_be_reduced(self) -> ChainMatrix:
        """Return a copy for the elimination to change."""
        return self.copy()

    def rows_of(self, places: np.ndarray) -> np.ndarray:
        """Which rows belong to the views that stand there in the chain's order, (m v,)."""
        views, v = self.chain.order[places], self.of_view
        rows: np.ndarray = self.shared + (views[:, None] * v + np.arange(v)).ravel()
        return rows

    # ------------------------------------------------------------------ made of grams

    def add_gram(self, gram: np.ndarray, places: np.ndarray, weight: float = 1.0) -> None:
        """
        Add JᵀJ of observations of some views.

        Parameters
        ----------
        gram : ndarray, shape (g + m v, g + m v)
        places : ndarray of int, shape (m,)
            Where these views stand in the chain's order, ascending.
        weight : float

        """
        g, v, first = self.shared, self.of_view, self.chain.first
        self.corner += weight * gram[:g, :g]
        levels = np.searchsorted(first, places, side='right') - 1
        starts = np.flatnonzero(np.r_[True, np.diff(levels) > 0])
        parts: list[tuple[int, slice, Any]] = []
        for start, end in zip(starts, np.r_[starts[1:], len(places)]):
            level = int(levels[start])
            at = places[start:end] - first[level]
            inside = (slice(at[0] * v, (at[-1] + 1) * v) if at[-1] - at[0] + 1 == len(at)
                      else (at[:, None] * v + np.arange(v)).ravel())
            parts.append((level, slice(g + start * v, g + end * v), inside))
        for k, (level, own, inside) in enumerate(parts):
            self.border[level][inside] += weight * gram[own, :g]
            _added(self.own[level], inside, inside, weight * gram[own, own])
            if k + 1 < len(parts) and parts[k + 1][0] == level + 1:
                _, other, there = parts[k + 1]
                _added(self.below[level], there, inside, weight * gram[other, own])

    # ------------------------------------------------------------------ what is added

    def add_diagonal(self, at: np.ndarray, values: np.ndarray) -> None:
        """Add values (k,) on the diagonal at these rows (k,)."""
        every = np.zeros(len(self))
        np.add.at(every, at, values)
        for rows, block in zip(self.rows, self.own):
            block[np.diag_indices_from(block)] += every[rows]
        self.corner[np.diag_indices_from(self.corner)] += every[:self.shared]

    def add_block(self, at: np.ndarray, block: np.ndarray) -> bool:
        """
        Add a symmetric block (k, k) at these rows (k,).

        Returns
        -------
        bool
            False, and nothing is added, if it couples views of levels that are no neighbours.

        """
        level = np.full(len(self), -1)
        for k, rows in enumerate(self.rows):
            level[rows] = k
        levels = level[at]
        one, other = (levels[index] for index in np.nonzero(block))
        if np.any((one >= 0) & (other >= 0) & (np.abs(one - other) > 1)):
            return False
        inside = np.flatnonzero(levels < 0)
        self.corner[np.ix_(at[inside], at[inside])] += block[np.ix_(inside, inside)]
        for k in np.unique(levels[levels >= 0]):
            here, after = np.flatnonzero(levels == k), np.flatnonzero(levels == k + 1)
            place = _places(self.rows[k], at[here])
            self.own[k][np.ix_(place, place)] += block[np.ix_(here, here)]
            self.border[k][np.ix_(place, at[inside])] += block[np.ix_(here, inside)]
            if len(after):
                there = _places(self.rows[k + 1], at[after])
                self.below[k][np.ix_(there, place)] += block[np.ix_(after, here)]
        return True

    def add_gauge(self, weight: float, direction: np.ndarray) -> None:
        """
        Hold a direction (n,) that nothing determines, as the scale of the world.

        To hold it in one level is enough, and leaves the blocks as they are: in that where it
        moves the most.
        """
        parts = [direction[rows] for rows in self.rows]
        k = int(np.argmax([part @ part for part in parts]))
        part = parts[k] / max(float(np.linalg.norm(parts[k])), 1e-300)
        self.own[k] += weight * np.outer(part, part)

    # ------------------------------------------------------------------ read

    def diagonal(self) -> np.ndarray:
        """Return the diagonal, shape (n,)."""
        diagonal = np.empty(len(self))
        diagonal[:self.shared] = np.diag(self.corner)
        for rows, block in zip(self.rows, self.own):
            diagonal[rows] = np.diag(block)
        return diagonal

    def folded_diagonal(self, selection: csr_array) -> np.ndarray:
        """Return the diagonal of Eᵀ A E, shape (k,), by E of `selection_matrix`."""
        if selection.nnz == selection.shape[1]:
            alone: np.ndarray = selection.T @ self.diagonal()
            return alone
        found = selection.power(2).T @ self.diagonal()
        several = np.flatnonzero(np.bincount(
            selection.indices, minlength=selection.shape[1]) > 1)
        columns = selection[:, several].toarray()
        found[several] = np.einsum('nk,nk->k', columns, self @ columns)
        folded: np.ndarray = found
        return folded

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """Multiply a vector (n,) or columns (n, k)."""
        g, product = self.shared, np.zeros(X.shape)
        product[:g] = self.corner @ X[:g]
        for k, rows in enumerate(self.rows):
            here = X[rows]
            product[rows] += self.own[k] @ here + self.border[k] @ X[:g]
            product[:g] += self.border[k].T @ here
            if k + 1 < len(self.rows):
                after = self.rows[k + 1]
                product[after] += self.below[k] @ here
                product[rows] += self.below[k].T @ X[after]
        return product

    def columns(self, places: np.ndarray) -> np.ndarray:
        """Return some columns, shape (n, k)."""
        unit = np.zeros((len(self), len(places)))
        unit[places, np.arange(len(places))] = 1
        return self @ unit

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        """Write all of it out, (n, n)."""
        dense: np.ndarray = self @ np.eye(len(self))
        return dense


def _places(rows: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Tell where numbers stand in an array that holds them all."""
    order = np.argsort(rows)
    return order[np.searchsorted(rows, wanted, sorter=order)]


def _added(block: np.ndarray, rows: Any, columns: Any, more: np.ndarray) -> None:
    """Add to part of a block, rows and columns as slices or numbers."""
    if isinstance(rows, slice) or isinstance(columns, slice):
        block[rows, columns] += more
    else:
        block[np.ix_(rows, columns)] += more
