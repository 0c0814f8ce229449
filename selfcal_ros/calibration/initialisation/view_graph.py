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

import numpy as np
from scipy.special import erf

from selfcal_ros.calibration.bundle.inliers import verified
from selfcal_ros.calibration.initialisation.candidate_pairs import (
    candidate_pairs, compared_pairs, ComparedPair, components, FEWEST_MATCHES, is_more_than_chance,
    least_agreeing, MINIMUM_MATCHES, ObservationTable, without_still)
from selfcal_ros.calibration.initialisation.initial_structure import PairGeometry
from selfcal_ros.calibration.initialisation.pair_lens import (choose_lens, homography_lens,
                                                              PairLens, Sample)
from selfcal_ros.geometry.division import DivisionModel
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.values.tracks import Tracks

#: Points of an image that lie on a line but for so much (root mean square) show no geometry.
LINE_WIDTH_PX = 1.0
#: Points that a view has to keep: three leave four poses open.
LEAST_OF_VIEW = 4
#: Noise below this is rounding.
MIN_NOISE_PX = 1e-3
#: Largest distance of an inlier from the epipolar geometry, pixels. Where the noise is so large
#: that this cuts into it, `NOISE_SIGMAS` times the noise instead, but no more than the second.
EPIPOLAR_THRESHOLD_PX, WIDEST_THRESHOLD_PX = 1.5, 6.0
NOISE_SIGMAS = 4.0


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
        samples = [(a[k], b[k]) if k.sum() >= least_agreeing(len(k)) else old
                   for k, (a, b), old in zip(near, compared, samples)]
        F = lens.refined(samples)
    return F, threshold_px


def _fitted(compared: list[ComparedPair], image_size: tuple[int, int] | None,
            rng: np.random.Generator,
            ) -> tuple[PairLens, np.ndarray, list[ComparedPair], float]:
    """Lens of all pairs, F (n, 3, 3) of those that have one, these pairs, and the limit."""
    # a stream of its own: whoever needs no lens draws as if there was none
    lens = choose_lens([pair.xy for pair in compared], image_size, rng.spawn(1)[0],
                       EPIPOLAR_THRESHOLD_PX)
    samples, matches = _agreeing(lens, compared, rng)
    if lens.model is not None:
        lens = lens.improved(samples, lens.refined(samples))
    F, threshold_px = _with_threshold(lens, samples, [pair.xy for pair in matches])
    return lens, F, matches, threshold_px


def _agreeing(lens: PairLens, compared: list[ComparedPair], rng: np.random.Generator,
              ) -> tuple[list[Sample], list[ComparedPair]]:
    """Inliers of the pairs that have any, and these pairs."""
    samples, matches = [], []
    found = lens.inliers([pair.xy for pair in compared], rng, EPIPOLAR_THRESHOLD_PX)
    for pair, inlier in zip(compared, found):
        if inlier is not None:
            samples.append((pair.xy[0][inlier], pair.xy[1][inlier]))
            matches.append(pair)
    return samples, matches


@dataclass(frozen=True)
class _CheckedPairs:
    """
    Pairs of views held against all their matches.

    Attributes
    ----------
    pairs : list of PairGeometry
        Those of which enough matches agree.
    noise_px : ndarray, shape (n,)
        Robust standard deviation of the epipolar distances of each.
    inlier_count : ndarray of int, shape (n,)
    used, votes : ndarray, shape (N,)
        Of every observation: the pairs that it takes part in, and those with which it agrees.

    """

    pairs: list[PairGeometry]
    noise_px: np.ndarray
    inlier_count: np.ndarray
    used: np.ndarray
    votes: np.ndarray

    @property
    def agree(self) -> np.ndarray:
        """Mark the observations that agree with half of their pairs at least, shape (N,)."""
        agree: np.ndarray = self.votes >= 0.5 * np.maximum(self.used, 1)
        return agree

    def usual_noise_px(self) -> float:
        """Return the median of the pairs' noise, each counted by its inliers."""
        order = np.argsort(self.noise_px)
        share = np.cumsum(self.inlier_count[order]) / self.inlier_count.sum()
        return float(self.noise_px[order][np.searchsorted(share, 0.5)])


def _checked_pairs(tracks: Tracks, rows: ObservationTable, lens: PairLens,
                   matches: list[ComparedPair], all_F: np.ndarray, threshold_px: float,
                   ) -> _CheckedPairs:
    """Hold pairs against all their matches, not only those that decided on their F (n, 3, 3)."""
    votes, used = np.zeros(len(tracks)), np.zeros(len(tracks))
    pairs, noise_px, counts = [], [], []
    seen = [(rows.row[a, both], rows.row[b, both]) for a, b, both, _ in matches]
    samples = [(tracks.xy[rows_a], tracks.xy[rows_b]) for rows_a, rows_b in seen]
    distances = [lens.distance(F, *xy) for F, xy in zip(all_F, samples)]
    inliers = [np.abs(distance) < threshold_px for distance in distances]
    by_chance = _linked_by_chance(matches, inliers)
    for k, (F, distance, inlier) in enumerate(zip(all_F, distances, inliers)):
        (a, b, both, _), (xy_a, xy_b) = matches[k], samples[k]
        count = int(inlier.sum())
        if count < least_agreeing(len(both)) or k in by_chance:
            continue
        for row in seen[k]:
            used[row] += 1
            votes[row] += inlier
        # F has seven degrees of freedom
        noise_px.append(robust_sigma(distance[inlier]) * np.sqrt(count / max(count - 7, 1)))
        counts.append(count)
        pairs.append(PairGeometry(a, b, F, both[inlier], xy_a[inlier], xy_b[inlier]))
    return _CheckedPairs(pairs, np.array(noise_px), np.array(counts), used, votes)


def _linked_by_chance(matches: list[ComparedPair], inliers: list[np.ndarray]) -> set[int]:
    """
    Find the pairs that link a view which has no other, and whose matches agree by chance.

    Such a view would rest on a few matches that only seem to agree.
    """
    firm = [k for k, inlier in enumerate(inliers) if inlier.sum() >= MINIMUM_MATCHES]
    linked = {view for k in firm for view in matches[k][:2]}
    right = float(np.mean(np.concatenate([inliers[k] for k in firm] or [np.ones(1)])))
    return {k for k, pair in enumerate(matches) if not {pair.a, pair.b} <= linked
            and not is_more_than_chance(len(pair.both), right)}


def _largest_connected(tracks: Tracks, rows: ObservationTable, pairs: list[PairGeometry],
                       agree: np.ndarray) -> tuple[np.ndarray, Tracks] | None:
    """
    Find the largest set of views that pairs connect and that each keep enough observations.

    Parameters
    ----------
    tracks : Tracks
    rows : ObservationTable
    pairs : list of PairGeometry
    agree : ndarray of bool, shape (N,)
        Observations that agree with their pairs.

    Returns
    -------
    ndarray of bool, shape (V,)
        Views of the set. None where no pair is left.
    Tracks
        What these views keep.

    """
    count = len(rows.frames)
    shown = np.ones(count, bool)
    while True:
        pairs = [p for p in pairs if shown[p.first] and shown[p.second]]
        if not pairs:
            return None
        label = components([(p.first, p.second) for p in pairs], count)
        largest = label == np.argmax(np.bincount(label))
        keep = agree & largest[rows.view]
        kept = tracks.select(keep & verified(rows.point, keep)).with_at_least(2)
        shown = np.bincount(np.searchsorted(rows.frames, kept.frame),
                            minlength=count) >= LEAST_OF_VIEW
        if shown[largest].all():
            return largest, kept


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
    rows = ObservationTable.of(tracks)
    frames = rows.frames
    compared, tested = compared_pairs(tracks, rows, candidate_pairs(rows))
    size = None if straight else tracks.image_size
    lens, F, matches, threshold_px = _fitted(without_still(compared, len(frames)), size, rng)
    checked = _checked_pairs(tracks, rows, lens, matches, F, threshold_px)
    connected = _largest_connected(tracks, rows, checked.pairs, checked.agree)
    if connected is None:
        return NoEstimate('no_epipolar_geometry', least=FEWEST_MATCHES,
                          least_doubtful=MINIMUM_MATCHES)
    largest, kept = connected
    index = np.cumsum(largest) - 1
    pairs = [replace(p, first=int(index[p.first]), second=int(index[p.second]))
             for p in checked.pairs if largest[p.first] and largest[p.second]]
    rejected = int(np.sum((tested | (checked.used > 0)) & ~checked.agree))
    noise_px = checked.usual_noise_px()
    floor_px = max(noise_px, MIN_NOISE_PX)
    turning, left_px = homography_lens(lens, [(p.xy_first, p.xy_second) for p in pairs], floor_px,
                                       size)
    return ViewGraph(frames[largest], kept, pairs, noise_px, rejected,
                     parallax=float(left_px.max()) / floor_px,
                     usual_parallax=float(np.median(left_px)) / floor_px,
                     division=turning.division, lens=lens.model,
                     given=tracks)
