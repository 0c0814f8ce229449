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
How improbable a sum of squares is, and which one has a given chance.

`scipy.stats` says the same, and alone takes longer to load than all the rest of SciPy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, chdtri, fdtrc, fdtri, ndtri


def chi2_sf(square: ArrayLike, freedom: ArrayLike) -> Any:
    """Return the chance that a sum of squares of so many unit Gaussians is larger."""
    # rounding leaves squares below zero
    return chdtrc(freedom, np.maximum(square, 0))


def chi2_isf(chance: ArrayLike, freedom: ArrayLike) -> Any:
    """Return what a sum of squares of so many unit Gaussians exceeds with this chance."""
    return chdtri(freedom, chance)


def f_sf(ratio: ArrayLike, above: ArrayLike, below: ArrayLike) -> Any:
    """Return the chance that a ratio of mean squares, with these freedoms, is larger."""
    return fdtrc(above, below, ratio)


def f_isf(chance: float, above: ArrayLike, below: ArrayLike) -> Any:
    """Return what a ratio of mean squares, with these freedoms, exceeds with this chance."""
    return fdtri(above, below, 1 - chance)


def normal_isf(chance: ArrayLike) -> Any:
    """Return what a unit Gaussian exceeds with this chance."""
    return -ndtri(chance)
