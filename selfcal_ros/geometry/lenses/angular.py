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
"""Lens models that map the angle of a ray from the axis to a radius in the image."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from selfcal_ros.errors import ArgumentError

#: Newton steps of the inversion, guarded by an interval, at most.
ITERATIONS = 30
#: Nearer to the axis than this the image is that of a pinhole, to rounding.
_ON_AXIS = 1e-12


class AngularImage:
    """Image of rays under a map of angles; see `LensImage`."""

    def __init__(self, lens: Angular, rays: np.ndarray, values: np.ndarray):
        self._lens, self._values, self._rays = lens, values, rays
        self._across = np.hypot(rays[..., 0], rays[..., 1])
        self._angle = np.arctan2(self._across, rays[..., 2])
        with np.errstate(divide='ignore', invalid='ignore'):
            along = rays[..., :2] / self._across[..., None]
        # on the axis any direction will do: what it multiplies is zero
        self._along = np.where((self._across > _ON_AXIS)[..., None], along, [1.0, 0.0])
        self._radius = lens.radius(values, self._angle)
        self.xy = self._along * self._radius[..., None]

    def by_ray(self) -> np.ndarray:
        """
        Differentiate by the rays, shape (..., 2, 3).

        With direction e in the image and angle θ: ∂θ = (z e, -ρ) / |X|², and e turns by 1 / ρ.
        """
        z, across, e = self._rays[..., 2], self._across, self._along
        square = across * across + z * z
        slope = self._lens.slope(self._values, self._angle)
        with np.errstate(divide='ignore', invalid='ignore'):
            turning = np.where(across > _ON_AXIS, self._radius / across, slope / z)
        J = np.empty((*z.shape, 2, 3))
        by_angle = slope * z / square
        J[..., 0, 0] = by_angle * e[..., 0]**2 + turning * e[..., 1]**2
        J[..., 0, 1] = (by_angle - turning) * e[..., 0] * e[..., 1]
        J[..., 1, 0] = J[..., 0, 1]
        J[..., 1, 1] = by_angle * e[..., 1]**2 + turning * e[..., 0]**2
        J[..., :, 2] = -(slope * across / square)[..., None] * e
        return J

    def by_coefficient(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Differentiate by one coefficient."""
        change = self._lens.radius_by(name, self._values, self._angle)
        return change * self._along[..., 0], change * self._along[..., 1]


class Angular(ABC):
    """A lens whose image radius is a function of the angle from the axis."""

    name: str
    coefficients: tuple[str, ...]
    is_perspective = False

    @abstractmethod
    def radius(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the image radius over the focal length; grows up to `widest_angle`."""

    @abstractmethod
    def slope(self, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by the angle."""

    @abstractmethod
    def radius_by(self, name: str, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Differentiate `radius` by one coefficient."""

    @abstractmethod
    def widest_angle(self, values: np.ndarray) -> float:
        """Return the angle up to which the radius grows, radians, no more than pi."""

    @abstractmethod
    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of a coefficient moves the corner, over its distance."""

    def check(self, values: np.ndarray) -> None:
        """Refuse a lens that folds before it has seen anything."""
        if not self.widest_angle(values) > 0.05:
            raise ArgumentError(f'A lens {self.name} with the coefficients '
                                f'{values.tolist()!r:.80} sees nothing but its axis.')

    def is_smooth(self, values: np.ndarray) -> bool:
        """Tell whether no ring tears the image: without a quotient none does."""
        return True

    def image(self, rays: np.ndarray, values: np.ndarray) -> AngularImage:
        """Project rays (..., 3)."""
        return AngularImage(self, np.asarray(rays, float), values)

    def rays(self, xy: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the unit rays (..., 3) of normalised image points (..., 2), NaN beyond."""
        xy = np.asarray(xy, float)
        radius = np.hypot(xy[..., 0], xy[..., 1])
        angle = self.angle(values, radius)
        with np.errstate(divide='ignore', invalid='ignore'):
            sine = np.where(radius > 0, np.sin(angle) / radius, 0.0)
        # a pixel without a ray has none on the axis either
        sine = np.where(np.isfinite(angle), sine, np.nan)
        return np.concatenate([xy * sine[..., None], np.cos(angle)[..., None]], axis=-1)

    def angle(self, values: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Return the angle that an image radius belongs to, NaN beyond the widest."""
        widest = self.widest_angle(values)
        low, high = np.zeros_like(radius), np.full_like(radius, widest)
        angle = np.clip(radius, 0.0, widest)
        for _ in range(ITERATIONS):
            over = self.radius(values, angle) - radius
            low, high = np.where(over < 0, angle, low), np.where(over > 0, angle, high)
            with np.errstate(all='ignore'):
                step = angle - over / self.slope(values, angle)
            # where Newton's step leaves the interval, halve it
            moved = np.where((step >= low) & (step <= high), step, (low + high) / 2)
            change = np.abs(moved - angle)
            angle = moved
            if not np.nanmax(change, initial=0.0) > 1e-14:
                break
        beyond = ~(radius <= self.radius(values, np.array(widest)) * (1 + 1e-12))
        return np.where(beyond, np.nan, angle)
