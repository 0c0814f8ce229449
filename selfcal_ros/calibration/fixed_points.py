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

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.circular import calibrate_circular
from selfcal_ros.calibration.pair_tests import classify_pairs, FLOOR_PX, PairVerdicts
from selfcal_ros.calibration.pencil import calibrate_from_fixed_points, PencilCalibration
from selfcal_ros.calibration.result import FixedPoints
from selfcal_ros.calibration.tracks import Tracks
from selfcal_ros.calibration.triplets import choose_triplets, dense_tracks
from selfcal_ros.geometry import planar_batch, planar_pairs
from selfcal_ros.geometry.estimate import NoEstimate
from selfcal_ros.geometry.fundamental import (eight_point, pair_residuals, PairMatches,
                                              refine_general)
from selfcal_ros.geometry.planar_pairs import PlanarPairs
from selfcal_ros.geometry.projective import (canonical_transform, completed_frame,
                                             transform_points, unit, unit_covariance,
                                             weighted_mean)
from selfcal_ros.geometry.ransac import ransac_fundamental
from selfcal_ros.geometry.trifocal import circular_image, circular_points

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
    triplet_frames : ndarray of int, shape (t, 3)
        Triplets that gave circular points.
    triplet_kappas : ndarray of complex, shape (t,)
    screw_axis : ndarray, shape (3,)
        Image m of the common screw axis where the motion is circular, else of the first pair.
    notes : tuple of str

    """

    fixed: FixedPoints
    motion: str
    pairs: PlanarPairs
    pair_frames: np.ndarray
    canonical: np.ndarray
    kappa: complex
    kappa_covariance: np.ndarray
    triplet_frames: np.ndarray
    triplet_kappas: np.ndarray
    screw_axis: np.ndarray
    notes: tuple = ()


def fixed_points(tracks: Tracks, triplets=None, method: str = 'batch', limit: int = 24,
                 least_common: int = 12, trim_sigma: float = 4.0, most_matches: int = 300,
                 rng=None):
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
        return NoEstimate(f'Three views are needed; there are {len(frames)}.', 'too_few')
    if triplets is None:
        chosen = choose_triplets(xy, limit, least_common)
    else:
        chosen = np.searchsorted(frames, np.asarray(triplets))
    if not len(chosen):
        return NoEstimate(f'No three views share {least_common} tracks.', 'too_few')
    wanted = np.unique(np.concatenate([chosen[:, [0, 1]], chosen[:, [1, 2]], chosen[:, [0, 2]]]),
                       axis=0)
    seen = np.isfinite(xy[..., 0])
    both = [np.flatnonzero(seen[a] & seen[b]) for a, b in wanted]
    both = [t[::-(-len(t) // most_matches)] if len(t) > most_matches else t for t in both]
    enough = [k for k, tracks_of in enumerate(both) if len(tracks_of) >= 8]
    if not enough:
        return NoEstimate('No two views share 8 tracks.', 'too_few')
    wanted, both = wanted[enough], [both[k] for k in enough]
    data = PairMatches.from_pixels([(xy[a, t], xy[b, t]) for (a, b), t in zip(wanted, both)])
    if rng is not None:
        data = _without_gross_errors(data, xy, wanted, both, rng)
    found = _horizon_and_point(data, wanted, both, xy.shape[1], method, trim_sigma)
    if isinstance(found, NoEstimate):
        return found
    kept, result, motion, screw_axis, unused = found
    l_px, v_px = result.horizon, result.vanishing_point
    H = canonical_transform(l_px, v_px)
    canonical_xy = transform_points(H, xy)
    good = {tuple(p): None for p in wanted[kept]}
    usable = [t for t in chosen if any(p in good for p in
                                       ((t[0], t[1]), (t[1], t[2]), (t[0], t[2])))]
    combined = _combine_triplets(canonical_xy, usable, unused, least_common, most_matches)
    if isinstance(combined, NoEstimate):
        return combined
    kappa, covariance, used, kappas = combined
    fixed = FixedPoints(l_px, v_px, circular_image(kappa, H))
    notes = () if len(kept) == len(wanted) else (
        f'{len(wanted) - len(kept)} of {len(wanted)} image pairs were degenerate and left out.',)
    return FixedPointEstimate(fixed, motion, result, frames[wanted[kept]], H, kappa, covariance,
                              frames[np.asarray(used)], kappas, screw_axis, notes)


def calibrate_estimate(estimate: FixedPointEstimate, facts):
    """
    Pick the camera that agrees with the facts, by the rule that fits the motion.

    Returns
    -------
    PencilCalibration or NoEstimate
        See `pencil.calibrate_from_fixed_points` and `circular.calibrate_circular`.

    """
    if estimate.motion == 'circular':
        return calibrate_circular(estimate.fixed.circular_point, estimate.screw_axis, facts)
    return calibrate_from_fixed_points(estimate.fixed, facts)


def _observation_identity(wanted, both, width, track_count):
    """Identity (n, width, 2) of every match's observation in its second and first view."""
    identity = np.full((len(wanted), width, 2), -1)
    for k, ((a, b), tracks_of) in enumerate(zip(wanted, both)):
        identity[k, :len(tracks_of), 0] = b * track_count + tracks_of
        identity[k, :len(tracks_of), 1] = a * track_count + tracks_of
    return identity


def _horizon_and_point(data, wanted, both, track_count, method, trim_sigma):
    """Pairs that are sound, l and v, the motion, and the observations that were left out."""
    F, cost, _, _ = refine_general(data, eight_point(data))
    data, F, cost = _trimmed(data, F, cost, trim_sigma)
    state, planar_cost, hessian = planar_pairs.refine_planar(data, F)
    verdicts = classify_pairs(data, F, cost, planar_cost)
    kept = np.flatnonzero(verdicts.sound)
    if not len(kept):
        return _why_none(verdicts)
    data = data.subset(kept)
    state = tuple(s[kept] for s in state)
    identity = _observation_identity(wanted[kept], [both[k] for k in kept],
                                     data.weight.shape[1], track_count)
    L, V, own, batch_cost, count = planar_batch.refine_batch(
        data, *planar_batch.batch_start(state))
    spread, share = planar_batch.batch_covariance(data, L, V, own, identity)
    result = planar_batch.result_in_pixels(data, L, V, own, batch_cost, spread, share, count)
    general = verdicts.noise_px[kept]
    if result.noise_px > 2 * max(np.sqrt(np.mean(general ** 2)), 1e-5):
        return NoEstimate(
            f'The motion is not planar: planar epipolar geometry leaves {result.noise_px:.3g} px, '
            f'general motion {np.sqrt(np.mean(general ** 2)):.3g} px.', 'not_planar')
    screw_axis = result.screw_axes[0]
    motion = 'planar'
    common, chi2 = _common_axis(data, state, planar_cost[kept], hessian[kept])
    if len(kept) > 1 and chi2 < COINCIDENT_CHI2:
        motion, screw_axis = 'circular', common
        point = unit(np.array([-common[1], common[0], 0.0]))
        result = PlanarPairs(result.horizon, point, result.horizon_covariance,
                             result.vanishing_point_covariance, result.F, result.screw_axes,
                             result.residuals, result.noise_px, count)
    elif len(kept) == 1:
        return NoEstimate('Only one image pair is sound; the vanishing point needs two screw '
                          'axes.', 'too_few')
    elif method == 'pairs':
        result = _pairs_method(data, result, state, planar_cost[kept], hessian[kept])
    unused = identity[(data.weight == 0) & (identity[..., 0] >= 0)]
    return kept, result, motion, screw_axis, unused


def _without_gross_errors(data, xy, wanted, both, rng):
    """Leave out what RANSAC calls outliers, pair by pair."""
    weight = data.weight.copy()
    for k, ((a, b), tracks_of) in enumerate(zip(wanted, both)):
        found = ransac_fundamental(xy[a, tracks_of], xy[b, tracks_of], rng)
        if not isinstance(found, NoEstimate):
            weight[k, :len(tracks_of)] = found.inliers
    return PairMatches(data.first, data.second, weight, data.transform)


def _trimmed(data, F, cost, trim_sigma):
    """Leave out matches far from their epipolar lines and refine F once more."""
    residuals = pair_residuals(data, F)
    distance = np.sqrt((residuals ** 2).sum(axis=-1) / 2)
    used = data.weight > 0
    sigma = 1.4826 * np.array([np.median(d[u]) for d, u in zip(distance, used)])
    far = used & (distance > trim_sigma * np.maximum(sigma, 1e-6)[:, None])
    # never below what the eight-point start needs
    far &= ((used & ~far).sum(axis=1) >= 10)[:, None]
    if not far.any():
        return data, F, cost
    data = PairMatches(data.first, data.second, np.where(far, 0.0, data.weight), data.transform)
    F, cost, _, _ = refine_general(data, eight_point(data))
    return data, F, cost


def _why_none(verdicts: PairVerdicts) -> NoEstimate:
    if verdicts.parallax.sum() * 2 < len(verdicts.parallax):
        return NoEstimate(
            'The views show no parallax: a homography explains the best pair to '
            f'{verdicts.parallax_px.max():.3g} px at a noise of '
            f'{np.median(verdicts.noise_px):.3g} px. Either the camera only turned, or it hardly '
            'moved, or all points lie in one plane.', 'no_parallax')
    return NoEstimate(
        'The views show no rotation: a pure translation explains the best pair to '
        f'{verdicts.translation_px.max():.3g} px at a noise of '
        f'{np.median(verdicts.noise_px):.3g} px.', 'no_rotation')


def _own_lines(state, data, cost, hessian):
    """Each pair's l and m in normalised coordinates with their covariances (n, 3, 3)."""
    _, Q, M = state
    variance = np.maximum(cost, data.counts * FLOOR_PX ** 2) / np.maximum(data.counts - 6, 1)
    spread = np.linalg.pinv(hessian, hermitian=True) * variance[:, None, None]
    line_slope = np.stack([-Q[:, :, 2], Q[:, :, 1]], axis=2)
    line_cov = line_slope @ spread[:, 2:4, 2:4] @ np.swapaxes(line_slope, 1, 2)
    axis_cov = M[:, :, 1:] @ spread[:, 4:, 4:] @ np.swapaxes(M[:, :, 1:], 1, 2)
    return Q[:, :, 0], line_cov, M[:, :, 0], axis_cov


def _common_axis(data, state, cost, hessian):
    """Mean screw axis in pixels, and how far the pairs' own ones deviate from it."""
    _, _, axes, axis_cov = _own_lines(state, data, cost, hessian)
    mean, _ = weighted_mean(axes, axis_cov)
    frame = completed_frame(mean)
    flat = axes @ frame
    offset = flat[:, 1:] / flat[:, :1]
    tangent = frame[:, 1:].T @ axis_cov @ frame[:, 1:]
    chi2 = np.einsum('ni,nij,nj->', offset, np.linalg.pinv(tangent, hermitian=True), offset)
    return unit(data.transform.T @ mean), chi2 / max(2 * len(axes) - 2, 1)


def _pairs_method(data, result, state, cost, hessian):
    """Means of the pairs' own l and m with their covariances (6.4, 6.5, C.5)."""
    lines, line_cov, axes, axis_cov = _own_lines(state, data, cost, hessian)
    T = data.transform
    line, cov_l = weighted_mean(lines, line_cov)
    v = np.linalg.svd(axes)[2][-1]
    for _ in range(5):
        weight = 1 / np.maximum(np.einsum('i,nij,j->n', v, axis_cov, v), 1e-300)
        v = np.linalg.svd(axes * np.sqrt(weight / weight.max())[:, None])[2][-1]
    cov_v = np.linalg.pinv((axes * weight[:, None]).T @ axes - np.outer(v, v) * (
        v @ ((axes * weight[:, None]).T @ axes) @ v), hermitian=True, rcond=1e-13)
    line, cov_l = unit_covariance(T.T @ line, T.T @ cov_l @ T)
    back = np.linalg.inv(T)
    point, cov_v = unit_covariance(back @ v, back @ cov_v @ back.T)
    return PlanarPairs(line, point, cov_l, cov_v, result.F, unit(axes @ T), result.residuals,
                       result.noise_px, 0)


def _combine_triplets(xy, triplets, unused, least_common, most_matches):
    """Robust covariance-weighted mean of the triplets' circular points."""
    seen = np.isfinite(xy).all(axis=-1)
    if len(unused):
        frame, track = np.divmod(np.unique(unused), xy.shape[1])
        seen[frame, track] = False
    used, kappas, covariances, reasons = [], [], [], []
    for triplet in triplets:
        common = seen[triplet].all(axis=0)
        if common.sum() < min(least_common, 5):
            reasons.append(NoEstimate('Too few tracks in three views.', 'too_few'))
            continue
        common = np.flatnonzero(common)
        common = common[::-(-len(common) // most_matches)]
        found = circular_points(*xy[triplet][:, common])
        if not isinstance(found, NoEstimate):
            used.append(triplet)
            kappas.append(found.kappa)
            covariances.append(found.covariance)
        else:
            reasons.append(found)
    if not used:
        first = reasons[0].reason if reasons else 'No triplet has sound pairs.'
        return NoEstimate(f'None of {len(triplets)} triplets gives circular points. {first}',
                          'no_triplet')
    kappas, covariances = np.array(kappas), np.array(covariances)
    values = np.column_stack([kappas.real, kappas.imag])
    floor = 1e-18 * np.abs(kappas).max() ** 2 * np.eye(2)
    mean, covariance = _robust_mean(values, covariances + floor)
    return complex(*mean), covariance, used, kappas


def _robust_mean(values, covariances, cutoff: float = 3.0):
    """Start from the weighted median, then iterate Huber weights on Mahalanobis distances."""
    information = np.linalg.inv(covariances)
    weight = 1 / np.sqrt(np.linalg.det(covariances))
    order = np.argsort(values, axis=0)
    mean = np.empty(2)
    for axis in range(2):
        share = np.cumsum(weight[order[:, axis]]) / weight.sum()
        mean[axis] = values[order[np.searchsorted(share, 0.5), axis], axis]
    total = information.sum(axis=0)
    for _ in range(8):
        offset = values - mean
        distance = np.sqrt(np.einsum('ni,nij,nj->n', offset, information, offset))
        # the linear covariance is too small by an unknown factor: judge by the spread itself
        unitless = distance / max(np.median(distance), 1.0)
        factor = np.minimum(1.0, cutoff / np.maximum(unitless, 1e-12))
        total = (information * factor[:, None, None]).sum(axis=0)
        mean = np.linalg.solve(total, np.einsum('n,nij,nj->i', factor, information, values))
    return mean, np.linalg.inv(total) * max(float(np.mean(np.minimum(distance, 9) ** 2)) / 2, 1)
