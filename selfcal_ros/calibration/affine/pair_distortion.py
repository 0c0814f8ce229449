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
Radial distortion of pairs of views, from their epipolar geometry alone.

No fundamental matrix explains distorted points. Two coefficients are the same for all pairs: those
under which the pairs agree best with general F. Each pair has its own F and its own noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.fundamental import (eight_point, pair_residuals, PairMatches,
                                              refine_general)
from selfcal_ros.geometry.projective import homogeneous
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.values.tracks import Tracks

#: Pairs with fewer common points are not tested.
MIN_MATCHES = 12
#: Pairs on which the distortion is estimated, and matches of each.
DISTORTION_PAIRS, DISTORTION_MATCHES = 24, 60
#: Matches beyond so many robust sigmas of general F take no part.
_OUTLIER_SIGMAS = 4.0
#: The tests need costs to such a share.
COST_TOLERANCE = 1e-5
#: Residuals below this are rounding.
MIN_RESIDUAL_PX = 1e-4
#: Largest distortion that is looked for: displacement at the image's corner, as a share of the
#: corner's distance from the middle.
_MAX_DISTORTION = 0.25


def undo_radial(xy: ArrayLike, radial: Sequence[float] | np.ndarray, size: tuple[int, int],
                ) -> np.ndarray:
    """
    Undo radial distortion about the image's middle c: c + (x - c) (1 + a r² + b r⁴).

    Parameters
    ----------
    xy : array_like, shape (..., 2)
        Pixels.
    radial : (float, float)
        a and b, for r in half diagonals of the image: shares of the distance from the middle
        by which the image's corner moves outwards.
    size : (int, int)

    Returns
    -------
    ndarray, shape (..., 2)

    """
    middle = (np.array(size, float) - 1) / 2
    offset = np.asarray(xy, float) - middle
    square = np.sum(offset**2, axis=-1, keepdims=True) / (middle @ middle)
    undone: np.ndarray = middle + offset * (1 + square * (radial[0] + square * radial[1]))
    return undone


def straightened(tracks: Tracks, size: tuple[int, int],
                 radial: tuple[float, float] | None = None) -> Tracks:
    """
    Undo the radial distortion of all observations; those that it leaves nowhere go.

    Parameters
    ----------
    tracks : Tracks
    size : (int, int)
        Width and height, pixels.
    radial : (float, float), optional
        Of `estimate_radial`, which is asked by default.

    Returns
    -------
    Tracks

    """
    radial = estimate_radial(tracks, size) if radial is None else radial
    xy = undo_radial(tracks.xy, radial, size)
    usable = np.isfinite(xy).all(axis=1)
    return Tracks(tracks.frame[usable], tracks.track[usable], xy[usable], size)


def sampled_matches(tracks: Tracks, pairs: np.ndarray, most: int,
                    ) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the matches (M, 2), (M, 2) of every pair of frames, evenly thinned out to so many."""
    found = []
    for a, b in pairs:
        _, xy_a, xy_b = tracks.matches(int(a), int(b))
        few = np.linspace(0, len(xy_a) - 1, min(len(xy_a), most)).astype(int)
        found.append((xy_a[few], xy_b[few]))
    return found


def pairs_with_matches(tracks: Tracks) -> np.ndarray:
    """Return the pairs of frames (n, 2) that share points and differ by more than a shift."""
    frames, view = np.unique(tracks.frame, return_inverse=True)
    _, point = np.unique(tracks.track, return_inverse=True)
    seen = np.zeros((len(frames), int(point.max(initial=-1)) + 1), np.float32)
    seen[view, point] = 1
    common = seen @ seen.T
    a, b = np.triu_indices(len(frames), 1)
    keep = common[a, b] >= MIN_MATCHES
    pairs = np.column_stack([frames[a], frames[b]])[keep]
    different = [_differ(*tracks.matches(int(i), int(j))[1:]) for i, j in pairs]
    usable: np.ndarray = pairs[np.array(different, bool)]
    return usable


def _differ(xy_a: np.ndarray, xy_b: np.ndarray) -> bool:
    """Tell whether two images are more than one image, shifted as a whole, which says nothing."""
    return bool((xy_b - xy_a).std(axis=0).max() > MIN_RESIDUAL_PX)


def general_geometry(data: PairMatches) -> tuple[PairMatches, np.ndarray]:
    """Put the gross errors of n pairs aside; return what remains, and the cost (n,) of their F."""
    F, cost, _, _ = refine_general(data, eight_point(data), tolerance=COST_TOLERANCE)
    distance = np.abs(pair_residuals(data, F)).max(axis=2)
    inside = np.where(data.weight > 0, distance, np.nan)
    limit = _OUTLIER_SIGMAS * np.maximum(robust_sigma(inside, axis=1), MIN_RESIDUAL_PX)
    weight = data.weight * (distance <= limit[:, None])
    if (weight == data.weight).all():
        return data, cost
    data = PairMatches(data.first, data.second, weight, data.transform)
    return data, refine_general(data, F, tolerance=COST_TOLERANCE)[1]


def estimate_radial(tracks: Tracks, size: tuple[int, int], pairs: np.ndarray | None = None,
                    ) -> tuple[float, float]:
    """
    Two distortion coefficients that make the epipolar geometry of the pairs fit best.

    Parameters
    ----------
    tracks : Tracks
    size : (int, int)
        Width and height, pixels.
    pairs : ndarray of int, shape (n, 2), optional
        Frames; all pairs with matches by default, evenly thinned out.

    Returns
    -------
    (float, float)
        See `undo_radial`; zeros where the pairs are not better for it.

    """
    pairs = pairs_with_matches(tracks) if pairs is None else pairs
    if not len(pairs):
        return 0.0, 0.0
    few = pairs[np.linspace(0, len(pairs) - 1, min(len(pairs), DISTORTION_PAIRS)).astype(int)]
    matches = PairMatches.from_pixels(sampled_matches(tracks, few, DISTORTION_MATCHES))
    fit = _RadialFit(general_geometry(matches)[0], size)
    none, *grid = (fit.at(np.array([a, 0.0])) for a in (
        0.0, *np.linspace(-_MAX_DISTORTION, _MAX_DISTORTION, 9)))
    best = min(grid, key=fit.value)
    reach = 1.0
    for _ in range(12):
        ahead = fit.at(best.radial + reach * fit.step(best), best.F)
        fall = fit.value(best) - fit.value(ahead)
        if fall > 0:
            best = ahead
        if abs(fall) < 0.5:
            break
        reach = 1.0 if fall > 0 else 0.25 * reach
    # two more unknowns must be worth it (BIC)
    worth = 2 * np.log(max(float(fit.data.counts.sum()), 2.0))
    if fit.value(none) - fit.value(best) > worth:
        return float(best.radial[0]), float(best.radial[1])
    return 0.0, 0.0


@dataclass(frozen=True)
class _RadialPairs:
    """The best general F of every pair under some distortion."""

    radial: np.ndarray
    matches: PairMatches
    F: np.ndarray
    cost: np.ndarray
    hessian: np.ndarray
    slope: np.ndarray


class _RadialFit:
    """Distortion that pairs share, each with its own F and its own noise."""

    def __init__(self, data: PairMatches, size: tuple[int, int]) -> None:
        self.data, self._size = data, size
        self._scale, self._shift = data.transform[0, 0], data.transform[:2, 2]
        self._pixels = [(x[..., :2] - self._shift) / self._scale
                        for x in (data.first, data.second)]
        self._freedom = data.counts - 7.0

    def _undone(self, radial: np.ndarray) -> PairMatches:
        first, second = (homogeneous(undo_radial(x, radial, self._size) * self._scale
                                     + self._shift) for x in self._pixels)
        return PairMatches(first, second, self.data.weight, self.data.transform)

    def at(self, radial: np.ndarray, F: np.ndarray | None = None) -> _RadialPairs:
        """Find F (n, 3, 3) of every pair, from a start if there is one."""
        part = self._undone(radial)
        return _RadialPairs(radial, part, *refine_general(
            part, eight_point(part) if F is None else F, tolerance=COST_TOLERANCE))

    def _mean_square(self, pairs: _RadialPairs) -> np.ndarray:
        variance: np.ndarray = pairs.cost / np.maximum(self.data.counts, 1) + MIN_RESIDUAL_PX**2
        return variance

    def value(self, pairs: _RadialPairs) -> float:
        """Twice the negative logarithm of the likelihood."""
        return float(np.log(self._mean_square(pairs)) @ self._freedom)

    def step(self, pairs: _RadialPairs) -> np.ndarray:
        """Gauss-Newton step of the two coefficients, every F following (variable projection)."""
        residual, slope = pair_residuals(pairs.matches, pairs.F, derivative=True)
        count = len(residual)
        by_F = (slope.reshape(count, -1, 9) @ pairs.slope)
        reach = 1e-4
        by_radial = np.stack([
            (pair_residuals(self._undone(pairs.radial + reach * axis), pairs.F) - residual) / reach
            for axis in np.eye(2)], axis=-1).reshape(count, -1, 2)
        cross = np.swapaxes(by_F, 1, 2) @ by_radial
        square = np.swapaxes(by_radial, 1, 2) @ by_radial
        square -= np.swapaxes(cross, 1, 2) @ np.linalg.solve(
            pairs.hessian + 1e-12 * np.trace(pairs.hessian, axis1=1, axis2=2)[:, None, None]
            * np.eye(7), cross)
        weight = self._freedom / self._mean_square(pairs) / np.maximum(self.data.counts, 1)
        gradient = np.swapaxes(by_radial, 1, 2) @ residual.reshape(count, -1, 1)
        H = np.einsum('n,nij->ij', weight, square)
        # points of one radius leave a direction open
        downhill = np.einsum('n,ni->i', weight, gradient[..., 0])
        step: np.ndarray = -np.linalg.lstsq(H, downhill, rcond=1e-9)[0]
        return step
