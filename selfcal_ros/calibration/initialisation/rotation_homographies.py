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
"""Homographies of all views from one, chained where two views share too few points."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np
from scipy.sparse import csr_array, triu

from selfcal_ros.calibration.affine.diac import InfiniteHomographies, unit_determinant
from selfcal_ros.geometry.homography import homography
from selfcal_ros.values.tracks import Tracks

#: Matches that two views need to be joined by a homography.
MIN_MATCHES = 12


def rotation_homographies(tracks: Tracks) -> tuple[np.ndarray, InfiniteHomographies, float]:
    """
    Homographies from one reference view to all that are joined with it, through others if need be.

    Parameters
    ----------
    tracks : Tracks
        Pixels.

    Returns
    -------
    frames : ndarray of int, shape (V,)
        The reference, which shares most points with the others, first.
    homographies : InfiniteHomographies
        From the reference to frames[1:]; covariances of chained views add up.
    sigma_px : float
        Median over the pairs of the noise of a coordinate.

    """
    frames, view = np.unique(tracks.frame, return_inverse=True)
    _, point = np.unique(tracks.track, return_inverse=True)
    seen = csr_array((np.ones(len(view), np.int32), (view, point)))
    common = triu(seen @ seen.T, 1, format='coo')
    enough = common.data >= MIN_MATCHES
    pairs = frames[np.column_stack([common.row, common.col])[enough]].tolist()
    counts = common.data[enough].tolist()
    links: dict[int, list[tuple[int, int, int]]] = {int(frame): [] for frame in frames}
    for count, (a, b) in zip(counts, pairs):
        links[a].append((-count, a, b))
        links[b].append((-count, a, b))
    reference = max(links, key=lambda frame: (-sum(link[0] for link in links[frame]), -frame))
    found, spread, sigmas = {reference: np.eye(3)}, {reference: np.zeros((9, 9))}, []
    # the surest link first: direct ones, then those with many matches
    waiting = [(False, *link) for link in links[reference]]
    heapify(waiting)
    while waiting:
        _, _, a, b = heappop(waiting)
        if a in found and b in found:
            continue
        old, new = (a, b) if a in found else (b, a)
        _, xy_old, xy_new = tracks.matches(old, new)
        step = homography(xy_old, xy_new)
        if not step:
            continue
        H, slope = unit_determinant(step.H)
        found[new] = H @ found[old]
        left, right = np.kron(np.eye(3), found[old].T), np.kron(H, np.eye(3))
        spread[new] = (left @ slope @ step.covariance @ slope.T @ left.T
                       + right @ spread[old] @ right.T)
        sigmas.append(step.sigma_px)
        for link in links[new]:
            heappush(waiting, (True, *link))
    order = [reference, *(int(f) for f in frames if f in found and f != reference)]
    # views of one chain share links, but are taken as independent
    homographies = InfiniteHomographies(
        np.array([found[f] for f in order[1:]]).reshape(-1, 3, 3),
        np.array([spread[f] for f in order[1:]]).reshape(-1, 9, 9))
    return np.array(order), homographies, float(np.median(sigmas)) if sigmas else np.nan
