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

import numpy as np
from scipy.stats import chi2

#: Windows whose dependence and scatter are remembered, and that it takes to judge the scatter.
REMEMBERED, MIN_FOR_SCATTER = 60, 3
#: The variances that scenes add may grow to so many times the stated tolerance.
MAX_TOLERANCE = 1e4


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
        self._dependence: list[float] = []
        self._seen: list[tuple[np.ndarray, np.ndarray]] = []

    def inflation(self, own: float) -> float:
        """
        Variance of a window over that of independent errors, never less than one.

        A change raises that of its windows only, which the median ignores.
        """
        return max(1.0, float(np.median([*self._dependence, own])))

    def remember(self, dependence: float, step, covariance) -> None:
        """Remember a window: its distance from the camera in force, and its covariance."""
        self._dependence.append(dependence)
        self._seen.append((step, covariance))
        del self._dependence[:-REMEMBERED], self._seen[:-REMEMBERED]

    def tolerance(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Judge how far windows are from one another, beyond what their covariances say.

        A lens that is not quite the model differs from scene to scene by more than noise.

        Returns
        -------
        tolerance : ndarray, shape (3,)
            Variances under which the windows scatter as they do, or the least.
        mean : ndarray, shape (3,)
            Of their distances from the camera in force; zero where they are too few.

        """
        count = len(self._seen)
        if count < MIN_FOR_SCATTER:
            return self._least, np.zeros(3)
        steps, covariances = (np.array(part) for part in zip(*self._seen))
        # the mean takes its share of the freedom
        share = (count - 1) / count

        def scatter(factor):
            weights = np.linalg.inv(covariances + factor * np.diag(self._least))
            mean = np.linalg.solve(weights.sum(axis=0),
                                   np.einsum('nij,nj->i', weights, steps))
            off = steps - mean
            return float(np.median(np.einsum('ni,nij,nj->n', off, weights, off))), mean

        # the median of so few may exceed its expectation by chance
        middle, mean = scatter(1.0)
        if middle < share * chi2.ppf(0.5 + 0.82 / np.sqrt(count), 3):
            return self._least, mean
        low, high = 0.0, np.log(MAX_TOLERANCE)
        for _ in range(20):
            factor = (low + high) / 2
            if scatter(np.exp(factor))[0] > share * chi2.median(3):
                low = factor
            else:
                high = factor
        return np.exp(high) * self._least, scatter(np.exp(high))[1]
