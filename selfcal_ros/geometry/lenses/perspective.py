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
"""Lens models that distort a perspective image: pinhole, radial, Brown's, rational."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from selfcal_ros.geometry.lenses.model import unit

#: Newton steps of the inversion at most; four do for ordinary lenses, far outside more.
ITERATIONS = 40
#: Depths below this count as this: the image is at infinity.
_LEAST_DEPTH = 1e-12
#: Angles at which it is looked where a distortion folds.
_ANGLES = 400
#: Decentring moves the fold of the radial part, over its distance by less than this.
_FOLD_SLACK = 1.1


class PerspectiveImage:
    """Image of rays under a distorted perspective; see `LensImage`."""

    def __init__(self, lens: Perspective, rays: np.ndarray, values: np.ndarray):
        self._lens, self._values = lens, values
        z = rays[..., 2]
        self._depth = np.where(np.abs(z) > _LEAST_DEPTH, z, _LEAST_DEPTH)
        self.x, self.y = rays[..., 0] / self._depth, rays[..., 1] / self._depth
        self.xy = np.empty((*z.shape, 2))
        self.xy[..., 0], self.xy[..., 1] = lens.distorted(values, self.x, self.y)

    def by_ray(self) -> np.ndarray:
        """Differentiate by the rays, shape (..., 2, 3)."""
        x, y, depth = self.x, self.y, self._depth
        xx, cross, yy = self._lens.by_point(self._values, x, y)
        # each number of all rays in a row in memory
        J: np.ndarray = np.moveaxis(np.empty((2, 3, *x.shape)), (0, 1), (-2, -1))
        J[..., 0, 0], J[..., 0, 1] = xx / depth, cross / depth
        J[..., 1, 0], J[..., 1, 1] = J[..., 0, 1], yy / depth
        J[..., 0, 2] = -(xx * x + cross * y) / depth
        J[..., 1, 2] = -(cross * x + yy * y) / depth
        return J

    def by_coefficient(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Differentiate by one coefficient."""
        return self._lens.by_coefficient(name, self._values, self.x, self.y)


class Perspective(ABC):
    """A lens that sees rays ahead of it alone, by a map of the perspective image."""

    name: str
    coefficients: tuple[str, ...]
    is_perspective = True

    @abstractmethod
    def distorted(self, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                  ) -> tuple[np.ndarray, np.ndarray]:
        """Distort normalised points."""

    @abstractmethod
    def by_point(self, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Differentiate by the point: ∂x'/∂x, ∂x'/∂y = ∂y'/∂x, ∂y'/∂y."""

    @abstractmethod
    def by_coefficient(self, name: str, values: np.ndarray, x: np.ndarray, y: np.ndarray,
                       ) -> tuple[np.ndarray, np.ndarray]:
        """Differentiate x' and y' by one coefficient."""

    @abstractmethod
    def corner_displacement(self, name: str, corner: float) -> float:
        """Return how far a unit of a coefficient moves the corner, over its distance."""

    def check(self, values: np.ndarray) -> None:
        """Any coefficients are possible; where they fold, points have no ray."""

    def is_smooth(self, values: np.ndarray) -> bool:
        """Tell whether no ring tears the image: without a quotient none does."""
        return True

    def image(self, rays: np.ndarray, values: np.ndarray) -> PerspectiveImage:
        """Project rays (..., 3); a ray and its opposite have the same image."""
        return PerspectiveImage(self, np.asarray(rays, float), values)

    def rays(self, xy: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the unit rays (..., 3) of normalised image points, NaN beyond the fold."""
        flat = self.undistorted(values, xy)
        return unit(np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1))

    def undistorted(self, values: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """
        Remove the distortion from normalised points (..., 2) by Newton's method.

        Points outside the region where the distortion can be inverted come back as NaN.
        """
        target = np.asarray(xy, float)
        if not values.any():
            return target.copy()
        x, y = np.moveaxis(target, -1, 0).copy()
        for _ in range(ITERATIONS):
            seen_x, seen_y = self.distorted(values, x, y)
            dx, dy = seen_x - target[..., 0], seen_y - target[..., 1]
            a, b, d = self.by_point(values, x, y)
            with np.errstate(all='ignore'):
                determinant = a * d - b * b
                step_x = (d * dx - b * dy) / determinant
                step_y = (a * dy - b * dx) / determinant
            x, y = x - step_x, y - step_y
            largest = np.nanmax(np.maximum(np.abs(step_x), np.abs(step_y)), initial=0.0)
            if not largest > 1e-13:
                break
        with np.errstate(all='ignore'):
            seen_x, seen_y = self.distorted(values, x, y)
            miss = np.maximum(np.abs(seen_x - target[..., 0]), np.abs(seen_y - target[..., 1]))
            a, b, d = self.by_point(values, x, y)
            # beyond the fold the polynomial has another root, on the wrong branch
            good = (miss < 1e-9) & (a * d - b * b > 0) & (a + d > 0)
            # that branch may rise again further out
            good &= np.hypot(x, y) <= _FOLD_SLACK * np.tan(self.widest_angle(values))
        return np.where(good[..., None], np.stack([x, y], axis=-1), np.nan)

    def widest_angle(self, values: np.ndarray) -> float:
        """Return the angle from the axis up to which the radius in the image grows, radians."""
        angle = np.linspace(0.0, np.pi / 2, _ANGLES, endpoint=False)
        r, zero = np.tan(angle), np.zeros(_ANGLES)
        # the radial part; decentring bends the fold, it does not move it much
        slope = self.by_point(np.where([name in ('p1', 'p2') for name in self.coefficients],
                                       0.0, values), r, zero)[0]
        folded = ~(slope > 0)
        return float(angle[np.argmax(folded)]) if folded.any() else np.pi / 2
