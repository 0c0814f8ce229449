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
"""Matrices that relate all parameters to the independent unknowns: some held, some tied."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array


def selection_matrix(free: np.ndarray, shared: np.ndarray | None = None,
                     balanced: tuple[int, ...] = ()) -> csr_array:
    """
    Relate all parameters to the independent unknowns among them.

    Parameters
    ----------
    free : ndarray of bool, shape (n,)
        False for parameters that are held.
    shared : ndarray of int, shape (n,), optional
        The parameter that each moves with; itself by default.
    balanced : tuple of int
        Free parameters whose steps are zero in sum: the last is less the sum of the others.

    Returns
    -------
    csr_array, shape (n, k)
        E of step = E y: a row with a single 1, or none for a held parameter.

    """
    column = np.arange(len(free)) if shared is None else shared
    rows = np.flatnonzero(free[column])
    if balanced:
        rows = rows[rows != balanced[-1]]
    kept, column = np.unique(column[rows], return_inverse=True)
    value = np.ones(len(rows))
    if balanced:
        others = np.searchsorted(kept, balanced[:-1])
        rows = np.r_[rows, np.full(len(others), balanced[-1])]
        column, value = np.r_[column, others], np.r_[value, np.full(len(others), -1.0)]
    return csr_array((value, (rows, column)), (len(free), len(kept)))


def embedded_selection(selection: csr_array, places: np.ndarray, count: int) -> csr_array:
    """
    Relate more parameters to the independent unknowns of some of them; the others are held.

    Parameters
    ----------
    selection : csr_array, shape (n, k)
        Of `selection_matrix`.
    places : ndarray of int, shape (n,)
        Where its parameters stand among all.
    count : int
        m, how many there are.

    Returns
    -------
    csr_array, shape (m, k)

    """
    of_row = csr_array((np.ones(len(places)), (places, np.arange(len(places)))),
                       (count, len(places)))
    return csr_array(of_row @ selection)
