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
Rational distortion (Claus and Fitzgibbon 2005), in OpenCV's and ROS's convention.

    x' = x R + tangential terms,    R = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.lenses.perspective import Perspective
from selfcal_ros.geometry.lenses.plumb_bob import tangential

#: Power of r² that each coefficient multiplies, above and below the line.
_ABOVE, _BELOW = {'k1': 1, 'k2': 2, 'k3': 3}, {'k4': 1, 'k5': 2, 'k6': 3}
#: Where the upper polynomial is less than this at a zero of the lower one, they share that zero:
#: the lens is smooth but for a ring, in which it tears the image.
_SHARED = 0.05
#: The widest r² that is looked at: 85 degrees from the axis.
_WIDEST = 130.0


class RationalPolynomial(Perspective):
    """Brown's model over a second polynomial: wider lenses than the plumb-bob."""

    name = 'rational_polynomial'
    coefficients = ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6')

    @staticmethod
    def _polynomials(values: np.ndarray, r2: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return both polynomials of r², and their derivatives by it."""
        k1, k2, _, _, k3, k4, k5, k6 = values
        return (1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6)),
                k1 + r2 * (2 * k2 + 3 * k3 * r2), k4 + r2 * (2 * k5 + 3 * k6 * r2))

    def is_smooth(self, values: np.ndarray) -> bool:
        """Tell whether no ring tears the image, where a pole and a zero all but cancel."""
        poles = np.roots([*values[:4:-1], 1.0])
        poles = poles.real[(np.abs(poles.imag) < 1e-9) & (0 < poles.real)
                           & (poles.real < _WIDEST)]
        return not (np.abs(self._polynomials(values, poles)[0]) < _SHARED).any()

    def distorted(self, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray]:
        """Distort normalised points."""
        r2 = x * x + y * y
        above, below, _, _ = self._polynomials(values, r2)
        dx, dy = tangential(values[2], values[3], x, y, r2)
        return x * above / below + dx, y * above / below + dy

    def by_point(self, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Differentiate by the point; the derivative is symmetric."""
        p1, p2 = values[2:4]
        above, below, above_slope, below_slope = self._polynomials(values, x * x + y * y)
        radial = above / below
        slope = 2 * (above_slope - radial * below_slope) / below
        return (radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
                slope * x * y + 2 * p1 * x + 2 * p2 * y,
                radial + slope * y * y + 6 * p1 * y + 2 * p2 * x)

    def by_coefficient(self, name: str, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                       ) -> tuple[np.ndarray, np.ndarray]:
        """Differentiate by one coefficient."""
        r2 = x * x + y * y
        if name in ('p1', 'p2'):
            return tangential(float(name == 'p1'), float(name == 'p2'), x, y, r2)
        above, below, _, _ = self._polynomials(values, r2)
        change = (r2**_ABOVE[name] / below if name in _ABOVE
                  else -above * r2**_BELOW[name] / below**2)
        return x * change, y * change

    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of a coefficient moves the corner, over its distance."""
        if name in ('p1', 'p2'):
            return float(corner)
        return float(corner**(2 * {**_ABOVE, **_BELOW}[name]))


#: The model; it has no state.
RATIONAL_POLYNOMIAL = RationalPolynomial()
