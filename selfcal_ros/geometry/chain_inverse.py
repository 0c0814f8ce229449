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
Covariance of a long recording: numbers of it are solved for when they are asked for.

The whole of it would take the square of the number of views, and hardly any of it is ever read.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_array

from selfcal_ros.geometry.chain_factor import ChainFactor


class ChainInverse:
    """
    Inverse of the normal matrix of a chain of views: numbers of it are solved for when asked for.

    It takes the place of an array (n, n) wherever parts of that are read.

    Parameters
    ----------
    factor : ChainFactor
    selection : csr_array, shape (n, k)
    root : ndarray, shape (k,)
        Of the factor.
    times : float
        What the inverse is multiplied by.

    """

    ndim = 2
    __array_ufunc__ = None

    def __init__(self, factor: ChainFactor, selection: csr_array, root: np.ndarray,
                 times: float = 1.0):
        self._factor, self._selection, self._root, self._times = factor, selection, root, times
        n = selection.shape[0]
        self.shape = n, n

    def __len__(self) -> int:
        """Count the rows."""
        return int(self.shape[0])

    def __mul__(self, times: float) -> ChainInverse:
        """Multiply by a number."""
        return ChainInverse(self._factor, self._selection, self._root, self._times * times)

    __rmul__ = __mul__

    def __neg__(self) -> ChainInverse:
        """Change the sign."""
        return self * -1.0

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """Multiply a vector (n,) or columns (n, k)."""
        columns = (self._selection.T @ X.reshape(len(X), -1)) / self._root[:, None]
        solved = self._factor.solve(columns) / self._root[:, None]
        product: np.ndarray = self._times * (self._selection @ solved)
        return product.reshape(X.shape)

    def __getitem__(self, places: Any) -> Any:
        """Read rows, or rows and columns, as of an array."""
        rows, columns = places if isinstance(places, tuple) else (places, slice(None))
        numbers = np.arange(len(self))
        shape = np.broadcast_shapes(np.shape(rows), np.shape(columns))
        if isinstance(rows, slice) or isinstance(columns, slice):
            shape = (*np.shape(numbers[rows]), *np.shape(numbers[columns]))
        elif np.ndim(rows) < 2 and np.ndim(columns) < 2 and np.size(rows) > 1:
            raise IndexError('Pairs of rows and columns are not read.')
        at, along = np.ravel(numbers[rows]), np.ravel(numbers[columns])
        if len(at) > len(along):
            return self._columns(along)[at].reshape(shape)
        return self._columns(at)[along].T.reshape(shape)

    def _columns(self, places: np.ndarray) -> np.ndarray:
        unit = np.zeros((len(self), len(places)))
        unit[places, np.arange(len(places))] = 1
        return self @ unit

    def __rmatmul__(self, X: np.ndarray) -> np.ndarray:
        """Multiply a row (n,) or rows (k, n) by it."""
        product: np.ndarray = (self @ X.T).T
        return product

    def of_independent(self) -> ChainInverse:
        """Return the covariance of the independent unknowns alone, (k, k)."""
        count = self._selection.shape[1]
        every = np.arange(count)
        return ChainInverse(self._factor, csr_array((np.ones(count), (every, every))),
                            self._root, self._times)

    def diagonal(self) -> np.ndarray:
        """Return the variances, shape (n,)."""
        squares = self._selection.power(2)
        variances: np.ndarray = self._times * (
            squares @ (self._factor.variances() / self._root**2))
        # what follows several unknowns at once
        for row in np.flatnonzero(np.diff(self._selection.indptr) > 1):
            variances[row] = self[row, row]
        return variances

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        """Write all of it out, (n, n)."""
        return self._columns(np.arange(len(self)))

    def blocks(self, rows: csr_array, size: int) -> np.ndarray:
        """
        Carry the inverse to groups of linear forms, each of a few views.

        Parameters
        ----------
        rows : csr_array, shape (size · m, n)
        size : int
            Forms of a group.

        Returns
        -------
        ndarray, shape (m, size, size)

        """
        J = csc_array(rows @ self._selection)
        J.data /= np.repeat(self._root, np.diff(J.indptr))
        groups = J.shape[0] // size
        inside, places = self._factor.blocks_of_inverse()
        # what many forms follow is solved for; of the rest each view's block of the inverse is
        # at hand
        common = np.diff(J.indptr) > 2 * size
        alone = np.zeros(len(common), bool)
        alone[np.concatenate(places)] = True
        common |= ~alone
        shared = np.flatnonzero(common)
        unit = np.zeros((len(common), len(shared)))
        unit[shared, np.arange(len(shared))] = 1
        C = self._factor.solve(unit)
        by_shared = J[:, shared].toarray().reshape(groups, size, -1)
        own = csr_array(J @ csr_array((1.0 * ~common, (np.arange(len(common)),) * 2)))
        across = (own @ C).reshape(groups, size, -1)
        found = (by_shared @ C[shared] + across) @ np.swapaxes(by_shared, 1, 2)
        found += by_shared @ np.swapaxes(across, 1, 2)
        for block, place in zip(inside, places):
            part = own[:, place]
            here = np.unique(np.flatnonzero(np.diff(part.indptr)) // size)
            dense = part[(here[:, None] * size + np.arange(size)).ravel()].toarray().reshape(
                len(here), size, len(place))
            found[here] += dense @ block @ np.swapaxes(dense, 1, 2)
        carried: np.ndarray = self._times * found
        return carried


def carried_blocks(rows: csr_array, covariance: np.ndarray | ChainInverse,
                   size: int) -> np.ndarray:
    """Carry a covariance (n, n) to groups (m, size, size) of linear forms; see `blocks`."""
    if isinstance(covariance, ChainInverse):
        return covariance.blocks(rows, size)
    J = rows.toarray().reshape(-1, size, rows.shape[1])
    shared = (rows @ covariance).reshape(J.shape)
    carried: np.ndarray = np.einsum('vik,vjk->vij', shared, J)
    return carried
