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
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.planar.circular import calibrate_circular
from selfcal_ros.calibration.planar.conic_pencil import (calibrate_from_fixed_points,
                                                         PencilCalibration)
from selfcal_ros.calibration.planar.pair_means import (best_batch, common_point,
                                                       line_covariances, mean_line,
                                                       mean_screw_axis)
from selfcal_ros.calibration.planar.sound_pairs import matched_pairs, MatchedPairs, sound_pairs
from selfcal_ros.calibration.planar.triplet_means import circular_point_influence, combine_triplets
from selfcal_ros.calibration.planar.triplets import choose_triplets, dense_tracks
from selfcal_ros.calibration.result import FixedPoints
from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry import planar_batch, planar_pairs
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.fundamental import PairMatches
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.planar_pairs import PairLines, PlanarPairs
from selfcal_ros.geometry.projective import canonical_transform, unit, unit_slope
from selfcal_ros.geometry.propagation import add_up, spread
from selfcal_ros.values.tracks import Tracks

__all__ = ['calibrate_estimate', 'calibrate_from_fixed_points', 'fixed_points',
           'FixedPointEstimate', 'PencilCalibration']

#: Ways to find the horizon l and the vanishing point v.
Method: TypeAlias = Literal['batch', 'pairs']
#: The motions that fixed points tell of.
PlanarMotion: TypeAlias = Literal['planar', 'circular']
#: The screw axes count as one, so that v is undetermined, below this mean squared deviation in
#: sigmas per degree of freedom.
COINCIDENT_CHI2 = 4.0
#: The motion is not planar where one l and v leave more than so many times the pairs' own noise;
#: noise below the second, in pixels, is rounding.
_NOT_PLANAR_RATIO, _ROUNDING_PX = 2.0, 1e-5


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
    canonical : ndarray, shape (3, 3)
        Canonical transform of l and v.
    kappa : complex
        Circular point in the canonical frame.
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
    motion: PlanarMotion
    pairs: PlanarPairs
    canonical: np.ndarray
    kappa: complex
    covariance: np.ndarray
    triplet_frames: np.ndarray
    triplet_kappas: np.ndarray
    screw_axis: np.ndarray
    findings: tuple[Finding, ...] = ()


def fixed_points(tracks: Tracks, triplets: ArrayLike | None = None, method: Method = 'batch',
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

    Raises
    ------
    ArgumentError
        If a triplet names a frame that has no tracks.

    """
    frames, _, xy = dense_tracks(tracks)
    if len(frames) < 3:
        return NoEstimate('too_few', what='calibration from planar motion', needed=3,
                          items='views', found=len(frames))
    if triplets is None:
        chosen = choose_triplets(xy, limit, least_common)
    else:
        wanted = np.asarray(triplets)
        chosen = np.minimum(np.searchsorted(frames, wanted), len(frames) - 1)
        if not (frames[chosen] == wanted).all():
            raise ArgumentError('A triplet names a frame without tracks; choose among '
                                f'{frames[0]} to {frames[-1]}.')
    if not len(chosen):
        return NoEstimate('too_few_shared', views=3, needed=least_common, items='tracks')
    matched = matched_pairs(xy, chosen, most_matches, rng)
    if isinstance(matched, NoEstimate):
        return matched
    found = _horizon_and_point(matched, method, trim_sigma)
    if isinstance(found, NoEstimate):
        return found
    l_px, v_px = found.result.horizon, found.result.vanishing_point
    H = canonical_transform(l_px, v_px)
    good = {tuple(p) for p in matched.views[found.kept]}
    usable = [t for t in chosen if any(p in good for p in
                                       ((t[0], t[1]), (t[1], t[2]), (t[0], t[2])))]
    xy = np.where(np.isin(matched.identity, found.unused)[..., None], np.nan, xy)
    combined = combine_triplets(xy, H, l_px, v_px, usable, matched.identity, least_common,
                                most_matches)
    if isinstance(combined, NoEstimate):
        return combined
    frame_moved = found.influence[..., :6]
    kappa_moved = combined.direct + frame_moved @ combined.by_frame.T
    i, i_moved = circular_point_influence(combined.kappa, H, l_px, v_px, kappa_moved, frame_moved)
    variance = found.variance
    together = np.concatenate([frame_moved, i_moved, found.influence[..., 6:]], axis=2)
    pairs = len(matched.views)
    findings = () if len(found.kept) == pairs else (
        Finding('pairs_degenerate', left_out=pairs - len(found.kept), pairs=pairs),)
    return FixedPointEstimate(
        FixedPoints(l_px, v_px, i), found.motion, found.result,
        H, combined.kappa, variance * spread(together),
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
class _FixedLines:
    """
    What the pairs give together.

    Attributes
    ----------
    kept : ndarray of int, shape (k,)
        Sound pairs, among all.
    result : PlanarPairs
        With l and v.
    motion : {'planar', 'circular'}
    screw_axis : ndarray, shape (3,)
        m: the common one if the motion is circular, else that of the first pair.
    unused : ndarray of int
        Observations that were left out as outliers.
    influence : ndarray, shape (O, 2, 9)
        Change of l, v and m with every image coordinate, per pixel.
    variance : float
        Of an image coordinate, pixels².

    """

    kept: np.ndarray
    result: PlanarPairs
    motion: PlanarMotion
    screw_axis: np.ndarray
    unused: np.ndarray
    influence: np.ndarray
    variance: float


@dataclass(frozen=True)
class _ToPixels:
    """
    Carries vectors of normalised coordinates to pixels, with their change by the observations.

    Attributes
    ----------
    weight : ndarray, shape (k, m)
        Of the matches; zero for padding and outliers.
    observed : ndarray of int, shape (k, m, 2)
        Observations of every match; -1 for padding.
    count : int
        O, the number of observations.

    """

    weight: np.ndarray
    observed: np.ndarray
    count: int

    def __call__(self, transform: np.ndarray, vector: np.ndarray, by_match: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray]:
        """Return transform @ vector of unit norm, and its influence (O, 2, 3) per pixel."""
        x, slope = unit_slope(transform, vector)
        by_match = np.stack([by_match[..., :2], by_match[..., 2:]], axis=2)
        rows = np.moveaxis(by_match, -1, -2) @ slope.T       # (n, m, view, coordinate, 3)
        used = np.where(self.weight[..., None] > 0, self.observed, -1)
        return x, add_up(used.ravel(), rows.reshape(-1, 2, 3), self.count)


def _horizon_and_point(matched: MatchedPairs, method: Method, trim_sigma: float,
                       ) -> _FixedLines | NoEstimate:
    """Find the sound pairs, l and v, and whether the motion is circular."""
    sound = sound_pairs(matched.data, trim_sigma)
    if isinstance(sound, NoEstimate):
        return sound
    data, state = sound.data, sound.state
    observed = matched.observations(sound.kept, data.weight.shape[1])
    total = int(matched.identity.max()) + 1
    L, V, own, batch_cost, count = best_batch(data, state, sound.planar_cost)
    moved, expected = planar_batch.batch_influence(data, L, V, own, observed, total)
    result = planar_batch.result_in_pixels(data, L, V, own, batch_cost, spread(moved), expected,
                                           count)
    if result.noise_px > _NOT_PLANAR_RATIO * max(sound.noise_px, _ROUNDING_PX):
        return NoEstimate('pairs_not_planar', left_px=float(result.noise_px),
                          noise_px=sound.noise_px)
    _, l_slope, _, v_slope = planar_batch.common_frames(data, L, V)
    influence = np.zeros((total, 2, 9))
    influence[..., :3] = moved[..., :2] @ l_slope.T
    influence[..., 3:6] = moved[..., 2:] @ v_slope.T
    motion: PlanarMotion = 'planar'
    screw_axis = result.screw_axes[0]
    lines = planar_pairs.pair_lines(data, state, sound.planar_cost)
    axis, axis_moved, chi2 = mean_screw_axis(lines)
    to_pixels = _ToPixels(data.weight, observed, total)
    if len(sound.kept) > 1 and chi2 < COINCIDENT_CHI2:
        motion = 'circular'
        screw_axis, influence[..., 6:] = to_pixels(data.transform.T, axis, axis_moved)
        # any point of m does for v: the one at infinity
        across = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
        point, slope = unit_slope(across, screw_axis)
        influence[..., 3:6] = influence[..., 6:] @ slope.T
        result = replace(result, vanishing_point=point)
    elif len(sound.kept) == 1:
        return NoEstimate('one_pair_only')
    elif method == 'pairs':
        result = _means_of_lines(result, data, lines, to_pixels, influence)
    variance = student_variance(data, observed, result.noise_px)
    result = replace(result, horizon_covariance=variance * spread(influence[..., :3]),
                     vanishing_point_covariance=variance * spread(influence[..., 3:6]))
    unused = observed[(data.weight == 0) & (observed[..., 0] >= 0)]
    return _FixedLines(sound.kept, result, motion, screw_axis, unused, influence, variance)


def _means_of_lines(result: PlanarPairs, data: PairMatches, lines: PairLines,
                    to_pixels: _ToPixels, influence: np.ndarray) -> PlanarPairs:
    """Take l and v as means of the pairs' own lines (6.4, C.5); changes influence[..., :6]."""
    line_cov, axis_cov = line_covariances(lines)
    line, influence[..., :3] = to_pixels(data.transform.T, *mean_line(
        lines.horizons, line_cov, lines.horizon_influence))
    point, influence[..., 3:6] = to_pixels(np.linalg.inv(data.transform), *common_point(
        lines.axes, axis_cov, lines.axis_influence))
    return replace(result, horizon=line, vanishing_point=point, iterations=0,
                   screw_axes=unit(lines.axes @ data.transform))


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
