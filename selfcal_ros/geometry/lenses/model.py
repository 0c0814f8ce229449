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
"""What every lens model offers, whichever way it bends rays."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class LensImage(Protocol):
    """
    The image of some rays, and its derivatives.

    Attributes
    ----------
    xy : ndarray, shape (..., 2)
        Normalised image points, before the calibration matrix.

    """

    xy: np.ndarray

    def by_ray(self) -> np.ndarray:
        """Differentiate by the rays, whose length does not matter; shape (..., 2, 3)."""
        ...

    def by_coefficient(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Differentiate x and y by one coefficient, shapes (...,)."""
        ...


class LensModel(Protocol):
    """
    A family of lenses.

    Attributes
    ----------
    name : str
        As files and messages call it.
    coefficients : tuple of str
        In the order of files.
    is_perspective : bool
        A ray and its opposite have one image, and no ray at 90° has any: depth has no sign.

    """

    @property
    def name(self) -> str: ...
    @property
    def coefficients(self) -> tuple[str, ...]: ...
    @property
    def is_perspective(self) -> bool: ...

    def image(self, rays: np.ndarray, values: np.ndarray) -> LensImage:
        """
        Project rays.

        Parameters
        ----------
        rays : ndarray, shape (..., 3)
            Of any length but zero, optical frame.
        values : ndarray, shape (k,)
            Of `coefficients`.

        """
        ...

    def rays(self, xy: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the unit rays (..., 3) that normalised image points (..., 2) see, or NaN."""
        ...

    def widest_angle(self, values: np.ndarray) -> float:
        """Return the angle from the axis, radians, up to which image points have one ray."""
        ...

    def check(self, values: np.ndarray) -> None:
        """Raise ArgumentError where no lens has such coefficients."""
        ...

    def is_smooth(self, values: np.ndarray) -> bool:
        """Tell whether no ring tears the image; an estimate never takes a lens that has one."""
        ...

    def corner_displacement(self, name: str, corner: float) -> float:
        """
        Return how far a unit of a coefficient moves the image's corner, over its distance.

        Parameters
        ----------
        name : str
        corner : float
            Distance of the corner from the principal point over the focal length.

        """
        ...


def unit(rays: np.ndarray) -> np.ndarray:
    """Return rays (..., 3) with length one."""
    scaled: np.ndarray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return scaled


def fitted_coefficients(model: LensModel, names: tuple[str, ...], rays: np.ndarray,
                        xy: np.ndarray, steps: int = 3) -> np.ndarray:
    """
    Fit coefficients of a model to pairs of rays and image points, least squares in the image.

    Parameters
    ----------
    model : LensModel
    names : tuple of str
        Coefficients that may differ from zero.
    rays : ndarray, shape (N, 3)
    xy : ndarray, shape (N, 2)
        Normalised image points.
    steps : int
        Gauss-Newton steps; polynomials need one.

    Returns
    -------
    ndarray, shape (k,)
        Of `model.coefficients`.

    """
    values = np.zeros(len(model.coefficients))
    places = [model.coefficients.index(name) for name in names]
    for _ in range(steps if places else 0):
        image = model.image(rays, values)
        J = np.stack([np.stack(image.by_coefficient(name), axis=-1).reshape(-1)
                      for name in names], axis=1)
        residual = (np.asarray(xy, float) - image.xy).reshape(-1)
        good = np.isfinite(residual) & np.isfinite(J).all(axis=1)
        values[places] += np.linalg.lstsq(J[good], residual[good], rcond=None)[0]
    return values
