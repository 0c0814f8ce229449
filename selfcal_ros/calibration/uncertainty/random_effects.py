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
The standard deviation of many small effects, estimated from the images themselves.

The coefficients of such effects are independent and Gaussian. Their standard deviation is the one
under which the residuals are most probable (type-II maximum likelihood; Bishop 2006, 3.5).
"""

from __future__ import annotations

import numpy as np


def most_probable_size(values: np.ndarray, pull: np.ndarray, sizes: np.ndarray,
                       ) -> tuple[float, float]:
    """
    Return the standard deviation of the coefficients that explains the images best.

    Parameters
    ----------
    values : ndarray, shape (k,)
        Eigenvalues of the information of the images on the coefficients, which is singular at
        worst.
    pull : ndarray, shape (k,)
        Gradient of half the squared residuals by the coefficients, along its eigenvectors.
    sizes : ndarray, shape (s,)
        Standard deviations that are tried.

    Returns
    -------
    size : float
        One of `sizes`.
    gain : float
        Of log probability over coefficients of zero.

    """
    gains = log_evidence(values, pull, sizes)
    best = int(np.argmax(gains))
    return float(sizes[best]), float(gains[best])


def log_evidence(values: np.ndarray, pull: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """
    Return the gain of log probability over coefficients of zero, for each size, shape (s,).

    Parameters are those of `most_probable_size`.
    """
    square = sizes[:, None]**2
    gains: np.ndarray = 0.5 * np.sum(pull**2 * square / (1 + square * values)
                                     - np.log1p(square * values), axis=1)
    return gains
