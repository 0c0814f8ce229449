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
"""Cholesky factors of very many very small matrices, entry by entry."""

from __future__ import annotations

import numpy as np


def inverse_cholesky(H: np.ndarray) -> np.ndarray:
    """
    Invert the Cholesky factors of symmetric matrices: L⁻¹, with H⁻¹ = L⁻ᵀ L⁻¹.

    Of three rows each entry is computed for all matrices at once. Calls of LAPACK for every one
    take ten times as long.

    Parameters
    ----------
    H : ndarray, shape (P, p, p)
        Positive definite; the lower triangles are read.

    Returns
    -------
    ndarray, shape (P, p, p)
        Lower triangular.

    Raises
    ------
    numpy.linalg.LinAlgError
        One of them is not positive definite.

    """
    if H.shape[1] != 3:
        inverse: np.ndarray = np.linalg.inv(np.linalg.cholesky(H))
        return inverse
    root, (h00, h10, h11, h20, h21, h22) = np.zeros_like(H), (
        H[:, i, j] for i in range(3) for j in range(i + 1))
    with np.errstate(all='ignore'):
        a = 1 / np.sqrt(h00)
        l10, l20 = h10 * a, h20 * a
        b = 1 / np.sqrt(h11 - l10 * l10)
        l21 = (h21 - l20 * l10) * b
        c = 1 / np.sqrt(h22 - l20 * l20 - l21 * l21)
        lower = -l10 * a * b
        root[:, 0, 0], root[:, 1, 1], root[:, 2, 2] = a, b, c
        root[:, 1, 0], root[:, 2, 1] = lower, -l21 * b * c
        root[:, 2, 0] = -(l20 * a + l21 * lower) * c
    if not np.isfinite(root).all():
        raise np.linalg.LinAlgError('a matrix is not positive definite')
    return root
