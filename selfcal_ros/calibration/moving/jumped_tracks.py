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
Tracks that jump: one still point at first, then another, as on a repeated pattern.

A tracker that takes one tile for its neighbour goes on as if nothing had happened. Each half is a
still point, the whole is none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.inliers import VERIFYING_VIEWS
from selfcal_ros.calibration.bundle.robust_fit import Observations, RobustFit
from selfcal_ros.calibration.moving.track_judgement import (CHANCE, distances, freedom_of,
                                                            instants, judge_scene, scene_of,
                                                            TrackTest)
from selfcal_ros.geometry.distributions import chi2_sf

#: More that jump than these shares, of all and of those that nothing explains besides, are no
#: chance. Gross errors leave up to 0.013 and 0.12, heavy tails 0.006 and 0.2.
FEW_JUMPS, OF_UNEXPLAINED = 0.015, 0.25
#: A jump is wider than this in the images beside it, in sigma: patches that drift part, too.
WIDE = 15.0


def enough_jump(jumped: float, unexplained: float) -> bool:
    """Tell whether tracks jump more often than by chance, of shares of all tracks."""
    return jumped > max(FEW_JUMPS, OF_UNEXPLAINED * unexplained)


def jumps_stand_out(fit: RobustFit, observations: Observations, test: TrackTest) -> bool:
    """Tell whether tracks jump more often than by chance, of those that a fit judged."""
    doubtful = np.flatnonzero(test.tested & ~test.explained)
    total = max(int(test.tested.sum()), 1)
    if not enough_jump(len(doubtful) / total, 0.0):
        return False
    jumped = len(find_jumps(fit, observations, doubtful, VERIFYING_VIEWS - 1))
    return enough_jump(jumped / total, (len(doubtful) - jumped) / total)


def find_jumps(fit: RobustFit, observations: Observations, places: np.ndarray, least: int,
               ) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """
    Find tracks that are one still point, then another, each in at least so many views.

    Frames that repeat one another count once: an error that they share is no second point.

    Parameters
    ----------
    fit : RobustFit
        Its poses are held.
    observations : Observations
    places : ndarray of int, shape (P,)
        Tracks to ask, as the observations count them.
    least : int
        Views of the shorter half.

    Returns
    -------
    dict
        By track the rows of its observations that agree, and which of them are the later part's.

    """
    instant = instants(fit.bundle)
    row, piece, owner, cut = _halves(observations, places, least, instant)
    if not len(owner):
        return {}
    halves = Observations(observations.view[row], piece, observations.xy[row],
                          np.arange(2 * len(owner)), observations.clock,
                          observations.shutter and observations.shutter.select(row),
                          None if observations.neighbours is None
                          else observations.neighbours[row])
    scene = scene_of(fit.bundle, fit.state, halves)
    if scene is None:
        return {}
    test = judge_scene(scene, piece, instant)
    # how far the one half's point is from where the other begins, and the other way round
    bundle, state = scene
    other = np.arange(2 * len(owner)) ^ 1
    across = distances(bundle, replace(state, points=state.points[other]))
    wide = np.minimum(across[cut - 1], across[cut]) > WIDE
    square, lost = (np.add.reduceat(values, np.arange(0, 2 * len(owner), 2))
                    for values in (test.square, test.lost))
    freedom = freedom_of(test.length - test.lost).reshape(-1, 2).sum(axis=1)
    sound = wide & (chi2_sf(square, np.maximum(freedom, 1)) > CHANCE) & (freedom >= 3) & (
        lost <= np.add.reduceat(test.length, np.arange(0, 2 * len(owner), 2)) / 4)
    cost = np.where(sound, square + 16 * lost, np.inf)
    found = {}
    for place in np.unique(owner):
        mine = np.flatnonzero(owner == place)
        best = mine[np.argmin(cost[mine])]
        if np.isfinite(cost[best]):
            own = (piece // 2 == best) & test.agrees
            found[int(place)] = (row[own], piece[own] % 2 == 1)
    return found


def _halves(observations: Observations, places: np.ndarray, least: int, instant: np.ndarray,
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Cut tracks wherever both halves are long enough.

    Returns
    -------
    row, piece : ndarray of int, shape (N,)
        Rows of the observations, one cut after another, and the half: twice the cut's number,
        and one more for the later one.
    owner, cut : ndarray of int, shape (C,)
        The track of every cut, and where its later half begins in the rows.

    """
    first = np.searchsorted(observations.point, places)
    end = np.searchsorted(observations.point, places, side='right')
    rows: list[np.ndarray] = [np.zeros(0, int)]
    part: list[np.ndarray] = [np.zeros(0, int)]
    which: list[int] = []
    where: list[int] = []
    total = 0
    for place, begin, count in zip(places, first, end - first):
        seen = np.unique(instant[observations.view[begin:begin + count]], return_inverse=True)[1]
        for cut in range(least, count - least + 1):
            early, late = seen[cut - 1] + 1, seen[-1] - seen[cut] + 1
            if min(early, late) < least or max(early, late) < VERIFYING_VIEWS:
                continue
            rows.append(np.arange(begin, begin + count))
            part.append(2 * len(which) + (np.arange(count) >= cut))
            which.append(place)
            where.append(total + cut)
            total += count
    return np.concatenate(rows), np.concatenate(part), np.array(which, int), np.array(where, int)
