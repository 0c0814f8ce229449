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
"""A measured value with the digits that its sigma leaves."""

from __future__ import annotations

import numpy as np


def with_sigma(value: float, sigma: float) -> tuple[str, str]:
    """Write a value and its sigma with the digits that mean something: two of sigma."""
    if not np.isfinite(value):
        return 'unknown', 'unknown'
    if not np.isfinite(sigma):
        return f'{value:.6g}', 'unknown'
    if sigma <= 0:
        return f'{value:.6g}', ''
    decimals = 1 - int(np.floor(np.log10(sigma)))
    decimals -= round(sigma, min(decimals, 12)) >= 10.0 ** (2 - decimals)
    decimals = min(max(decimals, 0), 9)
    # z: what rounds to zero has no sign
    return f'{value:z.{decimals}f}', f'{sigma:.{decimals}f}'
