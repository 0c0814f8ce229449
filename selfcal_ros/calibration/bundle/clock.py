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
"""When the views were taken and their lines read; derivatives of what is known at the views."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

from selfcal_ros.calibration.bundle.priors import Prior

#: So many views around one tell how the camera moves there: a polynomial through all of them.
STENCIL = 7
#: A gap in time counts as so many usual intervals at most. A clock that was set meanwhile leaves
#: decades, beside which all the instants on one side are the same number.
LONGEST_GAP = 1e4


def was_turned_upright(size: tuple[int, int]) -> bool:
    """Tell whether an image of this width and height was turned after it was read."""
    width, height = size
    return height > width


@dataclass(frozen=True)
class Clock:
    """
    When the middle rows of the views were read.

    Attributes
    ----------
    times : ndarray, shape (V,)
        In intervals between frames, ascending.
    lines : int
        Height of the image; its width where columns are read one after the other.
    unit : float
        Length of the interval, in seconds where frames have stamps, else in frames.
    is_stamped : bool
    known : Prior, optional
        What is stated of the line delay.
    axis : int
        The pixel coordinate that tells the line: 1 of rows, 0 of columns.

    """

    times: np.ndarray
    lines: int
    unit: float = 1.0
    is_stamped: bool = False
    known: Prior | None = None
    axis: int = 1

    def of_views(self, kept: np.ndarray) -> Clock:
        """Return the clock of some of the views."""
        return replace(self, times=self.times[kept])

    def by_columns(self, columns: int) -> Clock:
        """Return the clock of an image of so many columns that are read one after the other."""
        scale, known = columns / self.lines, self.known
        return replace(self, lines=columns, axis=0, known=known and replace(
            known, value=known.value * scale, sigma=known.sigma * scale))

    def read_as(self, other: Clock) -> Clock:
        """Return the same instants, of images whose lines are read as those of another clock."""
        return replace(self, lines=other.lines, known=other.known, axis=other.axis)

    def delays(self, xy: np.ndarray) -> np.ndarray:
        """Return τ over the line delay for observed pixels (N, 2), shape (N,)."""
        return line_of(xy, self.lines, self.axis)


def line_of(xy: np.ndarray, lines: int, axis: int) -> np.ndarray:
    """Return the line of pixels (N, 2), shape (N,): -1/2 is the first one and 1/2 the last."""
    line: np.ndarray = (xy[:, axis] - (lines - 1) / 2) / lines
    return line


def difference_weights(times: np.ndarray, most: int = STENCIL,
                       ) -> tuple[np.ndarray, np.ndarray]:
    """
    Differentiate what is known at some times, at each of them.

    Parameters
    ----------
    times : ndarray, shape (V,)
        Ascending; gaps beyond `LONGEST_GAP` count as that.
    most : int
        Values that are used for one derivative, at most.

    Returns
    -------
    near : ndarray of int, shape (V, s)
        Which values are used: those of the nearest.
    weights : ndarray, shape (3, V, s)
        Of the first, the second and the third derivative, exact for polynomials of degree s - 1;
        zero of one that so few do not tell.

    References
    ----------
    B. Fornberg (1988), Generation of finite difference formulas on arbitrarily spaced grids.

    """
    views = len(times)
    count = min(most, views)
    steps = np.diff(times)
    if views > 1:
        steps = np.minimum(steps, LONGEST_GAP * np.median(steps))
    times = np.r_[0.0, np.cumsum(steps)]
    begin = np.clip(np.arange(views) - count // 2, 0, views - count)
    near = begin[:, None] + np.arange(count)
    apart = times[near] - times[:, None]
    # in units of the reach, so that the powers stay of one size
    reach = np.abs(apart).max(axis=1)
    powers = (apart / reach[:, None])[:, None, :]**np.arange(count)[:, None]
    wanted = np.zeros((count, 3))
    for order in range(1, min(count, 4)):
        wanted[order, order - 1] = math.factorial(order)
    weights = np.linalg.solve(powers, np.broadcast_to(wanted, (views, count, 3)))
    return near, np.moveaxis(weights, 2, 0) / reach[:, None]**np.arange(1, 4)[:, None, None]
