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
"""Which vertices of a model lie in the same place."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

#: Largest coordinate that makes sense, metres.
LARGEST_M = 1e6


def same_place(vertices: np.ndarray, share: float = 1e-6) -> np.ndarray:
    """For each vertex (V, 3) the first one within a share of the extent of it, (V,) int."""
    if not len(vertices) or not (np.abs(vertices) < LARGEST_M).all():
        return np.arange(len(vertices))
    near = share * max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    # one of each cell of a finer grid: of many in one place not each is compared with each
    cell = np.rint((vertices - vertices.min(axis=0)) / (0.25 * near)).astype(np.int64)
    _, first, inverse = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    places = vertices[first]
    pairs = cKDTree(places).query_pairs(near, output_type='ndarray')
    _, group = connected_components(coo_matrix(
        (np.ones(len(pairs)), tuple(pairs.T)), shape=2 * (len(places),)), directed=False)
    lowest = np.full(len(places), len(vertices))
    np.minimum.at(lowest, group, first)
    place: np.ndarray = lowest[group[inverse.ravel()]]
    return place
