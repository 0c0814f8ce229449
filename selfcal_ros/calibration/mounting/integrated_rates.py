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
"""Angular rates, integrated to turns, with what these follow from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.values.angular_rates import AngularRates

#: Rates between two measurements further apart than this are not known, seconds.
LONGEST_GAP_S = 0.1


def integrate(rates: np.ndarray, steps_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Integrate angular rates about the axes of a body.

    Parameters
    ----------
    rates : ndarray, shape (N, 3)
        Mean rate of each step, rad/s.
    steps_s : ndarray, shape (N,)

    Returns
    -------
    turns : ndarray, shape (N + 1, 3, 3)
        Orientation at the ends of the steps, the identity first.
    sums : ndarray, shape (N + 1, 3, 3)
        Integral of the orientation over time.

    """
    each = rotation_matrix(rates * steps_s[:, None])
    turns = np.concatenate([np.eye(3)[None], each])
    # products of 1, 2, 4, ... neighbours: a parallel prefix scan
    reach = 1
    while reach < len(turns):
        turns[reach:] = turns[:-reach] @ turns[reach:]
        reach *= 2
    middle = turns[:-1] @ rotation_matrix(rates * (steps_s / 2)[:, None])
    sums = np.concatenate([np.zeros((1, 3, 3)),
                           np.cumsum(middle * steps_s[:, None, None], axis=0)])
    return turns, sums


@dataclass(frozen=True)
class RateSteps:
    """Rates as steps between measurements, in seconds since the first."""

    times: np.ndarray
    mean: np.ndarray

    @classmethod
    def of(cls, rates: AngularRates) -> RateSteps:
        """Take the mean of the rates at both ends of a step."""
        times = (rates.stamps_ns - rates.stamps_ns[0]) * 1e-9
        return cls(times, (rates.rate_rad_s[1:] + rates.rate_rad_s[:-1]) / 2)

    def covers(self, instants: np.ndarray) -> np.ndarray:
        """Tell which intervals between instants (V,) are known, shape (V - 1,)."""
        within = (instants >= self.times[0]) & (instants <= self.times[-1])
        gaps = np.concatenate([[0], np.cumsum(np.diff(self.times) > LONGEST_GAP_S)])
        # an instant inside a gap has it before and after itself
        last, following = (np.clip(place, 0, len(gaps) - 1) for place in (
            np.searchsorted(self.times, instants, 'right') - 1,
            np.searchsorted(self.times, instants)))
        covered: np.ndarray = within[1:] & within[:-1] & (
            gaps[following[1:]] == gaps[last[:-1]])
        return covered

    def less(self, bias: np.ndarray) -> Turns:
        """Integrate the rates less a bias (3,)."""
        rates = self.mean - bias
        return Turns(self.times, rates, *integrate(rates, np.diff(self.times)))


@dataclass(frozen=True)
class Turns:
    """Integrated rates."""

    times: np.ndarray
    rates: np.ndarray
    turns: np.ndarray
    sums: np.ndarray

    def _at(self, when: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return orientation, its integral and the rate at instants (M,)."""
        step = np.clip(np.searchsorted(self.times, when, side='right') - 1, 0,
                       len(self.rates) - 1)
        rate, rest = self.rates[step], (when - self.times[step])[:, None]
        turn = self.turns[step] @ rotation_matrix(rate * rest)
        half = self.turns[step] @ rotation_matrix(rate * rest / 2)
        return turn, self.sums[step] + half * rest[..., None], rate

    def between(self, instants: np.ndarray, later: np.ndarray,
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return turns from instants (M,) to later ones (M,), and their derivatives.

        Returns
        -------
        turned : ndarray, shape (M, 3, 3)
        by_bias : ndarray, shape (M, 3, 3)
            A small turn after `turned`, by the bias.
        by_offset : ndarray, shape (M, 3)
            The same by the offset of the clocks: both instants move back.

        """
        (first, sum_first, rate_first), (last, sum_last, rate_last) = (
            self._at(instants), self._at(later))
        turned = np.swapaxes(first, 1, 2) @ last
        by_offset = np.einsum('mji,mj->mi', turned, rate_first) - rate_last
        return turned, -np.swapaxes(last, 1, 2) @ (sum_last - sum_first), by_offset
