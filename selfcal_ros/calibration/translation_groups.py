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
Which views are related by pure translation, from the images alone.

For every pair of views F = [e]x (2 degrees of freedom) is tested against general F (7) by a
likelihood ratio with the pair's own noise. Radial distortion, which no F explains, would count
against the poorer model: two coefficients, the same for all pairs, are estimated before.
Translation is an equivalence: views fall into groups in which the pairs agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from selfcal_ros.calibration.tracks import Tracks
from selfcal_ros.geometry.fundamental import (eight_point, pair_residuals, PairMatches,
                                              refine_general, refine_translation)
from selfcal_ros.geometry.projective import homogeneous

#: Pairs with fewer common points are not tested.
LEAST_MATCHES = 12
#: So many matches of a pair, evenly chosen, take part.
MOST_MATCHES = 150
#: Pairs on which the distortion is estimated, and matches of each.
DISTORTION_PAIRS, DISTORTION_MATCHES = 24, 60
#: A true translation is rejected as often as this.
SIGNIFICANCE = 0.01
#: What a robot calls a translation turns the camera by a little, and no lens is quite as its
#: model: F = [e]x may leave so much more than general F (root mean square, in diagonals of the
#: image, and in noise sigmas), however many matches there are.
TOLERATED_DIAGONALS, TOLERATED_SIGMAS = 1e-4, 0.3
#: A pair that moves the points by less than so many sigmas is no baseline.
LEAST_MOTION_SIGMAS = 20.0
#: Matches beyond so many robust sigmas of general F take no part.
_OUTLIER_SIGMAS = 4.0
#: The tests need costs to such a share.
_TOLERANCE = 1e-5
#: Residuals below this are rounding.
_FLOOR_PX = 1e-4
#: Largest distortion that is looked for: displacement at the image's corner, as a share of the
#: corner's distance from the middle.
_MOST_DISTORTION = 0.25


@dataclass(frozen=True)
class PairTests:
    """
    Translation against general motion for n pairs of views.

    Attributes
    ----------
    frames : ndarray of int, shape (n, 2)
    statistic : ndarray, shape (n,)
        F statistic with 5 degrees of freedom; about 1 for a pure translation.
    limit : ndarray, shape (n,)
        Largest statistic of a translation.
    noise_px : ndarray, shape (n,)
        Standard deviation of an image coordinate by general F.
    motion_px : ndarray, shape (n,)
        Median displacement of the points.
    epipole : ndarray, shape (n, 3)
        Of F = [e]x, unit norm, undistorted pixels.

    """

    frames: np.ndarray
    statistic: np.ndarray
    limit: np.ndarray
    noise_px: np.ndarray
    motion_px: np.ndarray
    epipole: np.ndarray

    @property
    def translated(self) -> np.ndarray:
        """Pairs that a translation explains as well as any motion, shape (n,)."""
        return self.statistic <= self.limit

    @property
    def baseline(self) -> np.ndarray:
        """Translated pairs whose points have moved enough to tell of depth, shape (n,)."""
        return self.translated & (self.motion_px > LEAST_MOTION_SIGMAS * self.noise_px)


@dataclass(frozen=True)
class TranslationGroups:
    """
    Groups of views of one orientation.

    Attributes
    ----------
    groups : tuple of tuple of int
        Frames of each group of two or more views with a baseline among them, the best first
        (most translated pairs).
    radial : (float, float)
        Distortion that the tests were made with, see `undo_radial`.
    tests : PairTests

    """

    groups: tuple
    radial: tuple[float, float]
    tests: PairTests

    def explain(self) -> str:
        """Say in one sentence what was found."""
        tests = self.tests
        if not len(tests.frames):
            return f'No two views share {LEAST_MATCHES} points.'
        if not self.groups:
            best = int(np.argmin(tests.statistic / tests.limit))
            a, b = tests.frames[best]
            return (f'No two views are related by pure translation: of {len(tests.frames)} pairs '
                    f'frames {a} and {b} come nearest, where F = [e]x is rejected with '
                    f'{tests.statistic[best]:.3g} against {tests.limit[best]:.3g}.')
        sizes = ', '.join(str(len(group)) for group in self.groups)
        return (f'{len(self.groups)} group{"s" if len(self.groups) > 1 else ""} of translated '
                f'views ({sizes} of {len(np.unique(tests.frames))} views).')


def undo_radial(xy, radial, size: tuple[int, int]) -> np.ndarray:
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
    return middle + offset * (1 + square * (radial[0] + square * radial[1]))


def _samples(tracks: Tracks, pairs, most: int):
    found = []
    for a, b in pairs:
        _, xy_a, xy_b = tracks.matches(int(a), int(b))
        few = np.linspace(0, len(xy_a) - 1, min(len(xy_a), most)).astype(int)
        found.append((xy_a[few], xy_b[few]))
    return found


def _pairs_with_matches(tracks: Tracks) -> np.ndarray:
    frames, view = np.unique(tracks.frame, return_inverse=True)
    _, point = np.unique(tracks.track, return_inverse=True)
    seen = np.zeros((len(frames), int(point.max(initial=-1)) + 1), np.float32)
    seen[view, point] = 1
    common = seen @ seen.T
    a, b = np.triu_indices(len(frames), 1)
    keep = common[a, b] >= LEAST_MATCHES
    pairs = np.column_stack([frames[a], frames[b]])[keep]
    return pairs[[_differ(*tracks.matches(int(i), int(j))[1:]) for i, j in pairs]] \
        if len(pairs) else pairs


def _differ(xy_a, xy_b) -> bool:
    """Tell whether two images are more than one image, shifted as a whole, which says nothing."""
    return bool((xy_b - xy_a).std(axis=0).max() > _FLOOR_PX)


def _general(data: PairMatches):
    """Cost of general F of every pair, with gross errors put aside; data with new weights."""
    F, cost, _, _ = refine_general(data, eight_point(data), tolerance=_TOLERANCE)
    distance = np.abs(pair_residuals(data, F)).max(axis=2)
    inside = np.where(data.weight > 0, distance, np.nan)
    limit = _OUTLIER_SIGMAS * np.maximum(1.4826 * np.nanmedian(inside, axis=1), _FLOOR_PX)
    weight = data.weight * (distance <= limit[:, None])
    if (weight == data.weight).all():
        return data, cost
    data = PairMatches(data.first, data.second, weight, data.transform)
    return data, refine_general(data, F, tolerance=_TOLERANCE)[1]


def estimate_radial(tracks: Tracks, size: tuple[int, int], pairs=None) -> tuple[float, float]:
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
    pairs = _pairs_with_matches(tracks) if pairs is None else pairs
    if not len(pairs):
        return 0.0, 0.0
    few = pairs[np.linspace(0, len(pairs) - 1, min(len(pairs), DISTORTION_PAIRS)).astype(int)]
    fit = _RadialFit(_general(PairMatches.from_pixels(_samples(tracks, few,
                                                               DISTORTION_MATCHES)))[0], size)
    none, *grid = (fit.at(np.array([a, 0.0])) for a in (
        0.0, *np.linspace(-_MOST_DISTORTION, _MOST_DISTORTION, 9)))
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

    def __init__(self, data: PairMatches, size):
        self.data, self._size = data, size
        self._scale, self._shift = data.transform[0, 0], data.transform[:2, 2]
        self._pixels = [(x[..., :2] - self._shift) / self._scale
                        for x in (data.first, data.second)]
        self._freedom = data.counts - 7.0

    def _undone(self, radial) -> PairMatches:
        return PairMatches(*(homogeneous(undo_radial(x, radial, self._size) * self._scale
                                         + self._shift) for x in self._pixels),
                           self.data.weight, self.data.transform)

    def at(self, radial, F=None) -> _RadialPairs:
        """Find F (n, 3, 3) of every pair, from a start if there is one."""
        part = self._undone(radial)
        return _RadialPairs(radial, part, *refine_general(
            part, eight_point(part) if F is None else F, tolerance=_TOLERANCE))

    def _mean_square(self, pairs: _RadialPairs) -> np.ndarray:
        return pairs.cost / np.maximum(self.data.counts, 1) + _FLOOR_PX**2

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
        return -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(2),
                                np.einsum('n,ni->i', weight, gradient[..., 0]))


def classify_translations(tracks: Tracks, size: tuple[int, int], pairs=None, radial=None,
                          ) -> tuple[PairTests, tuple[float, float]]:
    """
    Test pairs of views for pure translation.

    Parameters
    ----------
    tracks : Tracks
        Pixels, undistorted or mildly distorted; gross errors should be few.
    size : (int, int)
        Width and height, pixels.
    pairs : array_like of int, shape (n, 2), optional
        Frames; all with enough matches by default.
    radial : (float, float), optional
        Distortion, see `undo_radial`; estimated by default, zeros where the pixels are
        undistorted.

    Returns
    -------
    PairTests
    radial : (float, float)

    """
    pairs = _pairs_with_matches(tracks) if pairs is None else np.asarray(pairs).reshape(-1, 2)
    if not len(pairs):
        none = np.zeros(0)
        return PairTests(pairs, none, none, none, none, np.zeros((0, 3))), (0.0, 0.0)
    radial = estimate_radial(tracks, size, pairs) if radial is None else radial
    samples = [(undo_radial(a, radial, size), undo_radial(b, radial, size))
               for a, b in _samples(tracks, pairs, MOST_MATCHES)]
    data, cost = _general(PairMatches.from_pixels(samples))
    F, translation_cost, _, _ = refine_translation(data, _TOLERANCE)
    count = (data.weight > 0).sum(axis=1)
    # each of the two distances of a match has variance 2 sigma^2
    noise = np.maximum(np.sqrt(cost / (4 * np.maximum(count - 7, 1))), _FLOOR_PX)
    statistic = np.maximum(translation_cost - cost, 0) / 5 / (4 * noise**2)
    limit = f_distribution.ppf(1 - SIGNIFICANCE, 5, np.maximum(count - 7, 1))
    tolerated = np.maximum(TOLERATED_DIAGONALS * np.hypot(*size) / noise, TOLERATED_SIGMAS)
    limit = limit + tolerated**2 * count / 5
    F = data.pixels_F(F)
    motion = np.array([np.median(np.linalg.norm(b - a, axis=1)) for a, b in samples])
    epipole = np.stack([F[:, 2, 1], F[:, 0, 2], F[:, 1, 0]], axis=1)
    epipole /= np.linalg.norm(epipole, axis=1, keepdims=True)
    return PairTests(pairs, statistic, limit, noise, motion, epipole), radial


def translation_groups(tracks: Tracks, size: tuple[int, int],
                       radial=None) -> TranslationGroups:
    """
    Find the groups of views that are related by pure translation.

    Parameters
    ----------
    tracks : Tracks
        Pixels, undistorted or mildly distorted; gross errors should be few (those of a view
        graph are).
    size : (int, int)
        Width and height, pixels.
    radial : (float, float), optional
        Distortion, see `undo_radial`; estimated by default.

    Returns
    -------
    TranslationGroups
        Without groups where no pair is a translation.

    """
    tests, radial = classify_translations(tracks, size, radial=radial)
    frames = np.unique(tests.frames)
    size_of = len(frames)
    ratio = np.full((size_of, size_of), np.nan)
    a, b = np.searchsorted(frames, tests.frames).T
    ratio[a, b] = ratio[b, a] = tests.statistic / tests.limit
    member = np.arange(size_of)
    # the surest pairs join first; two groups join where most pairs between them agree
    for k in np.argsort(ratio[a, b]):
        if not ratio[a[k], b[k]] <= 1:
            break
        left, right = member == member[a[k]], member == member[b[k]]
        if member[a[k]] != member[b[k]] and np.nanmedian(ratio[np.ix_(left, right)]) <= 1:
            member[right] = member[a[k]]
    found = []
    for label in np.unique(member):
        inside = member == label
        own = tests.translated & inside[a] & inside[b]
        if (own & tests.baseline).any():
            found.append((int(own.sum()), tuple(int(f) for f in frames[inside])))
    found.sort(key=lambda entry: (-entry[0], entry[1]))
    return TranslationGroups(tuple(group for _, group in found), radial, tests)
