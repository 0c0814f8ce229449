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
Views of a long recording in levels: each shares points with its own and the next levels alone.

Levels are those of a breadth-first search from one end (George and Liu 1981, chapter 4). So the
normal matrix of the views is block-tridiagonal, also where the path closes a loop: then a level
holds views of both its arms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

#: Fewer views are quicker with one dense matrix.
LEAST_VIEWS = 64
#: Views in a level, at least: smaller blocks cost more calls than they save products.
LEAST_IN_LEVEL = 8
#: Levels must save so much of the products of a dense factor to pay for their calls.
LEAST_SAVING = 4.0


@dataclass(frozen=True)
class ViewChain:
    """
    Views in levels.

    Attributes
    ----------
    order : ndarray of int, shape (V,)
        Views, level by level.
    first : ndarray of int, shape (L + 1,)
        Where each level begins in that order, and the end.

    """

    order: np.ndarray
    first: np.ndarray

    @property
    def levels(self) -> int:
        """Count the levels."""
        return len(self.first) - 1

    @property
    def place(self) -> np.ndarray:
        """Where each view stands in the order, shape (V,)."""
        place = np.empty_like(self.order)
        place[self.order] = np.arange(len(self.order))
        return place

    @property
    def level(self) -> np.ndarray:
        """Level of each view, shape (V,)."""
        level = np.empty_like(self.order)
        level[self.order] = np.repeat(np.arange(self.levels), np.diff(self.first))
        return level


def chain_of_views(point: np.ndarray, view: np.ndarray, views: int) -> ViewChain | None:
    """
    Put views in levels, where that saves much.

    Parameters
    ----------
    point, view : ndarray of int, shape (N,)
        What each observation sees, and where from.
    views : int

    Returns
    -------
    ViewChain or None
        None with few views, or where most of them share points with each other.

    """
    if views < LEAST_VIEWS:
        return None
    seen = csr_array((np.ones(len(view), np.float32), (view, point)))
    beside = csr_array(seen @ seen.T)
    levels = _levels(beside, int(_levels(beside, 0)[-1][0]))
    if sum(map(len, levels)) < views:
        return None
    merged = [levels[0]]
    for level in levels[1:]:
        if len(merged[-1]) < LEAST_IN_LEVEL:
            merged[-1] = np.concatenate([merged[-1], level])
        else:
            merged.append(level)
    sizes = np.array([len(level) for level in merged])
    # products of the factor, level by level and of all views at once
    products = np.sum(sizes * (sizes + np.r_[sizes[1:], 0])**2)
    if LEAST_SAVING * products > views**3 / 3:
        return None
    return ViewChain(np.concatenate([np.sort(level) for level in merged]),
                     np.r_[0, np.cumsum(sizes)])


def _levels(beside: csr_array, start: int) -> list[np.ndarray]:
    """Group views by how many steps between neighbours lead there from one of them."""
    reached = np.zeros(beside.shape[0], bool)
    reached[start] = True
    levels = [np.array([start])]
    while True:
        of_last = [beside.indices[beside.indptr[one]:beside.indptr[one + 1]]
                   for one in levels[-1]]
        found = np.unique(np.concatenate(of_last))
        found = found[~reached[found]]
        if not len(found):
            return levels
        reached[found] = True
        levels.append(found)
