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
Tracks that stand still in the image through a whole recording, while others move.

Such are a wall before which a bolted camera sees a turntable, the robot's own body before a camera
that drives, a reflection, dirt. They say nothing of the motion that calibrates the camera, and
where they are many they would outvote what moves. A far scene is none of them: it stays only
while the camera does not turn. Nor is what a robot sees while it stands: it moves later on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.findings.finding import Finding
from selfcal_ros.values.tracks import Tracks

#: A track is still where three quarters of its positions are near its middle place, and what it
#: goes from its first half to its second is little: less than so many times the noise, within
#: these bounds in pixels; and less than this share of the way that moving ones go meanwhile. One
#: that goes so many times further moves.
STILL_SIGMAS, STILL_PX, STILL_SHARE_OF_WAY = 2.5, (0.5, 2.0), 0.06
MOVES = 2.0
#: Of a normal distribution in the plane, the median distance over that of the third quartile.
TO_MEDIAN = 0.7071
#: Shorter ways of the others tell nothing, pixels.
LEAST_WAY_PX = 6.0
#: Where more than this share of the tracks stands still, nothing moves.
NEARLY_ALL = 0.98
#: So many tracks at a time have to move, and to stand still, with this share of all.
LEAST_TRACKS, LEAST_SHARE = 8, 0.1
#: They stand still over so much of the way of the others: always.
ALWAYS = 0.9
#: Points at many distances move by little, too: so many times more have to be still.
DISTINCT = 3.0
#: Of tracks with no more positions than this one gross error hides whether they are still.
SHORT = 5
#: With this share of all tracks in so many quarters of the image they are what a fixed camera
#: looks at, beside what moves; the quarters hold this share of them, at least.
OF_FIXED_CAMERA, QUARTERS, OF_QUARTER = 0.6, 3, 0.1


@dataclass(frozen=True)
class StillTracks:
    """
    What stands still while the rest moves.

    Attributes
    ----------
    track : ndarray of int, shape (P,)
        Identities, ascending.
    share : float
        Of all observations.
    fixed_camera : bool
        Whether they are most of what is seen, nearly all over the image: the camera stands then,
        and what moves is before it.

    """

    track: np.ndarray
    share: float
    fixed_camera: bool

    def finding(self) -> Finding:
        """Tell a user."""
        return Finding('fixed_camera' if self.fixed_camera else 'still_tracks',
                       tracks=len(self.track), share=self.share)


@dataclass(frozen=True)
class TrackExtents:
    """
    How far tracks go in the image.

    Attributes
    ----------
    names, first, count : ndarray of int, shape (P,)
        Identity of each track, where its observations begin, and how many they are.
    of : ndarray of int, shape (N,)
        Which of the tracks each observation is of.
    extent : ndarray, shape (P,)
        Pixels.
    limit : float
        Below this a track stands still, pixels.

    """

    names: np.ndarray
    first: np.ndarray
    count: np.ndarray
    of: np.ndarray
    extent: np.ndarray
    limit: float

    @classmethod
    def measured(cls, tracks: Tracks) -> TrackExtents | None:
        """Measure tracks; None where there are none."""
        if not len(tracks):
            return None
        xy = tracks.xy
        names, first, count = np.unique(tracks.track, return_index=True, return_counts=True)
        of = np.repeat(np.arange(len(names)), count)
        away = np.linalg.norm(xy - _middles(xy, of, first, count)[of], axis=1)
        # a camera that comes back, as to two views of three, has not stood still meanwhile
        scatter = TO_MEDIAN * _ordered(away, of)[first + 3 * count // 4]
        limit = float(np.clip(STILL_SIGMAS * _noise_px(xy, of), *STILL_PX))
        return cls(names, first, count, of, np.maximum(scatter, _moved(xy, of, first, count)),
                   limit)

    @property
    def nothing_moves(self) -> bool:
        """Whether all images show the same: nearly every point stays where it is."""
        several = self.count > 1
        return bool(several.any() and np.mean(self.extent[several] < self.limit) > NEARLY_ALL)


def find_still_tracks(tracks: Tracks, extents: TrackExtents | None = None) -> StillTracks | None:
    """
    Find what stands still all the time that other tracks move.

    Parameters
    ----------
    tracks : Tracks
        Of a whole recording, or of its keyframes.
    extents : TrackExtents, optional
        Of these tracks, where they are known.

    Returns
    -------
    StillTracks or None
        None where nothing stands still all the time, or nothing else moves.

    """
    extents = extents or TrackExtents.measured(tracks)
    if extents is None:
        return None
    names, first, count, of = extents.names, extents.first, extents.count, extents.of
    extent, limit = extents.extent, extents.limit
    time = np.unique(tracks.frame, return_inverse=True)[1].ravel()
    begin, end = time[first], time[first + count - 1]
    mover = extent > MOVES * limit
    steps = int(time.max())
    way = _way(extent, mover, begin, end, steps)
    total = np.concatenate([[0], np.cumsum(way)])
    own_way = total[end] - total[begin]
    judged = own_way > LEAST_WAY_PX
    near = extent < limit
    still = near & judged & (extent < STILL_SHARE_OF_WAY * own_way)
    slow = judged & ~still & (extent < 4 * limit) & (extent < own_way / 4)
    if still.sum() < max(LEAST_TRACKS, DISTINCT * slow.sum()) or mover.sum() < LEAST_TRACKS:
        return None
    there = _present(still, begin, end, steps)
    seen = _present(judged, begin, end, steps)
    always = (there >= LEAST_TRACKS) & (there >= LEAST_SHARE * seen)
    if way[always].sum() < ALWAYS * way.sum():
        return None
    # what hardly moves may be either, and tells little; nor does a short track that rested once
    rested = (count <= SHORT) & (_least_step(tracks.xy, of, len(names)) < limit)
    chosen = still | ~mover | rested
    share = float(count[chosen].sum() / count.sum())
    return StillTracks(names[chosen], share, share > OF_FIXED_CAMERA and _is_spread(
        tracks.xy[first][still], tracks.xy, tracks.image_size))


def _noise_px(xy: np.ndarray, of: np.ndarray) -> float:
    """Estimate the noise of a coordinate from the quieter part of the second differences."""
    bend = np.diff(xy, 2, axis=0)[(of[2:] == of[:-2])]
    # |x| < 0.385 sigma in 30 % of all cases; the variances of three positions add up to 6
    return float(np.percentile(np.abs(bend), 30)) / (0.385 * np.sqrt(6)) if len(bend) else 0.0


def _middles(xy: np.ndarray, of: np.ndarray, first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return the median place of every track, (P, 2)."""
    return np.stack([_middle(axis, of, first, count) for axis in xy.T], axis=1)


def _middle(values: np.ndarray, of: np.ndarray, first: np.ndarray, count: np.ndarray,
            ) -> np.ndarray:
    """Return the median of every track, (P,): the mean of the two in the middle."""
    ordered = _ordered(values, of)
    middle: np.ndarray = (ordered[first + (count - 1) // 2] + ordered[first + count // 2]) / 2
    return middle


def _ordered(values: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Return the values of every track by their size, one track after the other."""
    ordered: np.ndarray = values[np.lexsort((values, of))]
    return ordered


def _moved(xy: np.ndarray, of: np.ndarray, first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return how far every track went from its first half to its second, pixels (P,)."""
    place = np.arange(len(xy)) - first[of]
    half = (count + 1) // 2
    ends = []
    for chosen in (place < half[of], place >= (count - half)[of]):
        part = of[chosen]
        _, begin, number = np.unique(part, return_index=True, return_counts=True)
        ends.append(_middles(xy[chosen], part, begin, number))
    moved: np.ndarray = np.linalg.norm(ends[1] - ends[0], axis=1)
    return moved


def _least_step(xy: np.ndarray, of: np.ndarray, tracks: int) -> np.ndarray:
    """Return the shortest step of every track, pixels (P,)."""
    least = np.full(tracks, np.inf)
    within = of[1:] == of[:-1]
    np.minimum.at(least, of[1:][within], np.linalg.norm(np.diff(xy, axis=0)[within], axis=1))
    return least


def _way(moved: np.ndarray, mover: np.ndarray, begin: np.ndarray, end: np.ndarray, steps: int,
         ) -> np.ndarray:
    """Return how far the faster moving tracks go in every step, pixels (steps,)."""
    # the middles of the halves are half of a track apart, but of two positions
    speed = np.where(end - begin < 2, 1, 2) * moved / np.maximum(end - begin, 1)
    way = np.zeros(steps)
    for step in range(steps):
        present = speed[(begin <= step) & (end > step) & mover]
        if len(present) >= LEAST_TRACKS:
            way[step] = np.percentile(present, 80)
    return way


def _present(which: np.ndarray, begin: np.ndarray, end: np.ndarray, steps: int) -> np.ndarray:
    """Count the tracks that span every step, (steps,)."""
    change = np.bincount(begin[which], minlength=steps + 1).astype(int)
    change -= np.bincount(end[which], minlength=steps + 1)
    return np.cumsum(change)[:steps]


def _is_spread(places: np.ndarray, xy: np.ndarray, size: tuple[int, int] | None) -> bool:
    """Tell whether places (P, 2) lie in most quarters of the image."""
    middle = np.array(size) / 2 if size is not None else (xy.min(axis=0) + xy.max(axis=0)) / 2
    quarter = (places > middle) @ [1, 2]
    share = np.bincount(quarter, minlength=4) / max(len(places), 1)
    return bool((share >= OF_QUARTER).sum() >= QUARTERS)
