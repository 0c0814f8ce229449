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
Factor of a chain of views: levels one after the other, what they share last.

Block Cholesky of an arrow matrix (Golub and Van Loan 2013, 4.5). Variances are those of the
selected inverse (Takahashi et al. 1973).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.sparse import csc_array, csr_array

from selfcal_ros.geometry.chain_matrix import ChainMatrix

#: Rounds of the search for the column that is largest in the inverse (Hager 1984).
_ROUNDS = 5


class NotPositive(ValueError):
    """The matrix has no Cholesky factor."""


class ChainFactor:
    """
    Cholesky factor of R (Eᵀ A E) R + damping: R diagonal, E a selection of unknowns.

    Parameters
    ----------
    matrix : ChainMatrix, shape (n, n)
    selection : csr_array, shape (n, k)
        Of `selection_matrix`.
    root : ndarray, shape (k,)
        What rows and columns are divided by.
    damping : float

    Raises
    ------
    NotPositive
        If there is none.

    """

    def __init__(self, matrix: ChainMatrix, selection: csr_array, root: np.ndarray,
                 damping: float = 0.0):
        self.count = selection.shape[1]
        scaled = csc_array(selection) @ csr_array(
            (1 / root, (np.arange(self.count), np.arange(self.count))))
        level = np.full(len(matrix), -1)
        for k, rows in enumerate(matrix.rows):
            level[rows] = k
        of_row = level[scaled.indices]
        lowest = np.minimum.reduceat(of_row, scaled.indptr[:-1])
        highest = np.maximum.reduceat(of_row, scaled.indptr[:-1])
        # an unknown of views in several levels belongs to the border
        of_unknown = np.where(lowest == highest, lowest, -1)
        self._own = [np.flatnonzero(of_unknown == k) for k in range(len(matrix.rows))]
        self._last = np.flatnonzero(of_unknown < 0)
        by_rows = csr_array(scaled)
        pick = [by_rows[rows][:, own].toarray() for rows, own in zip(matrix.rows, self._own)]
        border = by_rows[:, self._last].toarray()
        coupled = by_rows.T @ (matrix @ border)
        self._factor(matrix, pick, coupled, damping)

    def _factor(self, matrix: ChainMatrix, pick: list[np.ndarray], coupled: np.ndarray,
                damping: float) -> None:
        """Eliminate level by level; `coupled` (k, b) are the columns of the border."""
        corner = coupled[self._last]
        corner[np.diag_indices_from(corner)] += damping
        self._roots: list[np.ndarray] = []
        self._below: list[np.ndarray] = []
        self._border: list[np.ndarray] = []
        for k, own in enumerate(self._own):
            block = pick[k].T @ matrix.own[k] @ pick[k]
            block[np.diag_indices_from(block)] += damping
            edge = coupled[own]
            if k:
                below = pick[k].T @ matrix.below[k - 1] @ pick[k - 1]
                below = _solved(self._roots[-1], below.T).T
                self._below.append(below)
                block -= below @ below.T
                edge = edge - below @ self._border[-1]
            self._roots.append(_root(block))
            self._border.append(_solved(self._roots[-1], edge))
            corner -= self._border[-1].T @ self._border[-1]
        self._corner = _root(corner)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side (k,) or several (k, m)."""
        B = right.reshape(self.count, -1)
        forward: list[np.ndarray] = []
        last = B[self._last]
        for k, own in enumerate(self._own):
            part = B[own]
            if k:
                part = part - self._below[k - 1] @ forward[-1]
            forward.append(_solved(self._roots[k], part))
            last -= self._border[k].T @ forward[-1]
        last = _solved(self._corner, _solved(self._corner, last), transposed=True)
        solution = np.empty_like(B)
        solution[self._last] = last
        after = None
        for k in range(len(self._own) - 1, -1, -1):
            part = forward[k] - self._border[k] @ last
            if after is not None:
                part -= self._below[k].T @ after
            after = _solved(self._roots[k], part, transposed=True)
            solution[self._own[k]] = after
        return solution.reshape(right.shape)

    def least_eigenvalue(self) -> float:
        """Estimate the smallest eigenvalue from above, by powers of the inverse."""
        x, largest = np.full(self.count, 1 / max(self.count, 1)), 0.0
        y = self.solve(x)
        # the column that is largest in the inverse lies near its eigenvector
        for _ in range(_ROUNDS):
            norm = float(np.abs(y).sum())
            if not norm > largest:
                break
            largest = norm
            slope = self.solve(np.where(y >= 0, 1.0, -1.0))
            place = int(np.argmax(np.abs(slope)))
            if np.abs(slope[place]) <= slope @ x:
                break
            x = np.zeros(self.count)
            x[place] = 1
            y = self.solve(x)
        for _ in range(_ROUNDS):
            x = y / max(float(np.linalg.norm(y)), 1e-300)
            y = self.solve(x)
        return 1 / max(float(np.linalg.norm(y)), 1e-300)

    def blocks_of_inverse(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the inverse's block of every level (q, q), and the rows of these blocks (q,)."""
        found, size = [], len(self._last)
        corner = self._inverse_corner()
        after, beside = np.zeros((0, 0)), np.zeros((0, size))
        for k in range(len(self._own) - 1, -1, -1):
            border = self._border[k]
            follows = border if not len(after) else np.hstack([self._below[k].T, border])
            follows = _solved(self._roots[k], follows, transposed=True)
            # what has been inverted: the next level, and the border
            done = np.block([[after, beside], [beside.T, corner]])
            across = -follows @ done
            inverse_root = _solved(self._roots[k], np.eye(len(border)))
            own = inverse_root.T @ inverse_root - across @ follows.T
            after, beside = own, across[:, across.shape[1] - size:]
            found.append(own)
        return found[::-1], self._own

    def _inverse_corner(self) -> np.ndarray:
        root = _solved(self._corner, np.eye(len(self._last)))
        inverse: np.ndarray = root.T @ root
        return inverse

    def variances(self) -> np.ndarray:
        """Return the diagonal of the inverse, shape (k,)."""
        diagonal = np.empty(self.count)
        diagonal[self._last] = np.diag(self._inverse_corner())
        for block, own in zip(*self.blocks_of_inverse()):
            diagonal[own] = np.diag(block)
        return diagonal


def largest_eigenvalue(matrix: ChainMatrix, selection: csr_array, root: np.ndarray) -> float:
    """Estimate the largest eigenvalue of R (Eᵀ A E) R from below, by powers."""
    x = np.ones(selection.shape[1])
    for _ in range(2 * _ROUNDS):
        x /= np.linalg.norm(x)
        x = selection.T @ (matrix @ (selection @ (x / root))) / root
    return float(np.linalg.norm(x))


def _root(block: np.ndarray) -> np.ndarray:
    """Return the lower Cholesky factor."""
    if not block.size:
        return block
    root, failed = dpotrf(block, lower=1, clean=1)
    if failed or not np.isfinite(np.diag(root)).all():
        raise NotPositive
    factor: np.ndarray = root
    return factor


def _solved(root: np.ndarray, right: np.ndarray, transposed: bool = False) -> np.ndarray:
    """Solve a lower triangular system, or its transpose, for columns."""
    if not right.size:
        return right
    solved: np.ndarray = dtrtrs(root, right, lower=1, trans=int(transposed))[0]
    return solved
