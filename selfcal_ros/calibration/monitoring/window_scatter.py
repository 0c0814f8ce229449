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
"""How large the errors of windows are: dependence within tracks, and differences of scenes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from selfcal_ros.calibration.monitoring.window_score import WindowScore
from selfcal_ros.geometry.distributions import chi2_isf

#: Windows whose dependence and scatter are remembered, and that it takes to judge the scatter.
REMEMBERED, MIN_FOR_SCATTER = 60, 3
#: The variances that scenes add may grow to so many times the stated tolerance.
MAX_TOLERANCE = 1e4
#: A window whose dependence exceeds the usual by this factor has errors of its own.
UNUSUAL = 1.5


class UsualWindow(NamedTuple):
    """What most windows have: see `WindowScore`."""

    noise_px: float
    misfit: float
    variance_inflation: float


class UsualWindows:
    """What most windows of a camera are like, judged by the windows so far."""

    def __init__(self) -> None:
        self._known: list[WindowScore] = []

    def usual(self, noise_px: float) -> UsualWindow:
        """Return the medians of the windows so far; the noise that is given without any."""
        if not self._known:
            return UsualWindow(noise_px, 1.0, 1.0)
        return UsualWindow(*np.median([(one.noise_px, one.misfit, max(one.variance_inflation, 1.0))
                                       for one in self._known], axis=0).tolist())

    def inflation_of(self, score: WindowScore) -> float:
        """
        Variance of a window over that of independent errors, never less than one.

        Windows scatter about the median; one that exceeds it by far has errors of its own.
        """
        own, before = score.variance_inflation, [one.variance_inflation for one in self._known]
        if before and own > UNUSUAL * max(1.0, float(np.median(before))):
            return own
        return max(1.0, float(np.median([*before, own])))

    def remember(self, score: WindowScore) -> None:
        """Remember a window."""
        self._known.append(score)
        del self._known[:-REMEMBERED]


class WindowScatter:
    """
    How large the errors of windows are, judged by the windows so far.

    Parameters
    ----------
    tolerance : ndarray, shape (3,)
        Variances that every window has in addition to its covariance, at least.

    """

    def __init__(self, tolerance: np.ndarray):
        self._least = tolerance
        self._seen: list[tuple[np.ndarray, np.ndarray]] = []

    def remember(self, step: np.ndarray, covariance: np.ndarray) -> None:
        """Remember a window: its distance from what is in force, and its covariance."""
        self._seen.append((step, covariance))
        del self._seen[:-REMEMBERED]

    def tolerance(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Judge how far windows are from one another, beyond what their covariances say.

        A lens that is not quite the model differs from scene to scene by more than noise.

        Returns
        -------
        tolerance : ndarray, shape (3,)
            Variances under which the windows scatter as they do, or the least.
        mean : ndarray, shape (3,)
            Of their distances from what is in force; zero where they are too few.

        """
        count = len(self._seen)
        if count < MIN_FOR_SCATTER:
            return self._least, np.zeros(3)
        steps, covariances = (np.array(part) for part in zip(*self._seen))
        # the mean takes its share of the freedom
        share = (count - 1) / count

        def scatter(factor: float) -> tuple[float, np.ndarray]:
            weights = np.linalg.inv(covariances + factor * np.diag(self._least))
            mean = np.linalg.solve(weights.sum(axis=0),
                                   np.einsum('nij,nj->i', weights, steps))
            off = steps - mean
            return float(np.median(np.einsum('ni,nij,nj->n', off, weights, off))), mean

        # the median of so few may exceed its expectation by chance
        middle, mean = scatter(1.0)
        if middle < share * chi2_isf(0.5 - 0.82 / np.sqrt(count), 3):
            return self._least, mean
        low, high = 0.0, np.log(MAX_TOLERANCE)
        for _ in range(20):
            factor = (low + high) / 2
            if scatter(np.exp(factor))[0] > share * chi2_isf(0.5, 3):
                low = factor
            else:
                high = factor
        return np.exp(high) * self._least, scatter(np.exp(high))[1]
