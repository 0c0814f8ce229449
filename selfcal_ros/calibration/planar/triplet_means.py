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
Circular points of many triplets, combined, with the noise of every observation traced to them.

The noise of the image is neither equal nor isotropic in the canonical frame, and the frame itself
moves with l and v (thesis 6.3.1). Both are first-order effects with a closed form: the derivative
of the canonical coordinates by the pixels, and by l and v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import canonical_slopes, homogeneous
from selfcal_ros.geometry.propagation import add_up
from selfcal_ros.geometry.trifocal import circular_points


@dataclass(frozen=True)
class CombinedTriplets:
    """
    Weighted mean of the circular points of triplets.

    Attributes
    ----------
    kappa : complex
    triplets : ndarray of int, shape (t, 3)
        Those that gave circular points.
    kappas : ndarray of complex, shape (t,)
    direct : ndarray, shape (O, 2, 2)
        Change of (real, imaginary) part with every image coordinate, l and v held.
    by_frame : ndarray, shape (2, 6)
        Change with the unit vectors l and v.

    """

    kappa: complex
    triplets: np.ndarray
    kappas: np.ndarray
    direct: np.ndarray
    by_frame: np.ndarray


def combine_triplets(xy: np.ndarray, H: np.ndarray, line: np.ndarray, point: np.ndarray,
                     triplets: Sequence[np.ndarray], identity: np.ndarray, least_common: int,
                     most_matches: int) -> CombinedTriplets | NoEstimate:
    """
    Circular points of every triplet, and their robust covariance-weighted mean.

    Parameters
    ----------
    xy : ndarray, shape (V, P, 2)
        Pixels; NaN where a point is not seen or shall not be used.
    H : ndarray, shape (3, 3)
        Canonical transform of l and v.
    line, point : ndarray, shape (3,)
        l and v.
    triplets : sequence of (3,) int
    identity : ndarray of int, shape (V, P)
        Index of every observation; the largest is O - 1.
    least_common, most_matches : int
        See `fixed_points.fixed_points`.

    Returns
    -------
    CombinedTriplets or NoEstimate

    """
    seen = np.isfinite(xy).all(axis=-1)
    slopes = canonical_slopes(line, point)
    used, found, places, by_pixel, by_frame, reasons = [], [], [], [], [], []
    for triplet in triplets:
        common = np.flatnonzero(seen[triplet].all(axis=0))
        if len(common) < min(least_common, 5):
            reasons.append(NoEstimate(
                'too_few', what='triplet of views', needed=min(least_common, 5), items='tracks',
                found=len(common)))
            continue
        common = common[::-(-len(common) // most_matches)]
        pixels = homogeneous(xy[triplet][:, common])
        flat = pixels @ H.T
        canonical = flat[..., :2] / flat[..., 2:]
        # d (x / z) = (dx - (x / z) dz) / z, for the pixel and for the frame
        spreads = (H[:2, :2] - canonical[..., None] * H[2, :2]) / flat[..., 2:, None]
        one = circular_points(canonical[0], canonical[1], canonical[2], spreads)
        if isinstance(one, NoEstimate):
            reasons.append(one)
            continue
        moved = np.einsum('ijk,vmj->vmik', slopes, pixels, optimize=True)
        moved = ((moved[..., :2, :] - canonical[..., None] * moved[..., 2:, :])
                 / flat[..., 2:, None])
        used.append(triplet)
        found.append(one)
        places.append(identity[triplet][:, common].ravel())
        by_pixel.append(np.einsum('vmck,vmcd->vmdk', one.influence, spreads).reshape(-1, 2, 2))
        by_frame.append(np.einsum('vmck,vmcf->kf', one.influence, moved, optimize=True))
    if not used:
        first = reasons[0] if reasons else NoEstimate('no_sound_pairs')
        return NoEstimate('no_triplet', triplets=len(triplets), why=first)
    kappas = np.array([one.kappa for one in found])
    floor = 1e-18 * np.abs(kappas).max() ** 2 * np.eye(2)
    mean, weights = robust_mean(np.column_stack([kappas.real, kappas.imag]),
                                np.array([one.covariance for one in found]) + floor)
    rows = [moved @ weight.T for moved, weight in zip(by_pixel, weights)]
    direct = add_up(np.concatenate(places), np.concatenate(rows), int(identity.max()) + 1)
    return CombinedTriplets(complex(*mean), np.array(used), kappas, direct,
                            np.einsum('tij,tjk->ik', weights, np.array(by_frame)))


def robust_mean(values: np.ndarray, covariances: np.ndarray, cutoff: float = 3.0,
                ) -> tuple[np.ndarray, np.ndarray]:
    """
    Start from the weighted median, then iterate Huber weights on Mahalanobis distances.

    Parameters
    ----------
    values : ndarray, shape (t, 2)
    covariances : ndarray, shape (t, 2, 2)
    cutoff : float
        In units of the median distance, or of sigma where that is larger.

    Returns
    -------
    mean : ndarray, shape (2,)
    weights : ndarray, shape (t, 2, 2)
        The mean is the sum of weights times values.

    """
    information = np.linalg.inv(covariances)
    weight = 1 / np.sqrt(np.linalg.det(covariances))
    order = np.argsort(values, axis=0)
    mean = np.empty(2)
    for axis in range(2):
        share = np.cumsum(weight[order[:, axis]]) / weight.sum()
        mean[axis] = values[order[np.searchsorted(share, 0.5), axis], axis]
    for _ in range(8):
        offset = values - mean
        distance = np.sqrt(np.einsum('ni,nij,nj->n', offset, information, offset))
        # the triplets share views, and their tensors their errors: judge by the spread itself
        unitless = distance / max(np.median(distance), 1.0)
        factor = np.minimum(1.0, cutoff / np.maximum(unitless, 1e-12))[:, None, None]
        weights = np.linalg.solve((information * factor).sum(axis=0), information * factor)
        mean = np.einsum('nij,nj->i', weights, values)
    return mean, weights


def circular_point_influence(kappa: complex, H: np.ndarray, line: np.ndarray, point: np.ndarray,
                             kappa_moved: np.ndarray, frame_moved: np.ndarray,
                             ) -> tuple[np.ndarray, np.ndarray]:
    """
    Image of the circular point, and its change.

    Parameters
    ----------
    kappa : complex
    H : ndarray, shape (3, 3)
    line, point : ndarray, shape (3,)
    kappa_moved : ndarray, shape (O, 2, 2)
        Change of (real, imaginary) part.
    frame_moved : ndarray, shape (O, 2, 6)
        Change of l and v.

    Returns
    -------
    i : ndarray of complex, shape (3,)
        Unit norm.
    influence : ndarray, shape (O, 2, 6)
        Of its real, then of its imaginary part; neither along i nor along its phase.

    """
    back = np.linalg.inv(H)
    i = back @ np.array([-kappa, 0, 1])
    norm = np.linalg.norm(i)
    by_frame = -np.einsum('ij,jkf,k->if', back, canonical_slopes(line, point), i)
    moved = (-(kappa_moved[..., 0] + 1j * kappa_moved[..., 1])[..., None] * back[:, 0]
             + frame_moved @ by_frame.T) / norm
    i = i / norm
    moved = moved - (moved @ i.conj())[..., None] * i
    return i, np.concatenate([moved.real, moved.imag], axis=-1)
