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
"""Which pairs of views are compared, and by which of their matches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from selfcal_ros.calibration.initialisation.pair_lens import Sample
from selfcal_ros.values.tracks import Tracks

#: Every view is compared with so many successors.
SUCCESSORS = 3
#: Pairs with fewer common tracks than this say too little, by themselves.
MINIMUM_MATCHES = 12
#: Between views that those leave unlinked: so many, if every one of them agrees.
FEWEST_MATCHES = 8
#: Matches that determine epipolar geometry, and how probably a further one agrees by chance.
DETERMINE, AGREES_BY_CHANCE = 7, 0.1
#: So many matches of a pair, evenly chosen, decide on its epipolar geometry.
RANSAC_MATCHES = 200
#: A pair whose matches nearly all move less shows one image twice.
STILL_PX = 0.3


@dataclass(frozen=True)
class ObservationTable:
    """
    Where every observation stands in a table of views and points.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
    view, point : ndarray of int, shape (N,)
        Of every observation.
    row : ndarray of int, shape (V, P)
        The observation of a point in a view; -1 where there is none.

    """

    frames: np.ndarray
    view: np.ndarray
    point: np.ndarray
    row: np.ndarray

    @classmethod
    def of(cls, tracks: Tracks) -> ObservationTable:
        """Number the views and the points of tracks."""
        frames, view = np.unique(tracks.frame, return_inverse=True)
        identity, point = np.unique(tracks.track, return_inverse=True)
        row = np.full((len(frames), len(identity)), -1, dtype=np.int64)
        row[view, point] = np.arange(len(tracks))
        return cls(frames, view, point, row)

    def shared(self, a: int, b: int) -> np.ndarray:
        """Return the points that two views share, shape (n,)."""
        return np.flatnonzero((self.row[a] >= 0) & (self.row[b] >= 0))


def candidate_pairs(rows: ObservationTable) -> np.ndarray:
    """
    Choose the pairs of views worth comparing: neighbours in time, and what links the rest.

    Parameters
    ----------
    rows : ObservationTable

    Returns
    -------
    ndarray of int, shape (n, 2)
        Views, the earlier first.

    """
    frames, view, point = rows.frames, rows.view, rows.point
    seen = coo_matrix((np.ones(len(view)), (point, view))).tocsr()
    common = np.asarray((seen.T @ seen).todense())
    a, b = np.triu_indices(len(frames), 1)
    gap = b - a
    # neighbours in time, and the end of a loop that meets its beginning
    wanted = (gap <= SUCCESSORS) | (len(frames) - gap <= SUCCESSORS) | (len(frames) <= 6)
    pairs = np.column_stack([a, b])
    enough = wanted & (common[a, b] >= MINIMUM_MATCHES)
    label = components(pairs[enough], len(frames))
    # photographs in no order: what neighbours leave apart, any pair may join
    across = (common[a, b] >= MINIMUM_MATCHES) & (label[a] != label[b])
    label = components(pairs[enough | across], len(frames))
    enough |= across
    joining = (common[a, b] >= FEWEST_MATCHES) & (label[a] != label[b])
    chosen: np.ndarray = pairs[enough | joining]
    return chosen


def least_agreeing(common: int) -> int:
    """Tell how many of the matches of a pair have to agree."""
    return min(max(common, FEWEST_MATCHES), MINIMUM_MATCHES)


def is_more_than_chance(matches: int, right: float) -> bool:
    """
    Tell whether matches that all agree are more probably all right than some wrong by chance.

    Parameters
    ----------
    matches : int
    right : float
        Share of the matches of other pairs that agree.

    Returns
    -------
    bool

    """
    all_right = right**matches
    return all_right > (1 - all_right) * AGREES_BY_CHANCE**(matches - DETERMINE)


def components(pairs: ArrayLike, count: int) -> np.ndarray:
    """Return the number of the connected set (count,) that every view belongs to."""
    first, second = np.reshape(pairs, (-1, 2)).T
    links = coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    component: np.ndarray = connected_components(links, directed=False)[1]
    return component


class ComparedPair(NamedTuple):
    """
    A pair of views, and matches of some of the points that both see.

    Attributes
    ----------
    a, b : int
        Views.
    both : ndarray of int, shape (n,)
        All points that both see.
    xy : (ndarray, ndarray), shape (m, 2) each
        Pixels of at most `RANSAC_MATCHES` of them in either view.

    """

    a: int
    b: int
    both: np.ndarray
    xy: Sample


def without_still(compared: list[ComparedPair], views: int) -> list[ComparedPair]:
    """Leave out pairs of equal images, which have no epipolar geometry, if all stay linked."""
    moving = [pair for pair in compared if np.percentile(
        np.abs(pair.xy[0] - pair.xy[1]).max(axis=1), 95) > STILL_PX]
    before, after = (components([(pair.a, pair.b) for pair in pairs], views)
                     for pairs in (compared, moving))
    return moving if np.array_equal(before, after) else compared


def compared_pairs(tracks: Tracks, rows: ObservationTable, candidates: np.ndarray,
                   ) -> tuple[list[ComparedPair], np.ndarray]:
    """
    Collect the matches of pairs of views.

    Parameters
    ----------
    tracks : Tracks
    rows : ObservationTable
    candidates : ndarray of int, shape (n, 2)

    Returns
    -------
    list of ComparedPair
    ndarray of bool, shape (N,)
        Observations of a pair with at least `MINIMUM_MATCHES` matches.

    """
    compared, tested = [], np.zeros(len(tracks), bool)
    for a, b in candidates:
        both = rows.shared(a, b)
        tested[rows.row[[a, b]][:, both]] |= len(both) >= MINIMUM_MATCHES
        few = both[np.linspace(0, len(both) - 1, min(len(both), RANSAC_MATCHES)).astype(int)]
        xy = tracks.xy[rows.row[a, few]], tracks.xy[rows.row[b, few]]
        compared.append(ComparedPair(int(a), int(b), both, xy))
    return compared, tested
