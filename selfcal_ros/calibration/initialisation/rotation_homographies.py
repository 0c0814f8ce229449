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

import numpy as np

from selfcal_ros.calibration.affine.diac import InfiniteHomographies, unit_determinant
from selfcal_ros.geometry.homography import homography
from selfcal_ros.values.tracks import Tracks

#: Matches that two views need to be joined by a homography.
MIN_MATCHES = 12


def rotation_homographies(tracks: Tracks):
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
    frames = tracks.frames
    matches = {}
    for i, a in enumerate(frames):
        for b in frames[i + 1:]:
            _, xy_a, xy_b = tracks.matches(int(a), int(b))
            if len(xy_a) >= MIN_MATCHES:
                matches[int(a), int(b)] = (xy_a, xy_b)
    shared = {int(f): sum(len(m[0]) for pair, m in matches.items() if f in pair) for f in frames}
    reference = max(shared, key=lambda f: (shared[f], -f))
    found, spread, sigmas = {reference: np.eye(3)}, {reference: np.zeros((9, 9))}, []
    while True:
        # the surest link first: direct ones, then those with many matches
        links = [(len(m[0]), pair) for pair, m in matches.items()
                 if (pair[0] in found) != (pair[1] in found)]
        links.sort(key=lambda link: (reference in link[1], link[0]), reverse=True)
        for _, (a, b) in links:
            old, new = (a, b) if a in found else (b, a)
            xy_old, xy_new = matches[a, b] if a in found else matches[a, b][::-1]
            step = homography(xy_old, xy_new)
            if step:
                H, slope = unit_determinant(step.H)
                found[new] = H @ found[old]
                left, right = np.kron(np.eye(3), found[old].T), np.kron(H, np.eye(3))
                spread[new] = (left @ slope @ step.covariance @ slope.T @ left.T
                               + right @ spread[old] @ right.T)
                sigmas.append(step.sigma_px)
                break
            del matches[a, b]
        else:
            break
    order = [reference, *(int(f) for f in frames if f in found and f != reference)]
    n = len(order) - 1
    covariance = np.zeros((n, 9, n, 9))
    for k, frame in enumerate(order[1:]):
        covariance[k, :, k] = spread[frame]
    H = np.array([found[f] for f in order[1:]]).reshape(n, 3, 3)
    return (np.array(order), InfiniteHomographies(H, covariance.reshape(9 * n, 9 * n)),
            float(np.median(sigmas)) if sigmas else np.nan)
