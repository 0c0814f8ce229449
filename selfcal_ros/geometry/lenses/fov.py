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
The field-of-view lens (Devernay and Faugeras 2001): one coefficient, the angle w.

    r / f = atan(2 tan θ tan(w / 2)) / w
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses.angular import Angular


class FieldOfView(Angular):
    """The one-parameter model of Devernay and Faugeras; read and converted, not estimated."""

    name = 'fov'
    coefficients = ('w',)

    def check(self, values: np.ndarray) -> None:
        """Refuse angles that no lens has."""
        if not 0 < values[0] < np.pi:
            raise ArgumentError('The field of view of the lens model fov must lie between 0 and '
                                f'pi, not {values[0]:g}.')

    def radius(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the image radius over the focal length."""
        w = values[0]
        seen: np.ndarray = np.arctan2(2 * np.sin(angle) * np.tan(w / 2), np.cos(angle)) / w
        return seen

    def slope(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by the angle."""
        w = values[0]
        t = 2 * np.tan(w / 2)
        slope: np.ndarray = t / (np.cos(angle)**2 + (t * np.sin(angle))**2) / w
        return slope

    def radius_by(self, name: str, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by w."""
        w = values[0]
        t, sine, cosine = 2 * np.tan(w / 2), np.sin(angle), np.cos(angle)
        by_t = sine * cosine / (cosine**2 + (t * sine)**2)
        change: np.ndarray = (by_t / np.cos(w / 2)**2 - self.radius(values, angle)) / w
        return change

    def widest_angle(self, values: np.ndarray) -> float:
        """Every angle has an image."""
        return np.pi

    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of w moves the corner, over its distance, near w = 0."""
        return corner**2


#: The model; it has no state.
FOV = FieldOfView()
