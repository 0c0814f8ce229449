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
"""What stands still before a fixed camera, and is set aside: tracks, features, and their edges."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from selfcal_ros.features.detection import Features
from selfcal_ros.features.likeness import look_of
from selfcal_ros.findings.finding import Finding
from selfcal_ros.values.still_tracks import find_still_tracks
from selfcal_ros.values.tracks import Tracks

#: Fewer features than this say nothing, and so many of all stand still where a camera does.
_LEAST, _MOST = 8, 0.25
#: In so many of the images.
_ALWAYS = 0.9
#: A patch reaches so far.
_EDGE_PX = 10.0
#: Features of so many other images are looked up at the same place: within so much, and alike.
_COMPARED, _PLACE_PX, _ALIKE = 12, 1.0, 0.9


def without_still(tracks: Tracks) -> tuple[Tracks, tuple[Finding, ...]]:
    """
    Leave out what a fixed camera sees standing still; nothing where the camera moves.

    Parameters
    ----------
    tracks : Tracks

    Returns
    -------
    Tracks
    findings : tuple of Finding

    """
    still = find_still_tracks(tracks)
    if still is None or not still.fixed_camera:
        return tracks, ()
    rests = np.isin(tracks.track, still.track)
    return without_edges(tracks.select(~rests), tracks.select(rests)), (still.finding(),)


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
    still: list[np.ndarray] = []
    holds: list[bool] = []
    for k, one in enumerate(features):
        others = np.unique(np.linspace(0, count - 1, _COMPARED + 1).round().astype(int))
        others = others[others != k]
        times = np.zeros(len(one.xy))
        for other in others:
            apart, at = trees[other].query(one.xy, distance_upper_bound=_PLACE_PX)
            near = np.flatnonzero(np.isfinite(apart))
            alike = np.einsum('ij,ij->i', look_of(one.sift[near]),
                              look_of(features[other].sift[at[near]]))
            times[near[alike > _ALIKE]] += 1
        holds.append(bool(np.mean(times >= 0.5 * len(others)) > _MOST))
        if count - holds.count(False) < _ALWAYS * count:
            # whatever the images to come show
            return None
        still.append(times >= max(1, 0.15 * len(others)))
    for one, rests in zip(features, still):
        rests |= near_still(one.xy, one.xy[rests])
    rest = np.array([np.count_nonzero(~one) for one in still])
    if np.mean(rest >= _LEAST) < _ALWAYS:
        return None
    return still
