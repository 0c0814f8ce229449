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
The shift block: images that are moved by themselves, each by its own (Δu, Δv).

    u = lens(X) + Δ_i

A stabiliser does that: the lens or the sensor is moved against the shake of a hand, or the image
is cropped elsewhere each time. So the principal point differs from image to image; that of the
lens block is the mean, and its sigma holds what one image is off by.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.view_effects import ViewEffects

#: Unknowns of each view, pixels.
SHIFT_NAMES = ('shift_u', 'shift_v')


def shifts(sigma_px: float) -> ViewEffects:
    """Return what is supposed of shifts of this standard deviation."""
    return ViewEffects(SHIFT_NAMES, sigma_px)


def by_shift(count: int) -> np.ndarray:
    """Differentiate so many observations by the shift of their view, shape (N, 2, 2)."""
    return np.broadcast_to(np.eye(2), (count, 2, 2))
