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
Fixed image points of planar motion from tracks: v, l and the circular points (thesis 5, 6.2).

Pairs of views give l and v, triplets the circular points on l. Degenerate data - no rotation,
no parallax, motion that is not planar - are told apart here and come back as a reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.planar.circular import calibrate_circular
from selfcal_ros.calibration.planar.conic_pencil import (calibrate_from_fixed_points,
                                                         PencilCalibration)
from selfcal_ros.calibration.planar.pair_means import (agreed_pairs, best_batch, common_point,
                                                       line_covariances, mean_line,
                                                       mean_screw_axis)
from selfcal_ros.calibration.planar.triplet_means import circular_point_influence, combine_triplets
from selfcal_ros.calibration.planar.triplets import choose_triplets, dense_tracks
from selfcal_ros.calibration.result import FixedPoints
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry import planar_batch, planar_pairs
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.fundamental import (eight_point, pair_residuals, PairMatches,
                                              refine_general)
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.planar_pairs import PlanarPairs
from selfcal_ros.geometry.projective import canonical_transform, unit, unit_slope
from selfcal_ros.geometry.propagation import add_up, spread
from selfcal_ros.geometry.ransac import ransac_fundamental
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.geometry.two_view_tests import classify_pairs, PairVerdicts
from selfcal_ros.values.tracks import Tracks

__all__ = ['calibrate_estimate', 'calibrate_from_fixed_points', 'fixed_points',
           'FixedPointEstimate', 'PencilCalibration']

#: The screw axes count as one, so that v is undetermined, below this mean squared deviation in
#: sigmas per degree of freedom.
COINCIDENT_CHI2 = 4.0


@dataclass(frozen=True)
class FixedPointEstimate:
    """
    Fixed points of planar motion in pixels, and how they were found.

    Attributes
    ----------
    fixed : FixedPoints
        Unit vectors l, v, i. For circular motion v is any point of the screw axis' image.
    motion : {'planar', 'circular'}
    pairs : PlanarPairs
        With the covariances of l and v.
    pair_frames : ndarray of int, shape (n, 2)
        Frame indices of every pair.
    canonical : ndarray, shape (3, 3)
        Canonical transform of l and v.
    kappa : complex
        Circular point in the canonical frame.
    kappa_covariance : ndarray, shape (2, 2)
        Of its real and imaginary part, l and v held.
    covariance : ndarray, shape (15, 15)
        Of l, v, the real and the imaginary part of i, and m, all together: unit vectors in
        pixels; first order, from the image points. i moves neither along itself nor along its
        phase; m is zero where the motion is not circular.
    triplet_frames : ndarray of int, shape (t, 3)
        Triplets that gave circular points.
    triplet_kappas : ndarray of complex, shape (t,)
    screw_axis : ndarray, shape (3,)
        Image m of the common screw axis where the motion is circular, else of the first pair.
    findings : tuple of Finding

    """

    fixed: FixedPoints
    motion: str
    pairs: PlanarPairs
    pair_frames: np.ndarray
    canonical: np.ndarray
    kappa: complex
    kappa_covariance: np.ndarray
    covariance: np.ndarray
    triplet_frames: np.ndarray
    triplet_kappas: np.ndarray
    screw_axis: np.ndarray
    findings: tuple[Finding, ...] = ()


def fixed_points(tracks: Tracks, triplets: ArrayLike | None = None, method: str = 'batch',
                 limit: int = 24, least_common: int = 12, trim_sigma: float = 4.0,
                 most_matches: int = 300, rng: np.random.Generator | None = None,
                 ) -> FixedPointEstimate | NoEstimate:
    """
    Estimate the fixed points of planar motion from tracks in undistorted pixels.

    Parameters
    ----------
    tracks : Tracks
    triplets : array_like of int, shape (t, 3), optional
        Frame indices; chosen by parallax and number of common tracks when not given.
    method : {'batch', 'pairs'}
        How l and v are found: over all pairs at once (6.6), or as means of the pairs' own
        lines (6.4, C.5).
    limit : int
        Largest number of triplets that is chosen.
    least_common : int
        Tracks that all views of a triplet must share.
    trim_sigma : float
        Matches with a larger epipolar distance, in robust sigmas, are left out of a second
        round.
    most_matches : int
        Of a pair; more are thinned out evenly, so that the time does not grow with them.
    rng : numpy.random.Generator, optional
        With it, gross errors are first removed from every pair by RANSAC.

    Returns
    -------
    FixedPointEstimate or NoEstimate

    """
    frames, identity, xy = dense_tracks(tracks)
    if len(frames) < 3:
        return NoEstimate('too_few', what='calibration from planar motion', needed=3,
                          items='views', found=len(frames))
    if triplets is None:
        chosen = choose_triplets(xy, limit, least_common)
    else:
        chosen = np.searchsorted(frames, np.asarray(triplets))
    if not len(chosen):
        return NoEstimate('too_few_shared', views=3, needed=least_common, items='tracks')
    wanted = np.unique(np.concatenate([chosen[:, [0, 1]], chosen[:, [1, 2]], chosen[:, [0, 2]]]),
                       axis=0)
    seen = np.isfinite(xy[..., 0])
    both = [np.flatnonzero(seen[a] & seen[b]) for a, b in wanted]
    both = [t[::-(-len(t) // most_matches)] if len(t) > most_matches else t for t in both]
    enough = [k for k, tracks_of in enumerate(both) if len(tracks_of) >= 8]
    if not enough:
        return NoEstimate('too_few_shared', views=2, needed=8, items='tracks')
    wanted, both = wanted[enough], [both[k] for k in enough]
    data = PairMatches.from_pixels([(xy[a, t], xy[b, t]) for (a, b), t in zip(wanted, both)])
    if rng is not None:
        data = _without_gross_errors(data, xy, wanted, both, rng)
    identity = np.full(xy.shape[:2], -1)
    identity[seen] = np.arange(seen.sum())
    found = _horizon_and_point(data, wanted, both, identity, method, trim_sigma)
    if isinstance(found, NoEstimate):
        return found
    l_px, v_px = found.result.horizon, found.result.vanishing_point
    H = canonical_transform(l_px, v_px)
    good = {tuple(p) for p in wanted[found.kept]}
    usable = [t for t in chosen if any(p in good for p in
                                       ((t[0], t[1]), (t[1], t[2]), (t[0], t[2])))]
    xy = np.where(np.isin(identity, found.unused)[..., None], np.nan, xy)
    combined = combine_triplets(xy, H, l_px, v_px, usable, identity, least_common, most_matches)
    if isinstance(combined, NoEstimate):
        return combined
    frame_moved = found.influence[..., :6]
    kappa_moved = combined.direct + frame_moved @ combined.by_frame.T
    i, i_moved = circular_point_influence(combined.kappa, H, l_px, v_px, kappa_moved, frame_moved)
    variance = found.variance
    together = np.concatenate([frame_moved, i_moved, found.influence[..., 6:]], axis=2)
    findings = () if len(found.kept) == len(wanted) else (
        Finding('pairs_degenerate', left_out=len(wanted) - len(found.kept), pairs=len(wanted)),)
    return FixedPointEstimate(
        FixedPoints(l_px, v_px, i), found.motion, found.result, frames[wanted[found.kept]], H,
        combined.kappa, variance * spread(combined.direct), variance * spread(together),
        frames[combined.triplets], combined.kappas, found.screw_axis, findings)


def calibrate_estimate(estimate: FixedPointEstimate, facts: CameraFacts,
                       ) -> PencilCalibration | NoEstimate:
    """
    Pick the camera that agrees with the facts, by the rule that fits the motion.

    Returns
    -------
    PencilCalibration or NoEstimate
        See `conic_pencil.calibrate_from_fixed_points` and `circular.calibrate_circular`.

    """
    if estimate.motion == 'circular':
        return calibrate_circular(estimate.fixed.circular_point, estimate.screw_axis, facts,
                                  estimate.covariance[6:, 6:])
    return calibrate_from_fixed_points(estimate.fixed, facts,
                                       covariance=estimate.covariance[3:12, 3:12])


@dataclass(frozen=True)
class _Pairs:
    """What the pairs give: l, v and m with the change (O, 2, 9) per pixel of each observation."""

    kept: np.ndarray
    result: PlanarPairs
    motion: str
    screw_axis: np.ndarray
    unused: np.ndarray
    influence: np.ndarray
    variance: float


def _horizon_and_point(data: PairMatches, wanted: np.ndarray, both: list[np.ndarray],
                       identity: np.ndarray, method: str, trim_sigma: float,
                       ) -> _Pairs | NoEstimate:
    """Find the sound pairs, l and v, the motion, and the observations that were left out."""
    F, cost, _, _ = refine_general(data, eight_point(data))
    F, cost, state, planar_cost = agreed_pairs(data, F, cost)
    fewer, F, cost = _trimmed(data, F, cost, trim_sigma)
    if fewer is not data:
        data = fewer
        F, cost, state, planar_cost = agreed_pairs(data, F, cost)
    verdicts = classify_pairs(data, F, cost, planar_cost)
    kept = np.flatnonzero(verdicts.sound)
    if not len(kept):
        return _why_none(verdicts)
    data = data.subset(kept)
    state, planar_cost = tuple(s[kept] for s in state), planar_cost[kept]
    observed = np.full((*data.weight.shape, 2), -1)
    for row, k in enumerate(kept):
        # the second view first, as in `propagation`
        observed[row, :len(both[k])] = identity[wanted[k][::-1]][:, both[k]].T
    L, V, own, batch_cost, count = best_batch(data, state, planar_cost)
    total = int(identity.max()) + 1
    moved, expected = planar_batch.batch_influence(data, L, V, own, observed, total)
    result = planar_batch.result_in_pixels(data, L, V, own, batch_cost, spread(moved), expected,
                                           count)
    general = verdicts.noise_px[kept]
    if result.noise_px > 2 * max(np.sqrt(np.mean(general ** 2)), 1e-5):
        return NoEstimate('pairs_not_planar', left_px=float(result.noise_px),
                          noise_px=float(np.sqrt(np.mean(general ** 2))))
    _, l_slope, _, v_slope = planar_batch.common_frames(data, L, V)
    influence = np.zeros((total, 2, 9))
    influence[..., :3] = moved[..., :2] @ l_slope.T
    influence[..., 3:6] = moved[..., 2:] @ v_slope.T
    motion, screw_axis = 'planar', result.screw_axes[0]
    lines = planar_pairs.pair_lines(data, state, planar_cost)
    axis, axis_moved, chi2 = mean_screw_axis(lines)

    def in_pixels(carry: np.ndarray, vector: np.ndarray, by_match: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray]:
        """Carry a vector of normalised coordinates and its influences over."""
        x, slope = unit_slope(carry, vector)
        by_match = np.stack([by_match[..., :2], by_match[..., 2:]], axis=2)
        rows = np.moveaxis(by_match, -1, -2) @ slope.T       # (n, m, view, coordinate, 3)
        used = np.where(data.weight[..., None] > 0, observed, -1)
        return x, add_up(used.ravel(), rows.reshape(-1, 2, 3), total)

    if len(kept) > 1 and chi2 < COINCIDENT_CHI2:
        motion = 'circular'
        screw_axis, influence[..., 6:] = in_pixels(data.transform.T, axis, axis_moved)
        # any point of m does for v: the one at infinity
        across = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
        point, slope = unit_slope(across, screw_axis)
        influence[..., 3:6] = influence[..., 6:] @ slope.T
        result = replace(result, vanishing_point=point)
    elif len(kept) == 1:
        return NoEstimate('one_pair_only')
    elif method == 'pairs':
        line_cov, axis_cov = line_covariances(lines)
        line, influence[..., :3] = in_pixels(data.transform.T, *mean_line(
            lines.horizons, line_cov, lines.horizon_influence))
        point, influence[..., 3:6] = in_pixels(np.linalg.inv(data.transform), *common_point(
            lines.axes, axis_cov, lines.axis_influence))
        result = replace(result, horizon=line, vanishing_point=point, iterations=0,
                         screw_axes=unit(lines.axes @ data.transform))
    unused = observed[(data.weight == 0) & (observed[..., 0] >= 0)]
    variance = student_variance(data, observed, result.noise_px)
    return _Pairs(kept, replace(result, horizon_covariance=variance * spread(influence[..., :3]),
                                vanishing_point_covariance=variance * spread(
                                    influence[..., 3:6])),
                  motion, screw_axis, unused, influence, variance)


def student_variance(data: PairMatches, observed: np.ndarray, noise_px: float) -> float:
    """
    Variance of an image coordinate for covariances, when it is itself an estimate.

    That of Student's distribution, nu / (nu - 2) times the estimate: with it the mean squared
    distance of the truth is one per parameter.

    Parameters
    ----------
    data : PairMatches
    observed : ndarray of int, shape (n, m, 2)
        Identity of the observations; -1 for padding.
    noise_px : float

    Returns
    -------
    float

    """
    used = data.weight > 0
    seen = len(np.unique(observed[used]))
    # a point in V views leaves 2 V - 3 constraints, however many pairs of views there are
    spare = min(int(used.sum()), 2 * seen - 3 * int(data.counts.max(initial=0)))
    freedom = max(spare - 4 - 3 * len(data.counts), 3)
    return noise_px ** 2 * freedom / (freedom - 2)


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
    # never below what the eight-point start needs
    far &= ((used & ~far).sum(axis=1) >= 10)[:, None]
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
