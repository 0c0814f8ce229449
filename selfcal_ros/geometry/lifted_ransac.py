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
"""F of lifted matches with gross errors: seven-point samples in batches, for any lens."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from selfcal_ros.geometry.division import (bend, lifted, refine_division, residuals,
                                           weighted_eight_point)

#: Samples drawn at once, and matches that judge them.
_BATCH, _JURY = 100, 120
#: A sample shall have been free of gross errors with this probability.
_CONFIDENCE = 0.999
#: Samples at most.
_MOST_SAMPLES = 2000


def _null_pairs(rows: np.ndarray) -> np.ndarray:
    """Two matrices that span what seven equations (h, 7, 9) leave, shape (h, 2, 3, 3)."""
    # by elimination: a tenth of the time of singular values, and good enough for a sample
    left = rows[:, :, :7] + 1e-12 * np.eye(7)
    try:
        basis = -np.linalg.solve(left, rows[:, :, 7:])
    except np.linalg.LinAlgError:
        return np.linalg.svd(rows, full_matrices=True)[2][:, 7:].reshape(-1, 2, 3, 3)
    both = np.zeros((len(rows), 9, 2))
    both[:, :7] = basis
    both[:, 7, 0] = both[:, 8, 1] = 1
    both /= np.linalg.norm(both, axis=1, keepdims=True)
    return np.swapaxes(both, 1, 2).reshape(-1, 2, 3, 3)


def _determinant(matrix: np.ndarray) -> np.ndarray:
    """Determinants of (..., 3, 3), faster than by factors."""
    product: np.ndarray = (matrix[..., 0, :]
                           * np.cross(matrix[..., 1, :], matrix[..., 2, :])).sum(axis=-1)
    return product


def _real_roots(cubic: np.ndarray) -> np.ndarray:
    """Roots (h, 3) of cubics (h, 4), highest power first; NaN where a root is not real."""
    lead = np.where(np.abs(cubic[:, 0]) > 1e-14, cubic[:, 0], 1e-14)
    b, c, d = (cubic[:, 1:] / lead[:, None]).T
    p, q = c - b * b / 3, 2 * b ** 3 / 27 - b * c / 3 + d
    three = 4 * p ** 3 + 27 * q * q < 0
    with np.errstate(invalid='ignore', divide='ignore'):
        size = 2 * np.sqrt(-p / 3)
        angle = np.arccos(np.clip(3 * q / (p * size), -1, 1)) / 3
        turns = np.arange(3) * (2 * np.pi / 3)
        several = size[:, None] * np.cos(angle[:, None] - turns)
        root = np.sqrt(np.maximum(q * q / 4 + p ** 3 / 27, 0))
        single = np.cbrt(-q / 2 + root) + np.cbrt(-q / 2 - root)
    roots = np.where(three[:, None], several, np.nan)
    roots[:, 0] = np.where(three, roots[:, 0], single)
    shifted: np.ndarray = roots - b[:, None] / 3
    return shifted


def _hypotheses(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Matrices of rank 2, (k, 3, 3), through samples of seven lifted matches (h, 7, 3)."""
    rows = (b[..., :, None] * a[..., None, :]).reshape(len(a), 7, 9)
    A, B = np.moveaxis(_null_pairs(rows), 1, 0)
    x = np.array([0.0, 1.0, -1.0, 2.0])
    values = _determinant(A[:, None] + x[:, None, None] * B[:, None])
    roots = _real_roots(values @ np.linalg.inv(np.vander(x, 4)).T)
    F = (A[:, None] + roots[..., None, None] * B[:, None]).reshape(-1, 3, 3)
    F = F[np.isfinite(F).all(axis=(1, 2))]
    unit_F: np.ndarray = F / np.linalg.norm(F, axis=(1, 2), keepdims=True)
    return unit_F


def lifted_ransac(xy_a: np.ndarray, xy_b: np.ndarray, coefficients: np.ndarray,
                  threshold: float, rng: np.random.Generator, most_samples: int = _MOST_SAMPLES,
                  polished: bool = True) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Fit F for lifted points, x_b' F x_a = 0, to the matches of one pair.

    Parameters
    ----------
    xy_a, xy_b : ndarray, shape (m, 2)
        Places about the image centre in units of the radii of the coefficients.
    coefficients : ndarray, shape (p,)
        Of the division model.
    threshold : float
        Largest distance of an inlier from its epipolar curve, same units.
    rng : numpy.random.Generator
    most_samples : int
    polished : bool
        Refine by least squares over the inliers.

    Returns
    -------
    (F (3, 3), inliers (m,) of bool) or None
        None where fewer than eight matches agree.

    """
    best = best_sample(xy_a, xy_b, coefficients, threshold, rng, most_samples)
    if best is None:
        return None
    F, near, stands = _improved(best[None], xy_a[None], xy_b[None],
                                np.ones((1, len(xy_a)), bool), coefficients, threshold)
    if not stands[0]:
        return None
    if polished:
        F = refine_division(xy_a[None], xy_b[None], near.astype(float), F, coefficients,
                            held=True, iterations=5).F
        near = np.abs(residuals(xy_a[None], xy_b[None], F, coefficients)[0]) < threshold
    return (F[0], near[0]) if near.sum() >= 8 else None


def best_sample(xy_a: np.ndarray, xy_b: np.ndarray, coefficients: np.ndarray, threshold: float,
                rng: np.random.Generator, most_samples: int = _MOST_SAMPLES) -> np.ndarray | None:
    """
    Return F (3, 3) through the seven matches that most others agree with.

    The parameters are those of `lifted_ransac`; None where there are fewer than eight matches.
    """
    count = len(xy_a)
    if count < 8:
        return None
    jury = np.linspace(0, count - 1, min(count, _JURY)).astype(int)
    a, b = lifted(xy_a, coefficients), lifted(xy_b, coefficients)
    equations = _equations(xy_a[jury], xy_b[jury], coefficients)
    best_score, best, drawn, needed = 0.0, None, 0, float(most_samples)
    while drawn < min(needed, most_samples):
        sample = rng.random((_BATCH, count)).argpartition(7, axis=1)[:, :7]
        drawn += _BATCH
        F = _hypotheses(a[sample], b[sample])
        if not len(F):
            continue
        score, share = _scores(F, equations, threshold)
        top = int(np.argmax(score))
        if score[top] > best_score:
            best_score, best = score[top], F[top]
            clean = min(max(share[top], 1e-3), 1 - 1e-9)
            needed = np.log(1 - _CONFIDENCE) / np.log1p(-clean ** 7)
    return best


def lifted_inliers(pairs: Sequence[tuple[np.ndarray, np.ndarray]], coefficients: np.ndarray,
                   threshold: float, rng: np.random.Generator) -> list[np.ndarray | None]:
    """
    Tell which matches of every pair agree with one F for lifted points.

    Parameters
    ----------
    pairs : sequence of (xy_a (m, 2), xy_b (m, 2))
    coefficients, threshold, rng
        As in `lifted_ransac`.

    Returns
    -------
    list of (ndarray of bool, shape (m,)) or None
        None where fewer than eight matches agree.

    """
    found = [best_sample(a, b, coefficients, threshold, rng) for a, b in pairs]
    there = [k for k, F in enumerate(found) if F is not None]
    inliers: list[np.ndarray | None] = [None] * len(pairs)
    if not there:
        return inliers
    xy_a, xy_b, present = _stacked([pairs[k] for k in there])
    # all pairs at a time: most of the work is not arithmetic
    _, near, stands = _improved(np.array([found[k] for k in there]), xy_a, xy_b, present,
                                coefficients, threshold)
    for n, k in enumerate(there):
        if stands[n]:
            inliers[k] = near[n, :len(pairs[k][0])]
    return inliers


def lifted_fits(pairs: Sequence[tuple[np.ndarray, np.ndarray]], coefficients: np.ndarray,
                threshold: float, found: list[np.ndarray | None],
                ) -> list[np.ndarray | None]:
    """
    Bring F of several pairs to the least squares of their inliers, all at a time.

    Parameters
    ----------
    pairs : sequence of (xy_a (m, 2), xy_b (m, 2))
    coefficients, threshold
        As in `lifted_ransac`.
    found : list of (ndarray, shape (3, 3)) or None
        Roughly F of every pair.

    Returns
    -------
    list of (ndarray, shape (3, 3)) or None
        None where fewer than eight matches agree.

    """
    there = [k for k, F in enumerate(found) if F is not None and len(pairs[k][0]) >= 8]
    fits: list[np.ndarray | None] = [None] * len(pairs)
    if not there:
        return fits
    xy_a, xy_b, present = _stacked([pairs[k] for k in there])
    F, near, stands = _improved(np.array([found[k] for k in there]), xy_a, xy_b, present,
                                coefficients, threshold)
    F = refine_division(xy_a, xy_b, np.where(stands[:, None], near, present).astype(float), F,
                        coefficients, held=True, iterations=5).F
    near = present & (np.abs(residuals(xy_a, xy_b, F, coefficients)[0]) < threshold)
    for n, k in enumerate(there):
        if stands[n] and near[n].sum() >= 8:
            fits[k] = F[n]
    return fits


def _stacked(pairs: Sequence[tuple[np.ndarray, np.ndarray]],
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (n, m, 2) of either side, and which of them there are (n, m)."""
    counts = np.array([len(a) for a, _ in pairs])
    most = int(counts.max())
    # what is not there is said once more, and does not count
    xy = np.array([[np.resize(side, (most, 2)) for side in pair] for pair in pairs])
    return xy[:, 0], xy[:, 1], np.arange(most) < counts[:, None]


def _equations(xy_a: np.ndarray, xy_b: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Rows (9, 5 m) that turn the entries of F into a product and the slopes it is divided by."""
    a, b = lifted(xy_a, coefficients), lifted(xy_b, coefficients)
    # derivatives (m, 3) of a lifted point by the place
    slopes = []
    for points, bent in ((a, bend(xy_a, coefficients)), (b, bend(xy_b, coefficients))):
        for k in (0, 1):
            slope = np.zeros_like(points)
            slope[:, k], slope[:, 2] = 1, bent[:, k]
            slopes.append(slope)
    sides = [(b, a), *((b, slope) for slope in slopes[:2]), *((slope, a) for slope in slopes[2:])]
    rows = [(left[:, :, None] * right[:, None, :]).reshape(-1, 9) for left, right in sides]
    equations: np.ndarray = np.concatenate(rows).T.astype(np.float32)
    return equations


def _scores(F: np.ndarray, equations: np.ndarray, threshold: float,
            ) -> tuple[np.ndarray, np.ndarray]:
    """Truncated squares, turned such that more is better, and shares of inliers, (k,)."""
    # half the digits do for a first judgement
    values = F.reshape(-1, 9).astype(np.float32) @ equations
    values *= values
    product, *slopes = np.split(values, 5, axis=1)
    square = slopes[0]
    for slope in slopes[1:]:
        square += slope
    square *= np.float32(threshold ** 2)
    square += np.float32(1e-30)
    product /= square
    near = product < 1
    return near.sum(axis=1) - (product * near).sum(axis=1), near.mean(axis=1)


def _improved(F: np.ndarray, xy_a: np.ndarray, xy_b: np.ndarray, present: np.ndarray,
              coefficients: np.ndarray, threshold: float,
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Refit F (n, 3, 3) to its inliers, as long as it wins any.

    Parameters
    ----------
    F : ndarray, shape (n, 3, 3)
    xy_a, xy_b : ndarray, shape (n, m, 2)
    present : ndarray of bool, shape (n, m)
        Which matches there are.
    coefficients, threshold
        As in `lifted_ransac`.

    Returns
    -------
    F : ndarray, shape (n, 3, 3)
    near : ndarray of bool, shape (n, m)
        Inliers.
    stands : ndarray of bool, shape (n,)
        Pairs with eight of them.

    """
    def distances(F: np.ndarray) -> np.ndarray:
        apart = np.abs(residuals(xy_a, xy_b, F, coefficients)[0])
        return np.where(present, apart, np.inf)

    distance = distances(F)
    going = np.ones(len(F), bool)
    # the sample's own noise hides inliers from it
    for factor in (2.0, 1.4, 1.0):
        near = distance < factor * threshold
        going &= near.sum(axis=1) >= 8
        if not going.any():
            break
        # where there are too few, all there are stand in
        weight = np.where(going[:, None], near, present).astype(float)
        again = weighted_eight_point(xy_a, xy_b, weight, coefficients, F, 2)
        far = distances(again)
        better = going & (np.minimum(far, threshold).sum(axis=1)
                          <= np.minimum(distance, threshold).sum(axis=1))
        F = np.where(better[:, None, None], again, F)
        distance = np.where(better[:, None], far, distance)
    near = distance < threshold
    return F, near, near.sum(axis=1) >= 8
