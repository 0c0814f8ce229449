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
Views that all show one plane: what contradicts their homographies goes.

Of a plane every fundamental matrix through its homography is as good as another. Gross errors find
one that suits them, and look like parallax. The homographies are determined, and tell the gross
errors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.inliers import verified
from selfcal_ros.calibration.initialisation.initial_structure import PairGeometry
from selfcal_ros.calibration.initialisation.view_graph import ViewGraph
from selfcal_ros.geometry.homography import homography
from selfcal_ros.geometry.projective import homogeneous

#: A plane leaves no more than so many times the noise of the epipolar geometry, or so many pixels:
#: where matches drift, F follows them and homographies cannot.
NOISE_RATIO, FLAT_PX = 3.0, 0.15
#: Matches further off, in units of what homographies leave and in pixels, lie on no plane, or are
#: wrong.
OFF_SIGMAS, OFF_PX = 4.0, 0.5
#: Of a pair's matches so many have to lie on it, in so many of the pairs.
ON_PLANE, PAIRS = 0.9, 0.8
#: So many pairs tell whether it is worth while to look at all.
SAMPLE = 6


def on_one_plane(graph: ViewGraph) -> ViewGraph | None:
    """
    Return views of a plane with what lies on it alone.

    Parameters
    ----------
    graph : ViewGraph

    Returns
    -------
    ViewGraph or None
        None where homographies do not explain nearly all matches.

    """
    chosen = np.unique(np.linspace(0, len(graph.pairs) - 1, SAMPLE).astype(int))
    if not _agree([_on_plane(graph.pairs[k], graph) for k in chosen]):
        return None
    found = [_on_plane(pair, graph) for pair in graph.pairs]
    if not _agree(found):
        return None
    identity, point = np.unique(graph.tracks.track, return_inverse=True)
    view = np.searchsorted(graph.frames, graph.tracks.frame)
    row = np.full((len(graph.frames), len(identity)), -1)
    row[view, point] = np.arange(len(graph.tracks))
    # pairs number the points of all tracks that were given
    names = identity if graph.given is None else np.unique(graph.given.track)
    votes, used, pairs, sigmas = np.zeros(len(view)), np.zeros(len(view)), [], []
    for pair, one in zip(graph.pairs, found):
        if one is None:
            continue
        on_plane, sigma_px = one
        known = np.isin(names[pair.track], identity)
        at = np.searchsorted(identity, names[pair.track])
        for side in (pair.first, pair.second):
            rows = row[side, at[known]]
            used[rows[rows >= 0]] += 1
            votes[rows[rows >= 0]] += on_plane[known][rows >= 0]
        sigmas.append(sigma_px)
        pairs.append(replace(pair, track=pair.track[on_plane], xy_first=pair.xy_first[on_plane],
                             xy_second=pair.xy_second[on_plane]))
    keep = votes >= 0.5 * np.maximum(used, 1)
    kept = graph.tracks.select(keep & verified(point, keep)).with_at_least(2)
    if len(np.unique(kept.frame)) < len(graph.frames):
        return None
    return replace(graph, tracks=kept, pairs=pairs, parallax=1.0, usual_parallax=1.0,
                   noise_px=max(float(np.median(sigmas)), graph.noise_px),
                   rejected=graph.rejected + int(np.sum(~keep)))


def _agree(found: list[tuple[np.ndarray, float] | None]) -> bool:
    """Tell whether so many pairs show one plane."""
    return float(np.mean([one is not None for one in found])) >= PAIRS


def _on_plane(pair: PairGeometry, graph: ViewGraph) -> tuple[np.ndarray, float] | None:
    """Which matches lie on the plane, and what it leaves of a coordinate; None if it is none."""
    noise_px, xy_first, xy_second = graph.noise_px, pair.xy_first, pair.xy_second
    if graph.lens is not None:
        # a lens bends what a plane shows, and no homography follows that
        xy_first, xy_second = map(graph.lens.straightened, (xy_first, xy_second))
        if not (np.isfinite(xy_first).all() and np.isfinite(xy_second).all()):
            return None
    found = homography(xy_first, xy_second)
    limit_px = max(NOISE_RATIO * noise_px, FLAT_PX)
    if not found or found.sigma_px > limit_px:
        return None
    off = np.zeros(len(pair.track))
    for matrix, source, target in ((found.H, xy_first, xy_second),
                                   (np.linalg.inv(found.H), xy_second, xy_first)):
        there = homogeneous(source) @ matrix.T
        off = np.maximum(off, np.linalg.norm(there[:, :2] / there[:, 2:] - target, axis=1))
    near = off < max(OFF_SIGMAS * np.sqrt(2) * max(found.sigma_px, noise_px), OFF_PX)
    return (near, found.sigma_px) if near.mean() >= ON_PLANE else None
