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
Lenses that look at a unit sphere from off its centre: read and converted, not estimated.

With d = |(x, y, z)| and ρ² = x² + y²:

* unified (Mei and Rives 2007, section II): m = (x, y) / (z + ξ d), then the plumb-bob's
  distortion; Kalibr's omni
* extended unified (Khomutenko et al. 2016): m = (x, y) / (α √(β ρ² + z²) + (1 - α) z); Kalibr's
  and COLMAP's EUCM
* double sphere (Usenko et al. 2018): k = ξ d + z, m = (x, y) / (α √(ρ² + k²) + (1 - α) k);
  Kalibr's ds

The focal lengths are those of the files: on the axis the scale of the image is fx / (1 + ξ) for
the first and the last, fx for the other. The limits of sight are those of Usenko et al.,
section II.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses.angular import Angular, AngularImage
from selfcal_ros.geometry.lenses.plumb_bob import PLUMB_BOB

#: An image at infinity is left out: the share of the widest angle that is seen.
_SHORT = 1 - 1e-6


def _over(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Divide; infinite where a ray beyond the widest angle has no image."""
    with np.errstate(divide='ignore', invalid='ignore'):
        share: np.ndarray = above / below
    return share


def _root(square: np.ndarray) -> np.ndarray:
    """Return the square root, NaN where an image point has no ray."""
    with np.errstate(invalid='ignore'):
        root: np.ndarray = np.sqrt(square)
    return root


class _Sphere(Angular):
    """The unified lens without the distortion that follows it."""

    name = 'ucm'
    coefficients = ('xi',)

    def radius(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the image radius over the focal length."""
        return _over(np.sin(angle), np.cos(angle) + values[0])

    def slope(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by the angle."""
        c, xi = np.cos(angle), values[0]
        return _over(1 + xi * c, (c + xi)**2)

    def radius_by(self, name: str, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by ξ."""
        return _over(-np.sin(angle), (np.cos(angle) + values[0])**2)

    def angle(self, values: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Return the angle that an image radius belongs to, NaN beyond the widest."""
        xi, square = values[0], radius * radius
        scale = (xi + _root(1 + (1 - xi * xi) * square)) / (1 + square)
        angle: np.ndarray = np.arctan2(scale * radius, scale - xi)
        return angle

    def widest_angle(self, values: np.ndarray) -> float:
        """Return the angle whose image is at infinity, or where the image turns back."""
        xi = values[0]
        return float(np.arccos(-xi if xi <= 1 else -1 / xi)) * _SHORT

    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of ξ moves the corner, over its distance."""
        return 1.0


_SPHERE = _Sphere()


class UnifiedImage:
    """Image of rays under the unified lens with its distortion; see `LensImage`."""

    def __init__(self, rays: np.ndarray, values: np.ndarray):
        self._plain = AngularImage(_SPHERE, rays, values[:1])
        self._distortion = Unified.distortion(values)
        self._x, self._y = np.moveaxis(self._plain.xy, -1, 0)
        self.xy = np.stack(PLUMB_BOB.distorted(self._distortion, self._x, self._y), axis=-1)

    def _by_plain(self) -> np.ndarray:
        """Differentiate by the image before the distortion, shape (..., 2, 2)."""
        xx, cross, yy = PLUMB_BOB.by_point(self._distortion, self._x, self._y)
        return np.stack([np.stack([xx, cross], -1), np.stack([cross, yy], -1)], -2)

    def by_ray(self) -> np.ndarray:
        """Differentiate by the rays, shape (..., 2, 3)."""
        J: np.ndarray = self._by_plain() @ self._plain.by_ray()
        return J

    def by_coefficient(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Differentiate by one coefficient."""
        if name != 'xi':
            return PLUMB_BOB.by_coefficient(name, self._distortion, self._x, self._y)
        change = np.stack(self._plain.by_coefficient(name), axis=-1)
        dx, dy = np.moveaxis((self._by_plain() @ change[..., None])[..., 0], -1, 0)
        return dx, dy


class Unified:
    """The unified lens: a sphere seen from ξ above its centre, then radial and tangential."""

    name = 'ucm'
    coefficients = ('xi', 'k1', 'k2', 'p1', 'p2')
    is_perspective = False

    @staticmethod
    def distortion(values: np.ndarray) -> np.ndarray:
        """Return the coefficients of the plumb-bob that follows."""
        return np.append(values[1:], 0.0)

    def check(self, values: np.ndarray) -> None:
        """Refuse a point of view within the mirror."""
        if values[0] < 0:
            raise ArgumentError(f'The xi of the lens model ucm must not be negative, as '
                                f'{values[0]:g} is.')

    def is_smooth(self, values: np.ndarray) -> bool:
        """Tell whether no ring tears the image: without a quotient none does."""
        return True

    def image(self, rays: np.ndarray, values: np.ndarray) -> UnifiedImage:
        """Project rays (..., 3)."""
        return UnifiedImage(np.asarray(rays, float), values)

    def rays(self, xy: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the unit rays (..., 3) of normalised image points (..., 2), NaN beyond."""
        return _SPHERE.rays(PLUMB_BOB.undistorted(self.distortion(values), xy), values[:1])

    def widest_angle(self, values: np.ndarray) -> float:
        """Return the angle from the axis where the image ends, or its distortion folds."""
        widest = _SPHERE.widest_angle(values[:1])
        folded = np.tan(PLUMB_BOB.widest_angle(self.distortion(values)))
        if not 0 < folded < _SPHERE.radius(values[:1], np.array(widest)):
            return widest
        return float(_SPHERE.angle(values[:1], np.array(folded)))

    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of a coefficient moves the corner, over its distance."""
        return 1.0 if name == 'xi' else PLUMB_BOB.corner_displacement(name, corner)


def _widest(alpha: float, stretch: float, shift: float) -> float:
    """Return where α √(stretch ρ² + k²) + (1 - α) k is zero, or its image turns, k = shift + z."""
    root = np.sqrt(abs(2 * alpha - 1) / stretch)
    beyond = np.arctan2(1 - alpha if alpha > 0.5 else alpha, root)
    # cos θ + tan(beyond) sin θ = -shift
    return float(beyond + np.arccos(-shift * np.cos(beyond))) * _SHORT


class ExtendedUnified(Angular):
    """The unified lens with an ellipsoid in the place of the sphere."""

    name = 'eucm'
    coefficients = ('alpha', 'beta')

    def check(self, values: np.ndarray) -> None:
        """Refuse what is no ellipsoid."""
        if not (0 <= values[0] <= 1 and values[1] > 0):
            raise ArgumentError('The lens model eucm has an alpha between 0 and 1 and a positive '
                                f'beta, not {values[0]:g} and {values[1]:g}.')

    @staticmethod
    def _parts(values: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return sine and cosine, the distance on the ellipsoid, and the denominator."""
        s, c = np.sin(angle), np.cos(angle)
        d = np.sqrt(values[1] * s * s + c * c)
        return s, c, d, values[0] * d + (1 - values[0]) * c

    def radius(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the image radius over the focal length."""
        s, _, _, below = self._parts(values, angle)
        return _over(s, below)

    def slope(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by the angle."""
        _, c, d, below = self._parts(values, angle)
        return _over(values[0] * c / d + 1 - values[0], below**2)

    def radius_by(self, name: str, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by one coefficient."""
        s, c, d, below = self._parts(values, angle)
        by_below = d - c if name == 'alpha' else values[0] * s * s / (2 * d)
        return _over(-s * by_below, below**2)

    def angle(self, values: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Return the angle that an image radius belongs to, NaN beyond the widest."""
        (alpha, beta), square = values, radius * radius
        z = (1 - beta * alpha * alpha * square) / (
            alpha * _root(1 - (2 * alpha - 1) * beta * square) + 1 - alpha)
        angle: np.ndarray = np.arctan2(radius, z)
        return angle

    def widest_angle(self, values: np.ndarray) -> float:
        """Return the angle whose image is at infinity, or where the image turns back."""
        return _widest(values[0], values[1], 0.0)

    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of a coefficient moves the corner, over its distance, nearly."""
        return corner**2 / 2


class DoubleSphere(Angular):
    """Two unit spheres, ξ apart, seen from α / (1 - α) above the centre of the second."""

    name = 'double_sphere'
    coefficients = ('xi', 'alpha')

    def check(self, values: np.ndarray) -> None:
        """Refuse spheres that do not overlap."""
        if not (-1 < values[0] <= 1 and 0 <= values[1] <= 1):
            raise ArgumentError('The lens model double_sphere has a xi between -1 and 1 and an '
                                f'alpha between 0 and 1, not {values[0]:g} and {values[1]:g}.')

    @staticmethod
    def _parts(values: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return sine, cosine, depth and distance on the second sphere, and the denominator."""
        s, c = np.sin(angle), np.cos(angle)
        k = values[0] + c
        d = np.sqrt(s * s + k * k)
        return s, c, k, d, values[1] * d + (1 - values[1]) * k

    def radius(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the image radius over the focal length."""
        s, _, _, _, below = self._parts(values, angle)
        return _over(s, below)

    def slope(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by the angle."""
        xi, alpha = values
        _, c, k, d, below = self._parts(values, angle)
        return _over((1 + xi * c) * (alpha * k / d + 1 - alpha), below**2)

    def radius_by(self, name: str, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by one coefficient."""
        s, _, k, d, below = self._parts(values, angle)
        by_below = d - k if name == 'alpha' else values[1] * k / d + 1 - values[1]
        return _over(-s * by_below, below**2)

    def angle(self, values: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Return the angle that an image radius belongs to, NaN beyond the widest."""
        (xi, alpha), square = values, radius * radius
        k = (1 - alpha * alpha * square) / (
            alpha * _root(1 - (2 * alpha - 1) * square) + 1 - alpha)
        scale = (k * xi + np.sqrt(k * k + (1 - xi * xi) * square)) / (k * k + square)
        angle: np.ndarray = np.arctan2(scale * radius, scale * k - xi)
        return angle

    def widest_angle(self, values: np.ndarray) -> float:
        """Return the angle whose image is at infinity, or where the image turns back."""
        return min(_widest(values[1], 1.0, values[0]), np.pi)

    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of a coefficient moves the corner, over its distance, nearly."""
        return 1.0 if name == 'xi' else corner**2 / 2


#: The models; they have no state.
UCM, EUCM, DOUBLE_SPHERE = Unified(), ExtendedUnified(), DoubleSphere()
