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
"""Which three views to look at together."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from selfcal_ros.values.tracks import Tracks


def dense_tracks(tracks: Tracks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Lay tracks out as an array of views by points.

    Returns
    -------
    frames : ndarray of int, shape (V,)
    identity : ndarray of int, shape (P,)
    xy : ndarray, shape (V, P, 2)
        NaN where a point is not seen.

    """
    frames, row = np.unique(tracks.frame, return_inverse=True)
    identity, column = np.unique(tracks.track, return_inverse=True)
    xy = np.full((len(frames), len(identity), 2), np.nan)
    xy[row, column] = tracks.xy
    return frames, identity, xy


def choose_triplets(xy: np.ndarray, limit: int = 24, least_common: int = 12) -> np.ndarray:
    """
    Choose triplets of views with many common points and much image motion.

    Parameters
    ----------
    xy : ndarray, shape (V, P, 2)
        NaN where a point is not seen.
    limit : int
    least_common : int
        Points that the three views must share.

    Returns
    -------
    ndarray of int, shape (t, 3)
        Row indices, ascending in each row; spread over the sequence. Empty if none qualifies.

    """
    views = len(xy)
    if views <= 7:
        chosen = list(combinations(range(views), 3))
    else:
        gaps = np.unique(np.geomspace(1, (views - 1) // 2, 14).astype(int))
        chosen = [(i, i + g, i + 2 * g) for g in gaps
                  for i in range(0, views - 2 * g, max(1, g // 2, views // 100))]
    candidates: np.ndarray = np.array(chosen, int).reshape(-1, 3)
    seen = np.isfinite(xy[..., 0])
    common = seen[candidates[:, 0]] & seen[candidates[:, 1]] & seen[candidates[:, 2]]
    count = common.sum(axis=1)
    enough = count >= min(least_common, max(seen.shape[1], 1))
    candidates, common, count = candidates[enough], common[enough], count[enough]
    if not len(candidates):
        return candidates
    filled = np.where(seen[..., None], xy, 0.0)
    motion = np.zeros(len(candidates))
    for a, b in ((0, 1), (1, 2)):
        shift = np.linalg.norm(filled[candidates[:, b]] - filled[candidates[:, a]], axis=-1)
        leg = np.sqrt((shift ** 2 * common).sum(axis=1) / count)
        motion = np.minimum(motion, leg) if a else leg
    score = motion * np.sqrt(np.minimum(count, 100))
    # the best of each stretch of the sequence in turn, so that no stretch is left out
    stretch = candidates[:, 1] * min(8, views) // views
    rank = np.empty(len(candidates), int)
    for s in np.unique(stretch):
        of = np.flatnonzero(stretch == s)
        rank[of[np.argsort(-score[of], kind='stable')]] = np.arange(len(of))
    best: np.ndarray = candidates[np.lexsort((-score, rank))[:limit]]
    return best
