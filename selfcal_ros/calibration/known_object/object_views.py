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
"""What the views of a known object saw of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.object_bend import Bend
from selfcal_ros.calibration.bundle.object_model import KnownPoints
from selfcal_ros.calibration.bundle.object_rows import ObjectRows
from selfcal_ros.calibration.bundle.priors import Priors
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.known_object.object_start import linear_view, LinearView
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.tracks import Tracks


@dataclass(frozen=True)
class ObjectViews:
    """
    Observations by view, in a centred frame of the object with unit extent.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
    view, point : ndarray of int, shape (N,)
        View of each observation, ascending, and the object's point.
    points : ndarray, shape (N, 3)
        Of the object, one for every observation.
    xy : ndarray, shape (N, 2)
        Pixels.
    linear : list of LinearView
    bend : Bend, optional
        How the object may bend.
    rows : ObjectRows, optional
        How it may move while each image is read.

    """

    frames: np.ndarray
    view: np.ndarray
    point: np.ndarray
    points: np.ndarray
    xy: np.ndarray
    linear: list[LinearView]
    bend: Bend | None = None
    rows: ObjectRows | None = None

    def bundle(self, priors: Priors, sigma_px: float) -> Bundle[ObjectState]:
        """Return the adjustment of these observations."""
        return Bundle(KnownPoints(self.points, self.bend, self.rows), self.view, self.view,
                      self.xy, priors=priors, sigma_px=sigma_px)

    def select(self, mask: np.ndarray) -> ObjectViews:
        """Keep the observations in mask, of views that keep at least four."""
        mask = mask & (np.bincount(self.view[mask], minlength=len(self.frames)) >= 4)[self.view]
        kept, index = np.unique(self.view[mask], return_inverse=True)
        bend = self.bend and replace(self.bend, modes=self.bend.modes[mask])
        return ObjectViews(self.frames[kept], index, self.point[mask], self.points[mask],
                           self.xy[mask], [self.linear[v] for v in kept], bend, self.rows)


def gathered_views(tracks: Tracks, target: KnownObject,
                   ) -> tuple[ObjectViews, tuple[Finding, ...]] | NoEstimate:
    """Return the views that can be used, and what was left out."""
    place = np.minimum(np.searchsorted(target.identity, tracks.track), len(target) - 1)
    known = target.identity[place] == tracks.track
    if not known.any():
        return NoEstimate('no_common_numbers')
    findings: tuple[Finding, ...] = ()
    if not known.all():
        findings += (Finding('points_of_no_object', count=int(np.count_nonzero(~known))),)
    order = np.lexsort((tracks.track, tracks.frame))
    order = order[known[order]]
    frame, place, xy = tracks.frame[order], place[order], tracks.xy[order]
    frames, view = np.unique(frame, return_inverse=True)
    everything = ObjectViews(frames, view, place, target.points[place], xy, [])
    first = np.searchsorted(view, np.arange(len(frames) + 1))
    found = [linear_view(everything.points[a:b], xy[a:b], int(f))
             for f, a, b in zip(frames, first, first[1:])]
    refused = [one for one in found if isinstance(one, NoEstimate)]
    good = np.array([isinstance(one, LinearView) for one in found])
    if not good.any():
        return NoEstimate('no_usable_view', why=refused[0])
    if refused:
        findings += (Finding('views_left_out', count=len(refused), why=refused[0]),)
    # those that are refused are left out at once
    everything = replace(everything, linear=cast(list[LinearView], found))
    return everything.select(good[view]), findings
