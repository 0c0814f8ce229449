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
"""Which frames and which tracks are worth keeping: keyframes, verification, static points."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import os

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.features.epipolar import choose_division, EpipolarImages
from selfcal_ros.geometry.division import DivisionModel
from selfcal_ros.values.tracks import Tracks


@dataclass(frozen=True)
class Verified:
    """
    Tracks that obey the epipolar geometry of their frames.

    Attributes
    ----------
    tracks : Tracks
    removed : int
        Observations removed, not counting those of tracks that became too short.
    lens : DivisionModel
        Distortion used.
    frames : ndarray of int, shape (F,)
        The frames that were compared.
    fitted : list of (int, int, ndarray of shape (3, 3))
        Positions of two of them, and their fundamental matrix as `EpipolarImages` has it.

    """

    tracks: Tracks
    removed: int
    lens: DivisionModel
    frames: np.ndarray
    fitted: list[tuple[int, int, np.ndarray]]


class KeyframeSelector:
    """
    Choose keyframes by parallax while frames arrive.

    Parameters
    ----------
    displacement_px : float
        Median displacement of the common tracks since the last keyframe that makes a new one.
    lost_share : float
        So does the loss of this share of the last keyframe's tracks.

    """

    def __init__(self, displacement_px: float, lost_share: float = 0.35):
        """Start without a keyframe."""
        self.displacement_px = displacement_px
        self.lost_share = lost_share
        self._ids: np.ndarray | None = None
        self._xy = np.empty((0, 2))

    def offer(self, ids: np.ndarray, xy: np.ndarray) -> bool:
        """
        Tell whether this frame becomes a keyframe, and remember it if so.

        Parameters
        ----------
        ids : ndarray of int, shape (N,)
            Tracks seen, ascending.
        xy : ndarray, shape (N, 2)
            Pixels.

        """
        if self._ids is not None:
            _, here, there = np.intersect1d(ids, self._ids, assume_unique=True,
                                            return_indices=True)
            kept = len(here) / max(len(self._ids), 1)
            displacement = np.linalg.norm(xy[here] - self._xy[there], axis=1)
            moved = len(here) and np.median(_moving(displacement, self.displacement_px)
                                            ) >= self.displacement_px
            if not moved and kept >= 1 - self.lost_share:
                return False
        elif not len(ids):
            return False
        self._ids, self._xy = ids.copy(), xy.copy()
        return True


def _moving(displacement: np.ndarray, wanted_px: float) -> np.ndarray:
    """Leave out what hardly moves where it is a large part: the robot's own body."""
    fast = displacement > wanted_px / 5
    if fast.mean() < 0.6 and fast.sum() >= max(20, 0.15 * len(fast)):
        return displacement[fast]
    return displacement


def image_speeds(tracks: Tracks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return how fast points move in the image, from each place of a track to its next.

    Returns
    -------
    time : ndarray of int, shape (N,)
        Row of the frame of every observation, among the frames that there are.
    step : ndarray of int, shape (S,)
        Observations that another one of their track follows.
    speed : ndarray, shape (S,)
        Pixels a frame that there is.

    """
    time = np.unique(tracks.frame, return_inverse=True)[1].ravel()
    # rows are sorted by track, then frame: steps lie next to each other
    step = np.flatnonzero(np.diff(tracks.track) == 0)
    return time, step, (np.linalg.norm(tracks.xy[step + 1] - tracks.xy[step], axis=1)
                        / (time[step + 1] - time[step]))


def drop_static(tracks: Tracks, still_px: float = 0.5, moving_px: float = 3.0,
                ) -> tuple[Tracks, int]:
    """
    Drop points that do not move in the image while the scene does.

    Such are dirt on the lens, the robot's own body, and the background of a turntable. A point
    counts as static when it stays within `still_px` of its mean position over at least two steps.
    In these, other points move by more than `moving_px`. A far scene moves while the camera turns,
    and stays.

    Parameters
    ----------
    tracks : Tracks
    still_px, moving_px : float
        Pixels.

    Returns
    -------
    tracks : Tracks
        The rest.
    dropped : int
        Number of tracks dropped.

    """
    if not len(tracks):
        return tracks, 0
    track, inverse, count = np.unique(tracks.track, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    mean = np.stack([np.bincount(inverse, tracks.xy[:, k]) / count for k in (0, 1)], axis=1)
    deviation = np.linalg.norm(tracks.xy - mean[inverse], axis=1)
    reach = np.zeros(len(track))
    np.maximum.at(reach, inverse, deviation)
    time, step, speed = image_speeds(tracks)
    views = time.max() + 1
    seen = np.bincount(time[step], minlength=views)
    fast = np.bincount(time[step], speed > moving_px, minlength=views)
    moving = (fast >= 20) & (fast >= 0.05 * seen)
    total = np.concatenate([[0], np.cumsum(moving)])
    first = np.searchsorted(tracks.track, track)
    steps = total[time[first + count - 1]] - total[time[first]]
    static = (reach < still_px) & (steps >= 2)
    # with only one step to judge by, the scene must move a lot for certain
    median = np.array([np.median(speed[time[step] == k]) if seen[k] >= 20 else 0.0
                       for k in range(views)])
    static |= (reach < still_px) & (steps == 1) & (median[time[first]] > 4 * moving_px)
    return tracks.select(~static[inverse]), int(static.sum())


def verify(tracks: Tracks, gaps: Sequence[int] = (1, 2, 3, 4), threshold_px: float = 1.5,
           least_views: int = 2, seed: int = 0, fresh: int = 0) -> Verified:
    """
    Remove what contradicts the epipolar geometry between frames.

    Every two frames `gaps` apart test the observations that they share. An observation that
    fails most of its tests goes; a track that fails between two neighbours, although both are
    sound otherwise, is cut in two there (the tracker slipped from one point to another).

    Parameters
    ----------
    tracks : Tracks
        With image_size.
    gaps : tuple of int
        Steps between the frames of a pair.
    threshold_px : float
        Largest distance to the epipolar line.
    least_views : int
        Shorter tracks are dropped.
    seed : int
        State of the sampler of F.
    fresh : int
        Numbers from here on are those of no track; beyond the largest by default.

    Returns
    -------
    Verified

    """
    frames, time = np.unique(tracks.frame, return_inverse=True)
    rows = [np.flatnonzero(time.ravel() == k) for k in range(len(frames))]
    pairs, places = [], []
    for gap in gaps:
        for k in range(len(frames) - gap):
            _, a, b = np.intersect1d(tracks.track[rows[k]], tracks.track[rows[k + gap]],
                                     assume_unique=True, return_indices=True)
            if len(a) >= 20:
                pairs.append((rows[k][a], rows[k + gap][b]))
                places.append((k, k + gap))
    spread = [pairs[k] for k in np.unique(np.linspace(0, len(pairs) - 1, 6).astype(int))] \
        if pairs else []
    size = tracks.image_size
    if size is None:
        raise ArgumentError('Tracks need their image size to be verified.')
    model = choose_division([(tracks.xy[a], tracks.xy[b]) for a, b in spread], size, seed=seed)
    epipolar, xy = EpipolarImages(model), tracks.xy
    tests, failures = np.zeros(len(tracks)), np.zeros(len(tracks))
    breaks, sound = [], []
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        fitted = epipolar.fit_each([(xy[a], xy[b]) for a, b in pairs], threshold_px, seed, pool)
    for place, (a, b), F in zip(places, pairs, fitted):
        if F is None:
            continue
        bad = np.abs(epipolar.distance(F, xy[a], xy[b])) > threshold_px
        if bad.mean() > 0.5:  # this F explains nothing
            continue
        sound.append((*place, F))
        for side in (a, b):
            tests[side] += 1
            failures[side] += bad
        breaks.append(np.stack([a[bad], b[bad]], axis=1))
    keep = failures <= 0.5 * tests
    removed = int((~keep).sum())
    track = tracks.track.copy()
    if breaks:
        torn = np.concatenate(breaks)
        left = np.flatnonzero(keep)
        # position of every row among those left: neighbours in a track differ by one
        position = np.full(len(tracks), -5)
        position[left] = np.arange(len(left))
        torn = torn[position[torn[:, 1]] - position[torn[:, 0]] == 1]
        cut = np.zeros(len(tracks), int)
        cut[torn[:, 1]] = 1
        new = np.concatenate([[0], (np.diff(track) != 0).astype(int)])
        _, track = np.unique(np.cumsum(np.maximum(new, cut)), return_inverse=True)
        track = _keep_names(tracks.track, track.ravel(), fresh)
    beside = None if tracks.neighbours is None else tracks.neighbours[keep]
    tracks = Tracks(tracks.frame[keep], track[keep], tracks.xy[keep], size, tracks.stamps_ns,
                    beside)
    return Verified(tracks.with_at_least(least_views), removed, model, frames, sound)


def _keep_names(old: np.ndarray, new: np.ndarray, fresh: int) -> np.ndarray:
    """Give the first part of every track its old number, the parts cut off fresh ones."""
    _, first = np.unique(new, return_index=True)
    names = old[first].copy()
    repeated = np.concatenate([[False], names[1:] == names[:-1]])
    names[repeated] = max(int(old.max()) + 1, fresh) + np.arange(repeated.sum())
    kept: np.ndarray = names[new]
    return kept
