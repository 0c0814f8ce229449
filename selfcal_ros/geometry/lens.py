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
"""Cameras with any of the lens models that camera files know; our own estimates are plumb-bob."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera

#: Lens models and the numbers of their coefficients, OpenCV's order: k1 k2 p1 p2 k3 for
#: 'plumb_bob', k4 k5 k6 more for 'rational_polynomial', k1 k2 k3 k4 of the angle for
#: 'equidistant' (Kannala and Brandt 2006), the field of view w for 'fov' (Devernay and Faugeras
#: 2001).
LENS_MODELS = {'plumb_bob': 5, 'rational_polynomial': 8, 'equidistant': 4, 'fov': 1}
_POLYNOMIAL_NAMES = ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6')
#: Halvings of an interval of angles down to rounding.
_BISECTIONS = 60


def coefficient_names(model: str) -> tuple[str, ...]:
    """Return the names of a model's coefficients, in their order."""
    names = {'equidistant': ('k1', 'k2', 'k3', 'k4'), 'fov': ('w',)}
    return names.get(model, _POLYNOMIAL_NAMES[:LENS_MODELS[model]])


@dataclass(frozen=True)
class LensCamera:
    """
    A camera with a named lens model.

    Pixel (0, 0) is the centre of the top-left pixel; the optical frame is x right, y down,
    z forward.

    Parameters
    ----------
    K : array_like, shape (3, 3)
        Calibration matrix in pixels.
    model : str
        One of `LENS_MODELS`.
    coefficients : array_like
        As many as the model has; fewer are filled up with zeros, except for 'fov'.
    width, height : int
        Image size in pixels; 0 when unknown.

    Raises
    ------
    ArgumentError
        If a value is impossible or the model is unknown.

    """

    K: np.ndarray
    model: str
    coefficients: np.ndarray
    width: int = 0
    height: int = 0

    def __post_init__(self) -> None:
        """Check and freeze the arrays."""
        if self.model not in LENS_MODELS:
            raise ArgumentError(f'The lens model {self.model!r:.40} is unknown; known are '
                                f'{", ".join(LENS_MODELS)}.')
        given = np.array(self.coefficients, float).ravel()
        least = 1 if self.model == 'fov' else 0
        if not least <= given.size <= LENS_MODELS[self.model] or not np.isfinite(given).all():
            raise ArgumentError(f'The lens model {self.model} has {LENS_MODELS[self.model]} '
                                f'coefficients, all finite; {given.tolist()!r:.80} are not.')
        if self.model == 'fov' and not 0 < given[0] < np.pi:
            raise ArgumentError('The field of view of the lens model fov must lie between 0 and '
                                f'pi, not {given[0]:g}.')
        coefficients = np.zeros(LENS_MODELS[self.model])
        coefficients[:given.size] = given
        coefficients.flags.writeable = False
        # the checks of K are those of any camera
        checked = Camera(self.K, (), self.width, self.height)
        for name, value in (('K', checked.K), ('coefficients', coefficients),
                            ('width', checked.width), ('height', checked.height)):
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, camera: Camera | LensCamera) -> LensCamera:
        """Return the camera as one with a named lens model."""
        if isinstance(camera, LensCamera):
            return camera
        return cls(camera.K, 'plumb_bob', camera.distortion, camera.width, camera.height)

    def coefficients_as(self, model: str) -> np.ndarray | None:
        """
        Return the coefficients of another lens model that is exactly this one.

        Parameters
        ----------
        model : str
            One of `LENS_MODELS`.

        Returns
        -------
        ndarray or None
            None where the other model cannot express this lens.

        """
        if model == self.model:
            return self.coefficients
        polynomial = ('plumb_bob', 'rational_polynomial')
        if self.model in polynomial and model in polynomial:
            size = LENS_MODELS[model]
            if not self.coefficients[size:].any():
                return np.resize(np.append(self.coefficients, np.zeros(size)), size)
        return None

    def camera(self) -> Camera:
        """
        Return the plumb-bob camera that this is.

        Raises
        ------
        ArgumentError
            If the lens model is another one.

        """
        coefficients = self.coefficients_as('plumb_bob')
        if coefficients is None:
            raise ArgumentError(f'The lens model {self.model} is not supported here; plumb_bob '
                                'with up to five coefficients is.')
        return Camera(self.K, coefficients, self.width, self.height)

    def project(self, rays: np.ndarray) -> np.ndarray:
        """Project rays (..., 3) of the optical frame to pixels (..., 2), NaN where impossible."""
        rays = np.asarray(rays, float)
        if self.model in ('equidistant', 'fov'):
            radius = np.hypot(rays[..., 0], rays[..., 1])
            seen = self._seen_radius(radius, rays[..., 2])
            with np.errstate(divide='ignore', invalid='ignore'):
                # on the axis the ratio is a limit, and what it multiplies is zero
                scale = np.where(radius > 0, seen / radius, 0.0)
            xy = rays[..., :2] * scale[..., None]
        else:
            z = np.where(rays[..., 2:] > 0, rays[..., 2:], np.nan)
            xy = self._distort(rays[..., :2] / z)
        pixels: np.ndarray = xy @ self.K[:2, :2].T + self.K[:2, 2]
        return pixels

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return the unit rays, shape (..., 3), seen by pixels, shape (..., 2); NaN if none."""
        pixels, K = np.asarray(pixels, float), self.K
        y = (pixels[..., 1] - K[1, 2]) / K[1, 1]
        xy = np.stack([(pixels[..., 0] - K[0, 2] - K[0, 1] * y) / K[0, 0], y], axis=-1)
        if self.model in ('equidistant', 'fov'):
            radius = np.hypot(*np.moveaxis(xy, -1, 0))
            angle = self._angle(radius)
            with np.errstate(divide='ignore', invalid='ignore'):
                direction = np.where(radius[..., None] > 0, xy / radius[..., None], 0.0)
            return np.concatenate([direction * np.sin(angle)[..., None],
                                   np.cos(angle)[..., None]], axis=-1)
        plumb = self.coefficients_as('plumb_bob')
        xy = self._undistort(xy) if plumb is None else Camera(np.eye(3), plumb).undistort(xy)
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        unit_rays: np.ndarray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return unit_rays

    def _seen_radius(self, radius: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Distance from the principal point, in units of the focal length, of a ray."""
        if self.model == 'fov':
            w = self.coefficients[0]
            seen: np.ndarray = np.arctan2(2 * radius * np.tan(w / 2), z) / w
            return seen
        angle = np.arctan2(radius, z)
        angle = np.where(angle <= self._widest_angle(), angle, np.nan)
        return self._polynomial(angle)

    def _polynomial(self, angle: np.ndarray) -> np.ndarray:
        """Polynomial of the angle of the equidistant model."""
        s = angle * angle
        k1, k2, k3, k4 = self.coefficients
        seen: np.ndarray = angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        return seen

    def _widest_angle(self) -> float:
        """Angle up to which the equidistant model grows, radians."""
        slope = self.coefficients[::-1] * [9, 7, 5, 3]
        roots = np.roots([*slope, 1.0])
        turns = roots.real[(abs(roots.imag) < 1e-12 * abs(roots)) & (roots.real > 0)]
        return min(np.pi, float(np.sqrt(turns.min())) if len(turns) else np.pi)

    def _angle(self, radius: np.ndarray) -> np.ndarray:
        """Angle of a ray to the axis from the distance in the image, NaN beyond the model."""
        if self.model == 'fov':
            w = self.coefficients[0]
            stretched = radius * w
            angle = np.arctan2(np.sin(stretched), 2 * np.tan(w / 2) * np.cos(stretched))
            return np.where(stretched < np.pi, angle, np.nan)
        low, high = np.zeros_like(radius), np.full_like(radius, self._widest_angle())
        beyond = radius > self._polynomial(high)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            far = self._polynomial(middle) > radius
            low, high = np.where(far, low, middle), np.where(far, middle, high)
        return np.where(beyond, np.nan, (low + high) / 2)

    def _distort(self, xy: np.ndarray) -> np.ndarray:
        """Distort normalised points (..., 2) by the polynomial models."""
        coefficients = self.coefficients_as('rational_polynomial')
        if coefficients is None:
            raise ArgumentError(f'{self.model} is no polynomial model.')
        k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
        s = np.sum(xy * xy, axis=-1, keepdims=True)
        radial = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
        cross = 2 * xy[..., :1] * xy[..., 1:]
        distorted: np.ndarray = xy * radial + np.concatenate(
            [p1 * cross + p2 * (s + 2 * xy[..., :1]**2),
             p1 * (s + 2 * xy[..., 1:]**2) + p2 * cross], axis=-1)
        return distorted

    def _undistort(self, target: np.ndarray) -> np.ndarray:
        """Undo `_distort` by Newton's method with numerical derivatives."""
        xy, step = target.copy(), 1e-6
        for last in (False,) * 20 + (True,):
            a, c = np.moveaxis(self._distort(xy + [step, 0]) - self._distort(xy - [step, 0]),
                               -1, 0) / (2 * step)
            b, d = np.moveaxis(self._distort(xy + [0, step]) - self._distort(xy - [0, step]),
                               -1, 0) / (2 * step)
            e, f = np.moveaxis(self._distort(xy) - target, -1, 0)
            determinant = a * d - b * c
            if not last:
                with np.errstate(all='ignore'):
                    xy = xy - np.stack([d * e - b * f, a * f - c * e],
                                       axis=-1) / determinant[..., None]
        # beyond the fold of the polynomials lies another root, on the wrong branch
        good = (np.hypot(e, f) < 1e-9) & (determinant > 0) & (a + d > 0)
        return np.where(good[..., None], xy, np.nan)
