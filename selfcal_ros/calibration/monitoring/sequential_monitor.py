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
What every monitor does with its windows: the sequential test, and how much windows scatter.

Windows of keyframes disagree by more than their own errors say, for every scene has its own. How
much is learnt from those windows that nothing contradicts, and a change has to exceed it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from selfcal_ros.calibration.monitoring.sequential_test import _Block, Departure, SequentialTest
from selfcal_ros.calibration.monitoring.window_scatter import WindowScatter

#: Share of the windows' scatter, as a variance, that a change has to exceed.
SHARED_SCATTER = 0.25


class SequentialMonitor:
    """
    Compares windows with what is in force, and with one another.

    Parameters
    ----------
    prior : ndarray, shape (k, k)
        Covariance of what is in force, as it was stated.
    changes : list of int
        Which three of the parameters may change.
    least : ndarray, shape (3,)
        Variances of what is no change.
    chance, first_alone
        See `SequentialTest`.

    Attributes
    ----------
    change : object or None
        The alarm. It stays once it is raised, and what it states improves with every window.
    windows : int
        Windows that were taken.

    """

    def __init__(self, prior: np.ndarray, changes: list[int], least: np.ndarray, chance: float,
                 first_alone: bool):
        self._changes, self._least = changes, least
        self._stated = prior + np.diag(_spread(0.01 * least, changes, len(prior)))
        self._test = SequentialTest(self._stated, changes, least, chance, first_alone)
        self._scatter = WindowScatter(least)
        self._of_windows = least
        self.change: Any = None
        self.windows = 0

    @property
    def statistic(self) -> float:
        """Of the newest test."""
        return self._test.statistic

    @property
    def threshold(self) -> float:
        """Of the newest test."""
        return self._test.threshold

    @property
    def discarded(self) -> int:
        """Windows that agreed with nothing before or after."""
        return self._test.discarded

    @property
    def remembered(self) -> list[_Block]:
        """The evidence so far, in blocks."""
        return self._test.blocks

    def learn(self, score: Any) -> None:
        """
        Take the score of a window of those keyframes that what is in force was estimated from.

        It is no evidence, but tells how well windows agree with that.
        """
        mean = self._along(self._remember(score))
        # by so much all windows may disagree with what is in force
        self._test.prior = self._stated + np.outer(mean, mean)

    def _seen(self, score: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return what a window shows of a change, shape (3,), and its covariance, (3, 3)."""
        raise NotImplementedError

    def _along(self, values: np.ndarray) -> np.ndarray:
        """Spread values (3,) of what may change over all parameters, (k,)."""
        return _spread(values, self._changes, len(self._stated))

    def _ask(self, score: Any, information: np.ndarray, shift: np.ndarray,
             own: np.ndarray) -> Departure | None:
        """Test a window whose scene has errors of its own, with variances (3,)."""
        self.windows += 1
        weight = np.linalg.inv(np.eye(len(information)) + information * self._along(own))
        return self._test.add(weight @ information, weight @ shift, score.frames, score,
                              self.change is not None)

    def _retire(self) -> None:
        """Learn from the oldest single window, and merge it."""
        if self._test.oldest is None:
            return
        # not after a change: windows then scatter about something else
        if self.change is None:
            self._remember(self._test.oldest)
        self._test.retire()

    def _remember(self, score: Any) -> np.ndarray:
        """Learn how large the errors of windows are; returns their mean, shape (3,)."""
        step, covariance = self._seen(score)
        self._scatter.remember(step, covariance)
        self._of_windows, mean = self._scatter.tolerance()
        # neighbouring windows share a scene, so that their mean scatters, too
        self._test.tolerance = np.maximum(self._least, SHARED_SCATTER * self._of_windows)
        return mean


def _spread(values: np.ndarray, places: list[int], count: int) -> np.ndarray:
    result = np.zeros(count)
    result[places] = values
    return result
