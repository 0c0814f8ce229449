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

from selfcal_ros.features.selection import KeyframeSelector

#: Displacement between keyframes as a share of what it is where the camera moves: what moves
#: before a camera that stands fills less of the image.
PART_STEP = 0.3
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
