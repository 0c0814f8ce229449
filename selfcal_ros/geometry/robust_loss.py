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
"""Losses that gross errors do not rule, and the weights that they give (M-estimators)."""

from __future__ import annotations

import numpy as np


def huber_weights(distance: np.ndarray, threshold: float) -> np.ndarray:
    """Weights ψ(d) / d of Huber's loss for distances in units of sigma."""
    weights: np.ndarray = np.minimum(1.0, threshold / np.maximum(distance, 1e-300))
    return weights


def huber_loss(distance: np.ndarray, threshold: float) -> np.ndarray:
    """Huber's loss, d² / 2 near zero, of distances in units of sigma."""
    return np.where(distance <= threshold, 0.5 * distance**2,
                    threshold * (distance - 0.5 * threshold))


def tukey_weight(residual: np.ndarray, limit: float | np.ndarray) -> np.ndarray:
    """Tukey's biweight, 1 at zero and 0 from the limit on."""
    ratio = np.minimum(np.abs(residual) / limit, 1.0)
    weight: np.ndarray = (1 - ratio * ratio)**2
    return weight
