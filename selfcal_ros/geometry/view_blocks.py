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
"""Normal matrix before the points are eliminated: no two views have anything in common yet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class ViewBlocks(NamedTuple):
    """
    Symmetric matrix of what all views share, and of views that only this connects.

    A thousand views take a thousandth of what the whole matrix would.

    Attributes
    ----------
    corner : ndarray, shape (g, g)
    border : ndarray, shape (V, g, v)
        Rows of what is shared, columns of each view.
    own : ndarray, shape (V, v, v)

    """

    corner: np.ndarray
    border: np.ndarray
    own: np.ndarray

    def to_be_reduced(self) -> np.ndarray:
        """Write all of it out, shape (g + V v, g + V v), for the elimination to fill."""
        views, g, v = self.border.shape
        matrix = np.zeros((g + views * v, g + views * v))
        matrix[:g, :g] = self.corner
        matrix[:g, g:] = self.border.transpose(1, 0, 2).reshape(g, views * v)
        matrix[g:, :g] = matrix[:g, g:].T
        k = np.arange(views)
        matrix[g:, g:].reshape(views, v, views, v)[k, :, k] = self.own
        return matrix
