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
Images of which some are mirrored.

A mirrored image has an epipolar geometry with one that is not: no pair contradicts itself. But
what is seen from one side keeps its sense of rotation from image to image. An affine map takes the
points of one view nearest to those of another. Its determinant is positive, and negative if one of
the two is mirrored.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from selfcal_ros.calibration.initialisation.initial_structure import PairGeometry
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph

#: A map that squeezes the plane more than this, or that leaves more than this share of where the
#: points are (variance), tells nothing of its sense.
MIN_SINGULAR_RATIO, MAX_UNEXPLAINED = 0.4, 0.2
#: Pairs that turn the other way, at least, where copies of one view count as one.
MIN_PAIRS = 3
#: Views whose points differ less than this (rms) are copies, as where a video repeats images.
COPY_PX = 1.5
#: Share of the pairs whose sense is clear that must agree.
AGREEING = 0.95


def mirrored_views(graph: ViewGraph) -> np.ndarray | None:
    """
    Find views that are mirror images of what the others are.

    Parameters
    ----------
    graph : ViewGraph

    Returns
    -------
    ndarray of bool, shape (V,)
        The fewer ones; None where all are alike, or where the pairs contradict each other.

    """
    views = len(graph.frames)
    sense = np.zeros((views, views))
    for pair in graph.pairs:
        sense[pair.first, pair.second] = sense[pair.second, pair.first] = sense_of(pair)
    if np.count_nonzero(sense < 0) < 2 * MIN_PAIRS:
        return None
    share = 1.0 / _copies(graph).sum(axis=1)
    if share @ (sense < 0) @ share < 2 * MIN_PAIRS:
        return None
    _, vectors = np.linalg.eigh(sense)
    side = np.where(vectors[:, -1] > 0, 1.0, -1.0)
    agreeing = np.count_nonzero(sense * np.outer(side, side) > 0)
    if agreeing < AGREEING * np.count_nonzero(sense) or abs(side.sum()) == views:
        return None
    turned: np.ndarray = side == (1.0 if (side > 0).sum() <= views / 2 else -1.0)
    return turned


def _copies(graph: ViewGraph) -> np.ndarray:
    """Return which views show the same points at the same places, (V, V); each itself, too."""
    tracks = graph.tracks
    at = np.searchsorted(graph.frames, tracks.frame), np.unique(tracks.track,
                                                                return_inverse=True)[1]

    def table(values: np.ndarray) -> csr_array:
        return coo_array((values, at)).tocsr()

    seen, x, y = table(np.ones(len(tracks))), table(tracks.xy[:, 0]), table(tracks.xy[:, 1])
    own = table(np.sum(tracks.xy**2, axis=1)) @ seen.T
    away = own + own.T - 2 * (x @ x.T + y @ y.T)
    near: np.ndarray = away.toarray() < COPY_PX**2 * (seen @ seen.T).toarray()
    return near


def sense_of(pair: PairGeometry) -> float:
    """Return 1 where two views turn alike, -1 where one is mirrored, 0 where it is not clear."""
    first, second = (xy - xy.mean(axis=0) for xy in (pair.xy_first, pair.xy_second))
    A, _, _, _ = np.linalg.lstsq(first, second, rcond=None)
    large, small = np.linalg.svd(A, compute_uv=False)
    left = np.sum((second - first @ A)**2) / max(np.sum(second**2), 1e-300)
    is_clear = small > MIN_SINGULAR_RATIO * large and left < MAX_UNEXPLAINED
    return float(np.sign(np.linalg.det(A))) if is_clear else 0.0
