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
Solve one small linear system.

LAPACK takes a microsecond for six unknowns. `numpy.linalg` looks for stacks and types besides, and
takes four times as long. The results are the same.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgesv


def solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """
    Solve matrix · x = right.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    right : ndarray, shape (n,) or (n, k)

    Returns
    -------
    ndarray, shape (n,) or (n, k)

    Raises
    ------
    numpy.linalg.LinAlgError
        Where the matrix is singular.

    """
    *_, found, failed = dgesv(matrix, right)
    if failed:
        raise np.linalg.LinAlgError('Singular matrix')
    x: np.ndarray = found
    return x


def inverted(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a matrix (n, n); `LinAlgError` where it is singular."""
    return np.ascontiguousarray(solved(matrix, np.eye(len(matrix))))
