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
"""Fundamental matrix of matches with gross errors: RANSAC over seven-point hypotheses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.epipolar_distance import epipolar_residuals
from selfcal_ros.geometry.fundamental import eight_point, PairMatches, refine_general
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import homogeneous, normalising_transform

#: Hypotheses that are scored at a time.
_CHUNK = 40


@dataclass(frozen=True)
class RansacEstimate:
    """
    Attributes of a robust fit.

    Attributes
    ----------
    F : ndarray, shape (3, 3)
        In pixels, unit norm, refined on the inliers.
    inliers : ndarray of bool, shape (m,)
    hypotheses : int
        How many samples were drawn.

    """

    F: np.ndarray
    inliers: np.ndarray
    hypotheses: int


def seven_point(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """
    Rank-2 matrices through seven matches, many samples at once.

    Parameters
    ----------
    first, second : ndarray, shape (h, 7, 3)
        Homogeneous, normalised.

    Returns
    -------
    ndarray, shape (h, 3, 3, 3)
        Up to three solutions of each sample; NaN where a root is not real.

    """
    rows = (second[..., :, None] * first[..., None, :]).reshape(len(first), 7, 9)
    # what is across all rows: a third of the time of singular values
    across = np.linalg.qr(np.swapaxes(rows, 1, 2), mode='complete')[0][:, :, 7:]
    A, B = np.moveaxis(across, 2, 0).reshape(2, -1, 3, 3)
    # det(A + x B) from its values at four places
    x = np.array([0.0, 1.0, -1.0, 2.0])
    values = np.linalg.det(A[:, None] + x[:, None, None] * B[:, None])
    cubic = values @ np.linalg.inv(np.vander(x, 4)).T
    lead = np.where(np.abs(cubic[:, :1]) > 1e-14, cubic[:, :1], 1e-14)
    companion = np.zeros((len(cubic), 3, 3))
    companion[:, 0] = -cubic[:, 1:] / lead
    companion[:, 1, 0] = companion[:, 2, 1] = 1
    roots = np.linalg.eigvals(companion)
    real = np.where(np.abs(roots.imag) < 1e-8 * (1 + np.abs(roots)), roots.real, np.nan)
    F = A[:, None] + real[..., None, None] * B[:, None]
    unit_F: np.ndarray = F / np.linalg.norm(F, axis=(-2, -1), keepdims=True)
    return unit_F


def ransac_fundamental(xy_a: ArrayLike, xy_b: ArrayLike, rng: np.random.Generator,
                       threshold_px: float = 1.5, confidence: float = 0.999,
                       most_hypotheses: int = 2000) -> RansacEstimate | NoEstimate:
    """
    Fundamental matrix of one pair in the presence of gross errors.

    Parameters
    ----------
    xy_a, xy_b : array_like, shape (m, 2)
        Matches in pixels.
    rng : numpy.random.Generator
    threshold_px : float
        Largest distance of an inlier to its epipolar line, in both images.
    confidence : float
        Probability with which a sample without gross errors shall have been drawn.
    most_hypotheses : int

    Returns
    -------
    RansacEstimate or NoEstimate

    """
    xy_a, xy_b = np.asarray(xy_a, float), np.asarray(xy_b, float)
    found = ransac_inliers(xy_a, xy_b, rng, threshold_px, confidence, most_hypotheses)
    if isinstance(found, NoEstimate):
        return found
    best, drawn = found
    T = normalising_transform(np.vstack([xy_a, xy_b]))
    first, second = (homogeneous(xy * T[0, 0] + T[:2, 2]) for xy in (xy_a, xy_b))
    limit = threshold_px * T[0, 0]
    for _ in range(2):
        data = PairMatches.from_pixels([(xy_a[best], xy_b[best])], T)
        F, _, _, _ = refine_general(data, eight_point(data))
        distance = np.abs(epipolar_residuals(F[0], first[:, :2], second[:, :2])).max(axis=-1)
        again = distance < limit
        if again.sum() < 8:
            break
        best = again
    return RansacEstimate(data.pixels_F(F)[0], best, drawn)


def ransac_inliers(xy_a: ArrayLike, xy_b: ArrayLike, rng: np.random.Generator,
                   threshold_px: float = 1.5, confidence: float = 0.999,
                   most_hypotheses: int = 2000) -> tuple[np.ndarray, int] | NoEstimate:
    """
    Matches of one pair that agree with one fundamental matrix, without refining it.

    Parameters
    ----------
    xy_a, xy_b : array_like, shape (m, 2)
        Matches in pixels.
    rng, threshold_px, confidence, most_hypotheses
        As in `ransac_fundamental`.

    Returns
    -------
    (ndarray of bool, shape (m,), int) or NoEstimate
        The inliers of the best sample, and the number of samples drawn.

    """
    xy_a, xy_b = np.asarray(xy_a, float), np.asarray(xy_b, float)
    count = len(xy_a)
    if count < 8:
        return NoEstimate('too_few', what='robust fundamental matrix', needed=8, items='matches',
                          found=count)
    T = normalising_transform(np.vstack([xy_a, xy_b]))
    first, second = (homogeneous(xy * T[0, 0] + T[:2, 2]) for xy in (xy_a, xy_b))
    limit = threshold_px * T[0, 0]
    best_score, best, drawn, needed = -np.inf, None, 0, most_hypotheses
    while drawn < min(needed, most_hypotheses):
        sample = rng.random((_CHUNK, count)).argpartition(7, axis=1)[:, :7]
        drawn += _CHUNK
        F = seven_point(first[sample], second[sample]).reshape(-1, 3, 3)
        F = F[np.isfinite(F).all(axis=(1, 2))]
        if not len(F):
            continue
        # a truncated square prefers the tighter of two equal counts
        left = 1 - _larger_square(F, first, second) / limit ** 2
        score = np.maximum(left, 0).sum(axis=1)
        top = int(np.argmax(score))
        if score[top] > best_score:
            best_score, best = score[top], left[top] > 0
            share = min(max(best.mean(), 1e-3), 1 - 1e-9)
            needed = np.log(1 - confidence) / np.log1p(-share ** 7)
    if best is None or best.sum() < 8:
        return NoEstimate('no_agreeing_sample', threshold_px=threshold_px)
    return best, drawn


def _larger_square(F: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Square of the larger epipolar distance of F (h, 3, 3), matches (m, 3), shape (h, m)."""
    u, v, w = np.moveaxis((F.reshape(-1, 3) @ first.T).reshape(len(F), 3, -1), 1, 0)
    p, q = np.moveaxis((np.swapaxes(F, 1, 2)[:, :2].reshape(-1, 3) @ second.T).reshape(
        len(F), 2, -1), 1, 0)
    x, y, _ = second.T
    product = u * x + v * y + w
    square: np.ndarray = product * product / np.maximum(np.minimum(u * u + v * v, p * p + q * q),
                                                        1e-300)
    return square
