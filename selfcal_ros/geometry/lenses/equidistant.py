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
The equidistant lens with a polynomial of the angle (Kannala and Brandt 2006).

    r / f = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)

ROS calls it `equidistant`, OpenCV `cv2.fisheye`, COLMAP OPENCV_FISHEYE, Kalibr equidistant.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from selfcal_ros.geometry.lenses.angular import Angular


class Equidistant(Angular):
    """Kannala and Brandt's fisheye with four coefficients."""

    name = 'equidistant'
    coefficients = ('k1', 'k2', 'k3', 'k4')

    def radius(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the image radius over the focal length; NaN beyond the widest angle."""
        k1, k2, k3, k4 = values
        s = angle * angle
        radius: np.ndarray = angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        return radius

    def slope(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by the angle."""
        k1, k2, k3, k4 = values
        s = angle * angle
        slope: np.ndarray = 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))
        return slope

    def radius_by(self, name: str, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by one coefficient."""
        power: np.ndarray = angle**(2 * int(name[1]) + 1)
        return power

    def widest_angle(self, values: np.ndarray) -> float:
        """Return the angle up to which the radius grows, radians."""
        return _widest_angle(*map(float, values))

    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of a coefficient moves the corner, over its distance."""
        return float(corner**(2 * int(name[1])))


# asked for with every ray, by the same lens
@lru_cache(256)
def _widest_angle(k1: float, k2: float, k3: float, k4: float) -> float:
    """Angle at which the radius stops to grow, radians, no more than pi."""
    roots = np.roots([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0])
    turns = roots.real[(abs(roots.imag) < 1e-12 * abs(roots)) & (roots.real > 0)]
    return min(np.pi, float(np.sqrt(turns.min())) if len(turns) else np.pi)


#: The model; it has no state.
EQUIDISTANT = Equidistant()
