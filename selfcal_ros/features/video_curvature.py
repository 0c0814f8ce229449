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
Positions of a video's keyframes without what the curvature of warps feigns.

A point is registered against its first appearance, or a later one where it has grown or shrunk by
much. Such a template shows the point where it was found, and so carries what was feigned there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.features.curvature import along_tracks, EpipolarGeometry, feigned_shift
from selfcal_ros.features.klt import Appearances
from selfcal_ros.features.selection import Verified
from selfcal_ros.values.tracks import Tracks


@dataclass(frozen=True)
class KeptFrame:
    """
    A frame that was kept.

    Attributes
    ----------
    index : int
        Of the frame in the video.
    ids : ndarray of int, shape (N,)
        Points that are followed.
    xy : ndarray, shape (N, 2)
        Pixels.
    appearances : Appearances
        Their templates and warps.

    """

    index: int
    ids: np.ndarray
    xy: np.ndarray
    appearances: Appearances


def without_feigned_shifts(verified: Verified, kept: Sequence[KeptFrame]) -> Tracks:
    """
    Take off what curvature feigns.

    Parameters
    ----------
    verified : Verified
        Tracks made of the keyframes, and the geometry between these.
    kept : sequence of KeptFrame

    Returns
    -------
    Tracks
        The same observations.

    """
    tracks = verified.tracks
    if not len(tracks):
        return tracks
    seen = np.column_stack([np.repeat([one.index for one in kept], [len(one.ids) for one in kept]),
                            np.concatenate([one.xy for one in kept])])
    row = _same_rows(np.column_stack([tracks.frame, tracks.xy]), seen)
    anchors, affine, response = (
        np.concatenate([getattr(one.appearances, name) for one in kept])[row]
        for name in ('anchors', 'affine', 'response'))
    geometry = EpipolarGeometry.of([(*one, verified.lens) for one in verified.fitted],
                                   len(verified.frames))
    # a template taken anew begins a track of its own here, where it was taken if that is known
    begins = np.any(np.diff(np.column_stack([tracks.track, anchors]), axis=0, prepend=-1), axis=1)
    label, first = np.cumsum(begins) - 1, np.flatnonzero(begins)[1:]
    known = first[(tracks.track[first] == tracks.track[first - 1])
                  & (anchors[first] == tracks.xy[first - 1]).all(axis=1)]
    rows = np.concatenate([np.arange(len(tracks)), known - 1])
    reference = np.concatenate([begins, np.ones(len(known), bool)])
    reference[known] = False
    second = along_tracks(
        geometry, np.searchsorted(verified.frames, tracks.frame)[rows],
        np.concatenate([label, label[known]]), reference, tracks.xy[rows],
        np.concatenate([affine, np.tile(np.eye(2), (len(known), 1, 1))]))[:len(tracks)]
    shift = feigned_shift(response, affine, second)
    shift = _carried_on(shift, affine, tracks.track, begins)
    # in the images just before and after, the same templates feign the same
    beside = tracks.neighbours
    if beside is not None:
        beside = beside - np.pad(shift, ((0, 0), (0, 1)))[:, None]
    return replace(tracks, xy=tracks.xy - shift, neighbours=beside)


def _carried_on(shift: np.ndarray, affine: np.ndarray, track: np.ndarray, begins: np.ndarray,
                ) -> np.ndarray:
    """Add to shifts (N, 2) those at which a template was taken anew: it shows a point beside."""
    new_track = np.diff(track, prepend=-1) != 0
    anew = np.cumsum(begins) - np.cumsum(begins)[np.maximum.accumulate(
        np.where(new_track, np.arange(len(track)), 0))]
    last = np.maximum.accumulate(np.where(begins, np.arange(len(track)), 0)) - 1
    shift = shift.copy()
    for times in range(1, int(anew.max(initial=0)) + 1):
        rows = np.flatnonzero(anew == times)
        shift[rows] += np.einsum('nij,nj->ni', affine[rows], shift[last[rows]])
    return shift


def _same_rows(wanted: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Find each of wanted (N, k) among rows (M, k), which hold it once."""
    _, label = np.unique(np.concatenate([rows, wanted]), axis=0, return_inverse=True)
    label = label.ravel()
    place = np.empty(len(rows) + len(wanted), int)
    place[label[:len(rows)]] = np.arange(len(rows))
    found: np.ndarray = place[label[len(rows):]]
    return found
