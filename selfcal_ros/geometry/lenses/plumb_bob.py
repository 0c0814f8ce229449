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
Plumb-bob distortion (Brown 1966): radial k1, k2, k3 and tangential p1, p2, in OpenCV's convention.

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.lenses.perspective import Perspective

#: Power of the distance from the middle that each coefficient multiplies, over that distance.
CORNER_POWER = {'k1': 2, 'k2': 4, 'p1': 1, 'p2': 1, 'k3': 6}


def tangential(p1: float, p2: float, x: np.ndarray, y: np.ndarray, r2: np.ndarray,
               ) -> tuple[np.ndarray, np.ndarray]:
    """
    Displace normalised points as decentred elements do.

    Parameters
    ----------
    p1, p2 : float
    x, y, r2 : ndarray, shape (...)
        Points, and their squared distance from the middle.

    Returns
    -------
    dx, dy : ndarray, shape (...)

    """
    cross = 2 * x * y
    return p1 * cross + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + p2 * cross


class PlumbBob(Perspective):
    """Brown's model with three radial and two tangential coefficients."""

    name = 'plumb_bob'
    coefficients = ('k1', 'k2', 'p1', 'p2', 'k3')

    def distorted(self, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray]:
        """Distort normalised points."""
        k1, k2, p1, p2, k3 = values
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3 if k3 else k2))
        if not (p1 or p2):
            return x * radial, y * radial
        dx, dy = tangential(p1, p2, x, y, r2)
        return x * radial + dx, y * radial + dy

    def by_point(self, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Differentiate by the point; the derivative is symmetric."""
        k1, k2, p1, p2, k3 = values
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3 if k3 else k2))
        slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2)) if k3 else 2 * (k1 + 2 * k2 * r2)
        return (radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
                slope * x * y + 2 * p1 * x + 2 * p2 * y,
                radial + slope * y * y + 6 * p1 * y + 2 * p2 * x)

    def by_coefficient(self, name: str, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                       ) -> tuple[np.ndarray, np.ndarray]:
        """Differentiate by one coefficient; the model is linear in all of them."""
        r2 = x * x + y * y
        if name == 'p1':
            return 2 * x * y, r2 + 2 * y * y
        if name == 'p2':
            return r2 + 2 * x * x, 2 * x * y
        power = r2**(CORNER_POWER[name] // 2)
        return x * power, y * power

    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of a coefficient moves the corner, over its distance."""
        return float(corner**CORNER_POWER[name])


#: The model; it has no state.
PLUMB_BOB = PlumbBob()
