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
"""Which views see the same points, and by which epipolar geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.special import erf

from selfcal_ros.calibration.bundle.inliers import verified
from selfcal_ros.calibration.initialisation.initial_structure import PairGeometry
from selfcal_ros.calibration.initialisation.pair_lens import (choose_lens, homography_lens,
                                                              PairLens, Sample)
from selfcal_ros.geometry.division import DivisionModel
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.values.tracks import Tracks

#: Points of an image that lie on a line but for so much (root mean square) show no geometry.
LINE_WIDTH_PX = 1.0
#: Every view is compared with so many successors.
SUCCESSORS = 3
#: Pairs with fewer common tracks than this say too little, by themselves.
MINIMUM_MATCHES = 12
#: Between views that those leave unlinked: so many, if every one of them agrees. An eighth match
#: may agree by chance with what seven determine; the adjustment of all views finds that out.
FEWEST_MATCHES = 8
#: Points that a view has to keep: three leave four poses open.
LEAST_OF_VIEW = 4
#: Noise below this is rounding.
MIN_NOISE_PX = 1e-3
#: So many matches of a pair, evenly chosen, decide on its epipolar geometry.
RANSAC_MATCHES = 200
#: Largest distance of an inlier from the epipolar geometry, pixels. Where the noise is so large
#: that this cuts into it, `NOISE_SIGMAS` times the noise instead, but no more than the second.
EPIPOLAR_THRESHOLD_PX, WIDEST_THRESHOLD_PX = 1.5, 6.0
NOISE_SIGMAS = 4.0
#: A pair whose matches nearly all move less shows one image twice.
STILL_PX = 0.3


@dataclass(frozen=True)
class ViewGraph:
    """
    Views that are connected by pairs, and the observations that fit them.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
        Frame index of each view.
    tracks : Tracks
        Observations that fit the epipolar geometry.
    pairs : list of PairGeometry
        Their indices are views.
    noise_px : float
        Robust standard deviation of an image coordinate, from epipolar distances.
    rejected : int
        Observations that contradict the others: outliers of a pair of views, or in pairs of
        which none has a consistent epipolar geometry. Those that could not be compared do not
        count, nor do those of pairs with fewer than `MINIMUM_MATCHES` matches that disagree: a
        single one may be to blame.
    parallax : float
        What a homography leaves of the pair that it explains worst, in units of that pair's
        noise, through the lens; near 1 the scene is one plane or the camera only rotated.
    usual_parallax : float
        The same of the pair in the middle.
    division : float
        lambda of the division model that bends the epipolar lines, for radii in half diagonals
        of the image (`geometry/division.py`); 0 where straight lines suffice. Of one
        coefficient, also where `lens` has two.
    division_sigma : float
        Its standard deviation; infinite where it is not known, as where homographies told the
        lens: of one plane, or of a camera that only turned.
    lens : DivisionModel, optional
        The model that the pairs' F and `noise_px` go by; None for straight lines.
    given : Tracks, optional
        All observations of tracks with two or more, those of other geometry too.

    """

    frames: np.ndarray
    tracks: Tracks
    pairs: list[PairGeometry]
    noise_px: float
    rejected: int
    parallax: float
    usual_parallax: float = float('inf')
    division: float = 0.0
    division_sigma: float = float('inf')
    lens: DivisionModel | None = None
    given: Tracks | None = None

    @property
    def bend(self) -> tuple[float, ...]:
        """Coefficients of the lens that the pairs show; none where straight lines suffice."""
        if self.lens is not None:
            return self.lens.coefficients
        return (self.division,) if self.division else ()


def truncated_sigma(square: float, limit: float) -> float:
    """
    Estimate the standard deviation of Gaussian noise from what lies within a limit.

    Parameters
    ----------
    square : float
        Mean square of the values within +-limit.
    limit : float

    Returns
    -------
    float
        Infinite where the values look evenly spread over the whole interval.

    """
    # E[d^2 | |d| < T] / T^2 by the ratio t = T / sigma; it falls from 1/3 as t grows
    t = np.linspace(0.6, 12, 400)
    expected = (1 - t * np.exp(-t * t / 2) * np.sqrt(2 / np.pi) / erf(t / np.sqrt(2))) / t**2
    share = square / limit**2
    if share >= expected[0]:
        return float('inf')
    return float(np.sqrt(square)) if share <= expected[-1] else float(
        limit / np.interp(share, expected[::-1], t[::-1]))


def _threshold(lens: PairLens, F: np.ndarray, samples: Sequence[Sample], threshold_px: float,
               ) -> float:
    """Limit that cuts off gross errors but not the noise, which it would make look small."""
    square, freedom = 0.0, 0
    for one, (xy_a, xy_b) in zip(F, samples):
        distance = lens.distance(one, xy_a, xy_b)
        near = distance[np.abs(distance) < threshold_px]
        if len(near) > 7:
            square, freedom = square + float(near @ near), freedom + len(near) - 7
    if not freedom:
        return threshold_px
    sigma = truncated_sigma(square / freedom, threshold_px)
    return float(np.clip(NOISE_SIGMAS * sigma, threshold_px, WIDEST_THRESHOLD_PX))


def _with_threshold(lens: PairLens, samples: list[Sample], compared: list[Sample],
                    ) -> tuple[np.ndarray, float]:
    """Refine every pair on its inliers, with a limit that suits the noise of all pairs."""
    F, threshold_px = lens.refined(samples), EPIPOLAR_THRESHOLD_PX
    for _ in range(4):
        wider = _threshold(lens, F, compared, threshold_px)
        if wider < 1.05 * threshold_px:
            break
        threshold_px = wider
        near = [np.abs(lens.distance(one, *xy)) < threshold_px for one, xy in zip(F, compared)]
        samples = [(a[k], b[k]) if k.sum() >= _least(len(k)) else old
                   for k, (a, b), old in zip(near, compared, samples)]
        F = lens.refined(samples)
    return F, threshold_px


def _candidate_pairs(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Return the frames and the view pairs (n, 2) worth comparing."""
    frames, view = np.unique(tracks.frame, return_inverse=True)
    _, point = np.unique(tracks.track, return_inverse=True)
    seen = coo_matrix((np.ones(len(view)), (point, view))).tocsr()
    common = np.asarray((seen.T @ seen).todense())
    a, b = np.triu_indices(len(frames), 1)
    gap = b - a
    # neighbours in time, and the end of a loop that meets its beginning
    wanted = (gap <= SUCCESSORS) | (len(frames) - gap <= SUCCESSORS) | (len(frames) <= 6)
    pairs = np.column_stack([a, b])
    enough = wanted & (common[a, b] >= MINIMUM_MATCHES)
    label = _components(pairs[enough], len(frames))
    # photographs in no order: what neighbours leave apart, any pair may join
    across = (common[a, b] >= MINIMUM_MATCHES) & (label[a] != label[b])
    label = _components(pairs[enough | across], len(frames))
    enough |= across
    joining = (common[a, b] >= FEWEST_MATCHES) & (label[a] != label[b])
    return frames, pairs[enough | joining]


def _least(common: int) -> int:
    """Tell how many of the matches of a pair have to agree."""
    return min(max(common, FEWEST_MATCHES), MINIMUM_MATCHES)


def _components(pairs: ArrayLike, count: int) -> np.ndarray:
    """Return the number of the connected set (count,) that every view belongs to."""
    first, second = np.reshape(pairs, (-1, 2)).T
    links = coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    component: np.ndarray = connected_components(links, directed=False)[1]
    return component


class _Compared(NamedTuple):
    """A pair of views, the points that both see, and matches of some of them."""

    a: int
    b: int
    both: np.ndarray
    xy: Sample


def _without_still(compared: list[_Compared], views: int) -> list[_Compared]:
    """Leave out pairs of equal images, which have no epipolar geometry, if all stay linked."""
    moving = [pair for pair in compared if np.percentile(
        np.abs(pair.xy[0] - pair.xy[1]).max(axis=1), 95) > STILL_PX]
    before, after = (_components([(pair.a, pair.b) for pair in pairs], views)
                     for pairs in (compared, moving))
    return moving if np.array_equal(before, after) else compared


def _fitted(compared: list[_Compared], image_size: tuple[int, int] | None,
            rng: np.random.Generator,
            ) -> tuple[PairLens, np.ndarray, list[_Compared], float]:
    """Lens of all pairs, F (n, 3, 3) of those that have one, these pairs, and the limit."""
    # a stream of its own: whoever needs no lens draws as if there was none
    lens = choose_lens([pair.xy for pair in compared], image_size, rng.spawn(1)[0],
                       EPIPOLAR_THRESHOLD_PX)
    samples, matches = _agreeing(lens, compared, rng)
    if lens.model is not None:
        lens = lens.improved(samples, lens.refined(samples))
    F, threshold_px = _with_threshold(lens, samples, [pair.xy for pair in matches])
    return lens, F, matches, threshold_px


def _agreeing(lens: PairLens, compared: list[_Compared], rng: np.random.Generator,
              ) -> tuple[list[Sample], list[_Compared]]:
    """Inliers of the pairs that have any, and these pairs."""
    samples, matches = [], []
    found = lens.inliers([pair.xy for pair in compared], rng, EPIPOLAR_THRESHOLD_PX)
    for pair, inlier in zip(compared, found):
        if inlier is not None:
            samples.append((pair.xy[0][inlier], pair.xy[1][inlier]))
            matches.append(pair)
    return samples, matches


def build_view_graph(tracks: Tracks, rng: np.random.Generator, straight: bool = False,
                     ) -> ViewGraph | NoEstimate:
    """
    Estimate the epipolar geometry of pairs of views and keep the observations that fit.

    Parameters
    ----------
    tracks : Tracks
    rng : numpy.random.Generator
    straight : bool
        The lens is known to have no distortion: no bend is looked for.

    Returns
    -------
    ViewGraph or NoEstimate

    """
    tracks = tracks.with_at_least(2)
    if len(np.unique(tracks.frame)) < 2:
        return NoEstimate('too_few_images_share_points')
    width_px = float(np.median(tracks.narrowest_px()))
    if width_px < LINE_WIDTH_PX:
        return NoEstimate('points_on_a_line', width_px=width_px)
    frames, candidates = _candidate_pairs(tracks)
    row = np.full((len(frames), len(np.unique(tracks.track))), -1, dtype=np.int64)
    _, point = np.unique(tracks.track, return_inverse=True)
    view = np.searchsorted(frames, tracks.frame)
    row[view, point] = np.arange(len(tracks))
    compared, tested = [], np.zeros(len(tracks), bool)
    for a, b in candidates:
        both = np.flatnonzero((row[a] >= 0) & (row[b] >= 0))
        tested[row[[a, b]][:, both]] |= len(both) >= MINIMUM_MATCHES
        few = np.linspace(0, len(both) - 1, min(len(both), RANSAC_MATCHES)).astype(int)
        compared.append(_Compared(int(a), int(b), both, (tracks.xy[row[a, both[few]]],
                                                         tracks.xy[row[b, both[few]]])))
    size = None if straight else tracks.image_size
    lens, all_F, matches, threshold_px = _fitted(_without_still(compared, len(frames)), size, rng)
    votes, used = np.zeros(len(tracks)), np.zeros(len(tracks))
    pairs, spreads = [], []
    for (a, b, both, _), F in zip(matches, all_F):
        rows_a, rows_b = row[a, both], row[b, both]
        xy_a, xy_b = tracks.xy[rows_a], tracks.xy[rows_b]
        distance = lens.distance(F, xy_a, xy_b)
        inlier = np.abs(distance) < threshold_px
        count = int(inlier.sum())
        if count < _least(len(both)):
            continue
        for rows in (rows_a, rows_b):
            used[rows] += 1
            votes[rows] += inlier
        spreads.append((robust_sigma(distance[inlier])
                        * np.sqrt(count / max(count - 7, 1)), count))
        pairs.append(PairGeometry(a, b, F, both[inlier], xy_a[inlier], xy_b[inlier]))
    none = NoEstimate('no_epipolar_geometry', least=FEWEST_MATCHES,
                      least_doubtful=MINIMUM_MATCHES)
    if not pairs:
        return none
    keep = votes >= 0.5 * np.maximum(used, 1)
    # the largest connected set of views, of those that keep enough
    voted, shown = keep, np.ones(len(frames), bool)
    while True:
        pairs = [p for p in pairs if shown[p.first] and shown[p.second]]
        if not pairs:
            return none
        label = _components([(p.first, p.second) for p in pairs], len(frames))
        largest = label == np.argmax(np.bincount(label))
        keep = voted & largest[view]
        kept = tracks.select(keep & verified(point, keep)).with_at_least(2)
        shown = np.bincount(np.searchsorted(frames, kept.frame),
                            minlength=len(frames)) >= LEAST_OF_VIEW
        if shown[largest].all():
            break
    index = np.cumsum(largest) - 1
    pairs = [replace(p, first=int(index[p.first]), second=int(index[p.second]))
             for p in pairs if largest[p.first] and largest[p.second]]
    rejected = int(np.sum((tested | (used > 0)) & ~voted))
    noise, weight = np.array(spreads).T
    order = np.argsort(noise)
    share = np.cumsum(weight[order]) / weight.sum()
    median = float(noise[order][np.searchsorted(share, 0.5)])
    inliers = [(p.xy_first, p.xy_second) for p in pairs]
    turning, left_px = homography_lens(lens, inliers, max(median, MIN_NOISE_PX), size)
    return ViewGraph(frames[largest], kept, pairs, median, rejected,
                     float(left_px.max()) / max(median, MIN_NOISE_PX),
                     float(np.median(left_px)) / max(median, MIN_NOISE_PX), turning.division,
                     turning.sigma, lens.model, tracks)
