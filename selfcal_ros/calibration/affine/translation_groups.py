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

from selfcal_ros.calibration.affine.pair_distortion import (COST_TOLERANCE, estimate_radial,
                                                            general_geometry, MIN_MATCHES,
                                                            MIN_RESIDUAL_PX, pairs_with_matches,
                                                            sampled_matches, undo_radial)
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.distributions import f_isf
from selfcal_ros.geometry.fundamental import PairMatches, refine_translation
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.values.tracks import Tracks

#: So many matches of a pair, evenly chosen, take part.
MAX_MATCHES = 150
#: Pairs of views that are tested together: the derivatives of thousands would take gigabytes.
AT_ONCE = 256
#: A true translation is rejected as often as this.
SIGNIFICANCE = 0.01
#: What a robot calls a translation turns the camera by a little, and no lens is quite as its
#: model: F = [e]x may leave so much more than general F (root mean square, in diagonals of the
#: image, and in noise sigmas), however many matches there are.
TOLERATED_DIAGONALS, TOLERATED_SIGMAS = 1e-4, 0.3
#: A pair that moves the points by less than so many sigmas is no baseline.
MIN_MOTION_SIGMAS = 20.0


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

    """

    frames: np.ndarray
    statistic: np.ndarray
    limit: np.ndarray
    noise_px: np.ndarray
    motion_px: np.ndarray

    @property
    def translated(self) -> np.ndarray:
        """Pairs that a translation explains as well as any motion, shape (n,)."""
        return self.statistic <= self.limit

    @property
    def baseline(self) -> np.ndarray:
        """Translated pairs whose points have moved enough to tell of depth, shape (n,)."""
        return self.translated & (self.motion_px > MIN_MOTION_SIGMAS * self.noise_px)


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

    groups: tuple[tuple[int, ...], ...]
    radial: tuple[float, float]
    tests: PairTests

    def finding(self) -> Finding | NoEstimate:
        """What was found; a `NoEstimate` where there is no group."""
        tests = self.tests
        if not len(tests.frames):
            return NoEstimate('too_few_shared', views=2, needed=MIN_MATCHES, items='points')
        if not self.groups:
            # pairs that hardly moved are rejected for nothing but that
            ratio = tests.statistic / tests.limit
            best = int(np.argmin(np.where(tests.translated & ~tests.translated.all(), np.inf,
                                          ratio)))
            a, b = tests.frames[best]
            return NoEstimate('no_translated_pair', pairs=len(tests.frames), first=int(a),
                              second=int(b), statistic=float(tests.statistic[best]),
                              limit=float(tests.limit[best]))
        return Finding('translation_groups', groups=len(self.groups),
                       sizes=tuple(len(group) for group in self.groups),
                       views=len(np.unique(tests.frames)))

    def explain(self) -> str:
        """Say what was found."""
        return self.finding().sentence


def classify_translations(tracks: Tracks, size: tuple[int, int],
                          radial: tuple[float, float] | None = None,
                          ) -> tuple[PairTests, tuple[float, float]]:
    """
    Test all pairs of views that share enough points for pure translation.

    Parameters
    ----------
    tracks : Tracks
        Pixels, undistorted or mildly distorted; gross errors should be few.
    size : (int, int)
        Width and height, pixels.
    radial : (float, float), optional
        Distortion, see `undo_radial`; estimated by default, zeros where the pixels are
        undistorted.

    Returns
    -------
    PairTests
    radial : (float, float)

    """
    pairs = pairs_with_matches(tracks)
    if not len(pairs):
        none = np.zeros(0)
        return PairTests(pairs, none, none, none, none), (0.0, 0.0)
    radial = estimate_radial(tracks, size, pairs) if radial is None else radial
    parts = [_tested(tracks, size, pairs[at:at + AT_ONCE], radial)
             for at in range(0, len(pairs), AT_ONCE)]
    return PairTests(pairs, *map(np.concatenate, zip(*parts))), radial


def _tested(tracks: Tracks, size: tuple[int, int], pairs: np.ndarray,
            radial: tuple[float, float]) -> tuple[np.ndarray, ...]:
    """Return all but the frames of `PairTests`, of some pairs."""
    samples = [(undo_radial(a, radial, size), undo_radial(b, radial, size))
               for a, b in sampled_matches(tracks, pairs, MAX_MATCHES)]
    data, cost = general_geometry(PairMatches.from_pixels(samples))
    _, translation_cost, _, _ = refine_translation(data, COST_TOLERANCE)
    count = (data.weight > 0).sum(axis=1)
    # each of the two distances of a match has variance 2 sigma^2
    noise = np.maximum(np.sqrt(cost / (4 * np.maximum(count - 7, 1))), MIN_RESIDUAL_PX)
    statistic = np.maximum(translation_cost - cost, 0) / 5 / (4 * noise**2)
    limit = f_isf(SIGNIFICANCE, 5, np.maximum(count - 7, 1))
    tolerated = np.maximum(TOLERATED_DIAGONALS * np.hypot(*size) / noise, TOLERATED_SIGMAS)
    limit = limit + tolerated**2 * count / 5
    motion = np.array([np.median(np.linalg.norm(b - a, axis=1)) for a, b in samples])
    return statistic, limit, noise, motion


def translation_groups(tracks: Tracks, size: tuple[int, int],
                       radial: tuple[float, float] | None = None) -> TranslationGroups:
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
