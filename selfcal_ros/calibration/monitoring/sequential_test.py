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
Did something change while evidence came in, window by window? A generalised likelihood ratio.

Model: k parameters, some of which may change at a moment that nobody knows, by anything. Windows
tell them with an information matrix each; before the first, a prior does. For every moment twice
the logarithm of the likelihood ratio of a change there to none is a chi-square, with the common
parameters eliminated. Over the moments it is maximised, and the threshold bounds the rate at
which it is exceeded where nothing changed (Lorden 1971; docs/monitoring.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from selfcal_ros.geometry.distributions import chi2_isf

#: What remains of the statistic without its strongest window must be as improbable, too: one
#: window alone, with a moving object in it, proves nothing.
WITHOUT_STRONGEST = 1e-4
#: The newest windows are kept one by one; older ones are merged in pairs, as many of each size.
SINGLE_WINDOWS, OF_EACH_SIZE = 12, 4


@dataclass
class _Block:
    """Sum of the evidence of successive windows, relative to what is in force."""

    information: np.ndarray
    shift: np.ndarray           # information times step
    windows: int
    first_frame: int
    last_frame: int
    score: Any = None

    def merged(self, other: _Block) -> _Block:
        return _Block(self.information + other.information, self.shift + other.shift,
                      self.windows + other.windows, self.first_frame, other.last_frame)


@dataclass(frozen=True)
class Departure:
    """
    A change that the evidence shows.

    Attributes
    ----------
    change : ndarray, shape (3,)
    covariance : ndarray, shape (3, 3)
    since_frame, clear_from_frame, until_frame : int
        First keyframe of the windows that differ; last keyframe of the first of them, from which
        on all is changed; last keyframe of the newest.

    """

    change: np.ndarray
    covariance: np.ndarray
    since_frame: int
    clear_from_frame: int
    until_frame: int


class SequentialTest:
    """
    Compares windows with a prior, and with one another.

    Parameters
    ----------
    prior : ndarray, shape (k, k)
        Covariance of what is in force.
    changes : list of int
        Which three of the parameters may change.
    tolerance : ndarray, shape (3,)
        Variances of what is no change.
    chance : float
        Of an alarm in one test, where nothing changed.
    first_alone : bool
        The first of them may change alone, as a focal length does.

    Attributes
    ----------
    prior, tolerance
        May be replaced as more is learnt.
    statistic, threshold : float
        Of the newest test.
    discarded : int
        Windows that agreed with nothing before or after them.

    """

    def __init__(self, prior: np.ndarray, changes: list[int], tolerance: np.ndarray,
                 chance: float, first_alone: bool):
        self.prior, self.tolerance = prior, tolerance
        self._changes, self._chance, self._first_alone = changes, chance, first_alone
        self._old: list[_Block] = []
        self._new: list[_Block] = []
        self.statistic, self.threshold = 0.0, self._limit(1)
        self.discarded = 0

    @property
    def blocks(self) -> list[_Block]:
        """What is remembered: merged windows, then single ones, in the order of time."""
        return self._old + self._new

    def _limit(self, moments: int) -> float:
        """Bound the rate: the tests of all moments together (Bonferroni), window by window."""
        return float(chi2_isf(self._chance / moments, len(self._changes)))

    def add(self, information: np.ndarray, shift: np.ndarray, frames: tuple[int, ...], score: Any,
            stands: bool) -> Departure | None:
        """
        Take a window, and test every moment that the blocks leave.

        Parameters
        ----------
        information : ndarray, shape (k, k)
            Of the window.
        shift : ndarray, shape (k,)
            Information times the step from what is in force to what the window shows.
        frames : tuple of int
        score : object
            Kept with the window as long as that is single.
        stands : bool
            A change is known: its statement is to be renewed.

        Returns
        -------
        Departure or None

        """
        self._new.append(_Block(symmetric(information), shift, 1, frames[0], frames[-1], score))
        blocks = self.blocks
        after, after_shift = self._sums(blocks)
        before = after[-1] - after + np.linalg.inv(self.prior)
        statistic, change, covariance = self._ratios(before, after_shift[-1] - after_shift,
                                                     after, after_shift)
        best = int(np.argmax(statistic))
        self.statistic, self.threshold = float(statistic[best]), self._limit(len(blocks))
        if best == 0 or self.statistic < self.threshold:
            return None
        if not stands and not self._holds_without_strongest(
                best + 1, before[best], after_shift[-1] - after_shift[best],
                after[best], after_shift[best]):
            return None
        # the change may lie within the first of the windows that differ: it is a mixture of both,
        # and counts with neither
        _, change, covariance = self._ratios(
            before[best:best + 1], (after_shift[-1] - after_shift[best])[None],
            after[best - 1:best], after_shift[best - 1:best])
        first = blocks[-1 - best]
        return Departure(change[0], covariance[0], first.first_frame, first.last_frame,
                         blocks[-1].last_frame)

    @property
    def oldest(self) -> Any:
        """What came with the window that is to be retired; None while there is none."""
        return self._new[0].score if len(self._new) > SINGLE_WINDOWS else None

    def retire(self) -> None:
        """Move the oldest single window to the merged ones, unless it agrees with nothing."""
        block = self._new.pop(0)
        block.score = None
        information = np.linalg.inv(self.prior) + np.sum(
            [b.information for b in self.blocks], axis=0)
        shift = np.sum([b.shift for b in self.blocks], axis=0)
        statistic, *_ = self._ratios(information[None], shift[None],
                                     block.information[None], block.shift[None])
        if statistic[0] > self._limit(1):
            self.discarded += 1
            return
        self._old.append(block)
        for size in (2**k for k in range(60)):
            same = [k for k, b in enumerate(self._old) if size <= b.windows < 2 * size]
            if len(same) <= OF_EACH_SIZE:
                break
            first = same[0]
            self._old[first:first + 2] = [self._old[first].merged(self._old[first + 1])]

    # ------------------------------------------------------------------ the test

    def _sums(self, blocks: list[_Block]) -> tuple[np.ndarray, np.ndarray]:
        """Information (n, k, k) and shift (n, k) of the last 1, 2, ... n blocks together."""
        return (np.cumsum([block.information for block in reversed(blocks)], axis=0),
                np.cumsum([block.shift for block in reversed(blocks)], axis=0))

    def _ratios(self, before: np.ndarray, before_shift: np.ndarray,
                after: np.ndarray, after_shift: np.ndarray,
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Statistics of changes between evidence before and after, batches of n.

        Returns
        -------
        statistic : ndarray, shape (n,)
            As one of three degrees of freedom.
        change : ndarray, shape (n, 3)
        covariance : ndarray, shape (n, 3, 3)
            Tolerance included.

        """
        total = before + after
        along = after[:, :, self._changes]                       # (n, k, 3)
        # what is common, which both sides measure, is eliminated
        solved = np.linalg.solve(total, np.concatenate(
            [along, (before_shift + after_shift)[..., None]], axis=2))
        information = along[:, self._changes] - np.swapaxes(along, 1, 2) @ solved[..., :3]
        right = after_shift[:, self._changes] - np.einsum('nki,nk->ni', along, solved[..., 3])
        # tolerance T: covariance I⁻¹ + T, without inverting an I that may be singular
        eased = np.eye(3) + information * self.tolerance
        weight = np.linalg.solve(eased, information)             # (I⁻¹ + T)⁻¹
        values, vectors = np.linalg.eigh(symmetric(information))
        floor = np.maximum(values, 1e-12 * np.maximum(values[:, -1:], 1e-12))
        inverse = (vectors / floor[:, None]) @ np.swapaxes(vectors, 1, 2)
        change = np.einsum('nij,nj->ni', inverse, right)
        together = np.einsum('ni,nij,nj->n', change, weight, change)
        covariance = inverse + np.diag(self.tolerance)
        if not self._first_alone:
            return together, change, covariance
        # a zoom, a new focus or warmth move the focal length and nothing else
        own = np.maximum(information[:, 0, 0], floor[:, 0])
        zoomed = right[:, 0] / own
        alone = zoomed**2 / (1 / own + self.tolerance[0])
        statistic, is_alone = _less_probable(together, alone)
        change[is_alone] = 0
        covariance[is_alone] = np.diag(self.tolerance)
        change[is_alone, 0] = zoomed[is_alone]
        covariance[is_alone, 0, 0] += 1 / own[is_alone]
        return statistic, change, covariance

    def _holds_without_strongest(self, count: int, before: np.ndarray,
                                 before_shift: np.ndarray, after: np.ndarray,
                                 after_shift: np.ndarray) -> bool:
        """Tell whether the change is seen without any one of its newest windows, too."""
        single = self._new[-count:]
        others = np.stack([after - block.information for block in single])
        other_shifts = np.stack([after_shift - block.shift for block in single])
        statistic, *_ = self._ratios(np.repeat(before[None], len(single), axis=0),
                                     np.repeat(before_shift[None], len(single), axis=0),
                                     others, other_shifts)
        return bool(statistic.min() > chi2_isf(WITHOUT_STRONGEST, len(self._changes)))


def _less_probable(together: np.ndarray, alone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Choose between chi-squares of three and of one degree of freedom.

    Returns
    -------
    ndarray, shape (n,)
        Chi-square with three that is exceeded as rarely as the rarer one, twice as often for
        having had the choice; far out, where both tails are known.
    ndarray of bool, shape (n,)
        Where that of one is the rarer.

    """
    # tails: sqrt(2 s / pi) exp(-s/2) of three, sqrt(2 / (pi s)) exp(-s/2) of one
    like_three = alone + 2 * np.log(np.maximum(alone, 1.0))
    chosen = np.maximum(np.maximum(together, like_three) - 2 * np.log(2), 0.0)
    return chosen, like_three > together


def symmetric(matrix: np.ndarray) -> np.ndarray:
    """Return the symmetric part of matrices (..., k, k)."""
    even: np.ndarray = (matrix + np.swapaxes(matrix, -1, -2)) / 2
    return even
