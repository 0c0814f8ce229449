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
"""Spread of noise from its median, which gross errors do not move."""

from __future__ import annotations

from typing import overload

import numpy as np
from numpy.typing import ArrayLike

#: Standard deviation of normal noise over the median of its absolute values.
MAD_TO_SIGMA = 1.4826
#: Median length of two-dimensional unit noise, sqrt(2 ln 2): that of Rayleigh's distribution.
RAYLEIGH_MEDIAN = 1.1774


@overload
def robust_sigma(deviations: ArrayLike, axis: None = None) -> float: ...


@overload
def robust_sigma(deviations: ArrayLike, axis: int, keepdims: bool = False) -> np.ndarray: ...


def robust_sigma(deviations: ArrayLike, axis: int | None = None, keepdims: bool = False,
                 ) -> float | np.ndarray:
    """
    Standard deviation of normal noise with gross errors, by the median absolute deviation.

    Parameters
    ----------
    deviations : array_like
        From what they scatter about; NaN ones are left out.
    axis : int, optional
        Along which to take it; over all deviations by default.
    keepdims : bool
        Leave the axis in place with length 1.

    Returns
    -------
    float or ndarray
        In the deviations' unit; NaN where there is none.

    """
    size = np.abs(deviations)
    middle = np.nanmedian if np.isnan(size).any() else np.median
    sigma: float | np.ndarray = MAD_TO_SIGMA * middle(size, axis=axis, keepdims=keepdims)
    return sigma


def fast_robust_sigma(residual: np.ndarray, least: float) -> float:
    """Return the same of a few residuals (N,), in a tenth of the time, never below `least`."""
    count = len(residual)
    if not count:
        return least
    # the upper median: np.median is slow on small arrays
    middle = np.partition(np.abs(residual), count // 2)[count // 2]
    return max(MAD_TO_SIGMA * float(middle), least)


def robust_sigma_of_lengths(lengths: np.ndarray) -> float:
    """Standard deviation of a coordinate of planar noise, by the median of its lengths (N,)."""
    return float(np.median(lengths)) / RAYLEIGH_MEDIAN
