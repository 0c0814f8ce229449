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
"""The pairs of views that planar motion explains, with their matches and without outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.planar.pair_means import agreed_pairs
from selfcal_ros.geometry.fundamental import (eight_point, pair_residuals, PairMatches,
                                              refine_general)
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.ransac import ransac_fundamental
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.geometry.two_view_tests import classify_pairs, PairVerdicts

#: Matches that the eight-point algorithm needs.
_MIN_MATCHES = 8
#: Matches that a pair keeps at least when outliers are left out: some more than that.
_MIN_KEPT = 10


@dataclass(frozen=True)
class MatchedPairs:
    """
    Pairs of views with their matches.

    Attributes
    ----------
    views : ndarray of int, shape (n, 2)
    points : list of ndarray of int
        Points that both views of a pair see; at most `most_matches`, evenly chosen.
    data : PairMatches
    identity : ndarray of int, shape (V, P)
        Number of every observation; -1 where a view does not see a point.

    """

    views: np.ndarray
    points: list[np.ndarray]
    data: PairMatches
    identity: np.ndarray

    def observations(self, kept: np.ndarray, width: int) -> np.ndarray:
        """Return the observations of some pairs, shape (k, width, 2); -1 for padding."""
        observed = np.full((len(kept), width, 2), -1)
        for row, k in enumerate(kept):
            # the second view first, as in `propagation`
            observed[row, :len(self.points[k])] = self.identity[
                self.views[k][::-1]][:, self.points[k]].T
        return observed


def matched_pairs(xy: np.ndarray, triplets: np.ndarray, most_matches: int,
                  rng: np.random.Generator | None) -> MatchedPairs | NoEstimate:
    """
    Match the pairs of views that triplets consist of.

    Parameters
    ----------
    xy : ndarray, shape (V, P, 2)
        Undistorted pixels; NaN where a view does not see a point.
    triplets : ndarray of int, shape (t, 3)
        Views.
    most_matches : int
        Of a pair.
    rng : numpy.random.Generator, optional
        With it, RANSAC leaves gross errors out.

    Returns
    -------
    MatchedPairs or NoEstimate

    """
    views = np.unique(np.concatenate([triplets[:, [0, 1]], triplets[:, [1, 2]],
                                      triplets[:, [0, 2]]]), axis=0)
    seen = np.isfinite(xy[..., 0])
    points = [np.flatnonzero(seen[a] & seen[b]) for a, b in views]
    points = [one[::-(-len(one) // most_matches)] if len(one) > most_matches else one
              for one in points]
    enough = [k for k, one in enumerate(points) if len(one) >= _MIN_MATCHES]
    if not enough:
        return NoEstimate('too_few_shared', views=2, needed=_MIN_MATCHES, items='tracks')
    views, points = views[enough], [points[k] for k in enough]
    data = PairMatches.from_pixels([(xy[a, one], xy[b, one]) for (a, b), one in
                                    zip(views, points)])
    if rng is not None:
        data = _without_gross_errors(data, xy, views, points, rng)
    identity = np.full(xy.shape[:2], -1)
    identity[seen] = np.arange(seen.sum())
    return MatchedPairs(views, points, data, identity)


@dataclass(frozen=True)
class SoundPairs:
    """
    Pairs that planar motion with rotation and parallax explains, each by itself.

    Attributes
    ----------
    kept : ndarray of int, shape (k,)
        Which of all pairs.
    data : PairMatches
        Without outliers.
    state : tuple of ndarray
        Planar form; see `planar_pairs.refine_planar`.
    planar_cost : ndarray, shape (k,)
    noise_px : float
        Root mean square of what their general fundamental matrices leave.

    """

    kept: np.ndarray
    data: PairMatches
    state: tuple[np.ndarray, ...]
    planar_cost: np.ndarray
    noise_px: float


def sound_pairs(data: PairMatches, trim_sigma: float) -> SoundPairs | NoEstimate:
    """
    Refine every pair, leave outliers out, and keep the pairs that are not degenerate.

    Parameters
    ----------
    data : PairMatches
        Normalised coordinates of all pairs.
    trim_sigma : float
        Matches with a larger epipolar distance, in robust sigmas, are outliers.

    Returns
    -------
    SoundPairs or NoEstimate

    """
    F, cost, _, _ = refine_general(data, eight_point(data))
    F, cost, state, planar_cost = agreed_pairs(data, F, cost)
    fewer, F, cost = _trimmed(data, F, cost, trim_sigma)
    if fewer is not data:
        data = fewer
        F, cost, state, planar_cost = agreed_pairs(data, F, cost)
    verdicts = classify_pairs(data, cost)
    kept = np.flatnonzero(verdicts.sound)
    if not len(kept):
        return _why_none(verdicts)
    noise_px = float(np.sqrt(np.mean(verdicts.noise_px[kept] ** 2)))
    return SoundPairs(kept, data.subset(kept), tuple(s[kept] for s in state), planar_cost[kept],
                      noise_px)


def _without_gross_errors(data: PairMatches, xy: np.ndarray, wanted: np.ndarray,
                          both: list[np.ndarray], rng: np.random.Generator) -> PairMatches:
    """Leave out what RANSAC calls outliers, pair by pair."""
    weight = data.weight.copy()
    for k, ((a, b), tracks_of) in enumerate(zip(wanted, both)):
        found = ransac_fundamental(xy[a, tracks_of], xy[b, tracks_of], rng)
        if not isinstance(found, NoEstimate):
            weight[k, :len(tracks_of)] = found.inliers
    return PairMatches(data.first, data.second, weight, data.transform)


def _trimmed(data: PairMatches, F: np.ndarray, cost: np.ndarray, trim_sigma: float,
             ) -> tuple[PairMatches, np.ndarray, np.ndarray]:
    """Leave out matches far from their epipolar lines and refine F once more."""
    residuals = pair_residuals(data, F)
    distance = np.sqrt((residuals ** 2).sum(axis=-1) / 2)
    used = data.weight > 0
    sigma = np.array([robust_sigma(d[u]) for d, u in zip(distance, used)])
    far = used & (distance > trim_sigma * np.maximum(sigma, 1e-6)[:, None])
    far &= ((used & ~far).sum(axis=1) >= _MIN_KEPT)[:, None]
    if not far.any():
        return data, F, cost
    data = PairMatches(data.first, data.second, np.where(far, 0.0, data.weight), data.transform)
    F, cost, _, _ = refine_general(data, F)
    return data, F, cost


def _why_none(verdicts: PairVerdicts) -> NoEstimate:
    if verdicts.parallax.sum() * 2 < len(verdicts.parallax):
        return NoEstimate('pairs_without_parallax', left_px=float(verdicts.parallax_px.max()),
                          noise_px=float(np.median(verdicts.noise_px)))
    return NoEstimate('pairs_without_rotation', left_px=float(verdicts.translation_px.max()),
                      noise_px=float(np.median(verdicts.noise_px)))
