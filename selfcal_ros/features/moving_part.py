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
What moves before a camera that stands: a turntable before a wall, a part on a conveyor.

The wall has most of the points, and neither they nor the first images tell what is to be kept.
So the whole recording is watched: while most points stay where they were first seen and some go
far, the images that count are those between which the latter move.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from selfcal_ros.features.matching import Features
from selfcal_ros.features.selection import KeyframeSelector
from selfcal_ros.values.tracks import Tracks

#: A point that stays so near to where it was first seen stands still; further off it moves.
_STILL_PX, _MOVES_PX = 1.5, 3.0
#: Points are judged after the others went so far, and the camera after so much more.
_JUDGED_PX, _DECIDED_PX = 6.0, 30.0
#: Fewer moving points than this say nothing.
_LEAST = 8
#: Of the points that are judged so many stand still, over so much of the way of the others.
_MOST, _ALWAYS = 0.5, 0.9
#: From one image to the next so far at most.
_STEP_PX = 0.7
#: Where so many points an image are lost, of as many that move, these cannot be followed.
_LOST, _LOST_SHARE = 10, 0.4
#: A patch reaches so far.
_EDGE_PX = 10.0
#: Features of so many other images are looked up at the same place: within so much, and alike.
_COMPARED, _PLACE_PX, _ALIKE = 12, 1.0, 0.9


class MovingPart:
    """
    Watch whether a camera stands, and choose keyframes by what moves before it.

    Parameters
    ----------
    displacement_px : float
        Median displacement of what moves that makes a new keyframe.

    """

    def __init__(self, displacement_px: float):
        """Start without an image."""
        self.selector = KeyframeSelector(displacement_px)
        self._ids = np.empty(0, np.int64)
        self._xy = self._origin = np.empty((0, 2))
        self._reach = self._born = np.empty(0)
        self._way = self._way_standing = 0.0
        self._images = self._resting = self._lost = self._moved = 0

    @property
    def is_possible(self) -> bool:
        """Tell whether the camera may have stood so far."""
        return self._way < _DECIDED_PX or self._way_standing > (_ALWAYS - 0.1) * self._way

    @property
    def stood(self) -> bool:
        """Tell whether the camera stood all the time while something moved."""
        return self._way >= _DECIDED_PX and self._way_standing > _ALWAYS * self._way

    @property
    def is_too_fast(self) -> bool:
        """Tell whether the camera stood, and what moves before it could not be followed."""
        return (self._resting >= 0.95 * self._images > 0
                and self._lost > _LOST_SHARE * self._moved
                and self._lost > _LOST * self._images)

    def offer(self, ids: np.ndarray, xy: np.ndarray) -> bool:
        """
        Tell whether this image becomes a keyframe if the camera stands.

        Parameters
        ----------
        ids : ndarray of int, shape (N,)
            Tracks seen, ascending.
        xy : ndarray, shape (N, 2)
            Pixels.

        """
        _, here, there = np.intersect1d(ids, self._ids, assume_unique=True, return_indices=True)
        origin, reach, step = xy.copy(), np.zeros(len(ids)), np.zeros(len(ids))
        born = np.full(len(ids), np.inf)
        if len(here):
            origin[here], born[here] = self._origin[there], self._born[there]
            step[here] = np.linalg.norm(xy[here] - self._xy[there], axis=1)
            reach[here] = np.maximum(self._reach[there],
                                     np.linalg.norm(xy[here] - origin[here], axis=1))
            self._count(step[here], len(self._ids))
        moves = reach > _MOVES_PX
        if moves.sum() >= _LEAST:
            way = float(np.percentile(step[moves], 80))
            self._way += way
            judged = self._way - born > _JUDGED_PX
            still = judged & (reach < _STILL_PX)
            early = self._way < 2 * _JUDGED_PX
            self._way_standing += way * (early or still.sum() >= max(
                _LEAST, _MOST * judged.sum()))
        self._ids, self._xy, self._origin, self._reach, self._born = (
            ids.copy(), xy.copy(), origin, reach, np.minimum(born, self._way))
        return bool(moves.sum() >= _LEAST and self.selector.offer(ids[moves], xy[moves]))

    def _count(self, step: np.ndarray, before: int) -> None:
        """Count what stayed, moved and was lost since the last image."""
        self._images += 1
        resting = int(np.sum(step < _STEP_PX))
        self._resting += 2 * resting > before
        self._moved += len(step) - resting
        self._lost += before - len(step)


def near_still(xy: np.ndarray, still_xy: np.ndarray) -> np.ndarray:
    """
    Tell which points lie so near to what stands still that their patches show both, (N,) of bool.

    Where a thing ends before a wall, there is a corner that belongs to neither.
    """
    if not len(still_xy) or not len(xy):
        return np.zeros(len(xy), bool)
    apart: np.ndarray = cKDTree(still_xy).query(xy)[0]
    return apart < _EDGE_PX


def without_edges(tracks: Tracks, still: Tracks) -> Tracks:
    """
    Leave out positions beside what stands still in the same image, see `near_still`.

    Parameters
    ----------
    tracks, still : Tracks
        What moves, and what does not.

    """
    keep = np.ones(len(tracks), bool)
    for frame in tracks.frames:
        rows = np.flatnonzero(tracks.frame == frame)
        keep[rows] = ~near_still(tracks.xy[rows], still.xy[still.frame == frame])
    return tracks.select(keep).with_at_least(2)


def still_features(features: list[Features]) -> list[np.ndarray] | None:
    """
    Find features that come back at the same place of image after image.

    Parameters
    ----------
    features : list of Features
        Of all images.

    Returns
    -------
    list of ndarray of bool or None
        By image which features stand still; None where the camera does not.

    """
    count = len(features)
    if count < 3 or min(len(one.xy) for one in features) < _LEAST:
        return None
    trees = [cKDTree(one.xy) for one in features]
    still, holds = [], []
    for k, one in enumerate(features):
        others = np.unique(np.linspace(0, count - 1, _COMPARED + 1).round().astype(int))
        others = others[others != k]
        times = np.zeros(len(one.xy))
        for other in others:
            apart, at = trees[other].query(one.xy, distance_upper_bound=_PLACE_PX)
            near = np.flatnonzero(np.isfinite(apart))
            alike = np.einsum('ij,ij->i', one.descriptors[near],
                              features[other].descriptors[at[near]])
            times[near[alike > _ALIKE]] += 1
        holds.append(np.mean(times >= 0.5 * len(others)) > _MOST / 2)
        still.append(times >= max(1, 0.15 * len(others)))
    for one, rests in zip(features, still):
        rests |= near_still(one.xy, one.xy[rests])
    rest = np.array([np.count_nonzero(~one) for one in still])
    if np.mean(holds) < _ALWAYS or np.mean(rest >= _LEAST) < _ALWAYS:
        return None
    return still
