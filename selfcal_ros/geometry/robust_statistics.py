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
"""Scales and weights that outliers do not change."""

from __future__ import annotations

import numpy as np

#: Standard deviation of a normal distribution over its median absolute deviation.
SIGMA_OF_MAD = 1.4826


def robust_sigma(residual: np.ndarray, least: float) -> float:
    """Standard deviation from the median absolute residual, never below `least`."""
    count = len(residual)
    if not count:
        return least
    # np.median is slow on small arrays
    middle = np.partition(np.abs(residual), count // 2)[count // 2]
    return max(SIGMA_OF_MAD * float(middle), least)


def tukey_weight(residual: np.ndarray, limit) -> np.ndarray:
    """Tukey's biweight, 1 at zero and 0 from the limit on."""
    ratio = np.minimum(np.abs(residual) / limit, 1.0)
    return (1 - ratio * ratio)**2
