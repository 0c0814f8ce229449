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
The lens block: focal length, aspect ratio, principal point, skew and distortion, by name.

The estimate works on the focal length f and the aspect ratio ζ = fy / fx, since facts are stated
about ζ; results speak of fx and fy. `to_parameters` and `to_intrinsics` carry covariances across.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.geometry.lenses import plumb_bob

#: Unknowns of the block, in the order of every covariance of the lens.
INTRINSIC_NAMES = ('f', 'aspect', *PARAMETER_NAMES[2:])
#: How many there are.
INTRINSICS = len(INTRINSIC_NAMES)
#: The calibration matrix alone.
MATRIX_NAMES = INTRINSIC_NAMES[:5]
_PLACE = {name: index for index, name in enumerate(INTRINSIC_NAMES)}
_F, _ASPECT, _CX, _CY, _SKEW = range(5)


def intrinsic_places(names: Iterable[str]) -> np.ndarray:
    """Return where `names` stand among `INTRINSIC_NAMES`, shape (k,)."""
    return np.array([_PLACE[name] for name in names], dtype=int)


@dataclass(frozen=True)
class Lens:
    """
    Values of the lens block.

    Attributes
    ----------
    values : ndarray, shape (k,)
        Of `INTRINSIC_NAMES`.

    """

    values: np.ndarray

    def __getitem__(self, name: str) -> float:
        """Return the value of one unknown."""
        return float(self.values[_PLACE[name]])

    @classmethod
    def of(cls, camera: Camera) -> Lens:
        """Take the values of a camera."""
        fx, fy, *rest = camera.parameters
        return cls(np.array([fx, fy / fx, *rest]))

    def take(self, names: Iterable[str]) -> np.ndarray:
        """Return the values of some unknowns, shape (k,)."""
        return np.take(self.values, intrinsic_places(names))

    def camera(self, width: int = 0, height: int = 0) -> Camera:
        """Return the camera."""
        f, aspect, *rest = self.values
        return Camera.from_parameters([f, aspect * f, *rest], width, height)

    def with_values(self, values: dict[str, float]) -> Lens:
        """Return the lens with some values replaced."""
        changed = self.values.copy()
        for name, value in values.items():
            changed[_PLACE[name]] = value
        return Lens(changed)

    def moved(self, step: np.ndarray) -> Lens:
        """Return the lens after a step (k,) of its unknowns."""
        return Lens(self.values + step)

    @property
    def is_possible(self) -> bool:
        """Tell whether such a lens can exist at all."""
        return bool(np.isfinite(self.values).all() and (self.values[:2] > 0).all())


class Projection:
    """
    Pixels of normalised image points, and the derivatives that every adjustment shares.

    Parameters
    ----------
    lens : Lens
    x, y : ndarray, shape (N,)
        Undistorted normalised coordinates.

    Attributes
    ----------
    uv : ndarray, shape (N, 2)
        Pixels.

    """

    def __init__(self, lens: Lens, x: np.ndarray, y: np.ndarray):
        self.lens, self.x, self.y = lens, x, y
        f, aspect, cx, cy, skew, *coefficients = lens.values
        self._distortion = plumb_bob.as_opencv(coefficients)
        self.xd, self.yd = plumb_bob.distort(self._distortion, x, y)
        self.uv = np.stack([f * self.xd + skew * self.yd + cx, f * aspect * self.yd + cy], axis=1)

    def by_points(self, depth: np.ndarray) -> np.ndarray:
        """Differentiate by points of the camera frame at depths (N,); shape (N, 2, 3)."""
        f, aspect, _, _, skew = self.lens.values[:5]
        x, y = self.x, self.y
        dxx, cross, dyy = plumb_bob.by_point(self._distortion, x, y)
        du_dx, du_dy = f * dxx + skew * cross, f * cross + skew * dyy
        dv_dx, dv_dy = f * aspect * cross, f * aspect * dyy
        J = np.empty((len(x), 2, 3))
        J[:, 0, 0], J[:, 0, 1] = du_dx / depth, du_dy / depth
        J[:, 1, 0], J[:, 1, 1] = dv_dx / depth, dv_dy / depth
        J[:, 0, 2] = -(du_dx * x + du_dy * y) / depth
        J[:, 1, 2] = -(dv_dx * x + dv_dy * y) / depth
        return J

    def by_intrinsics(self, free: np.ndarray | None = None, columns: int = INTRINSICS,
                      ) -> np.ndarray:
        """
        Differentiate by the unknowns of the lens.

        Parameters
        ----------
        free : ndarray of bool, shape (k,) or longer, optional
            Distortion coefficients that are fixed get zero derivatives; all are free by default.
        columns : int
            Width of the result; columns after those of the lens are zero.

        Returns
        -------
        ndarray, shape (N, 2, columns)

        """
        f, aspect, _, _, skew = self.lens.values[:5]
        x, y = self.x, self.y
        J = np.zeros((len(x), 2, columns))
        J[:, 0, _F], J[:, 1, _F] = self.xd, aspect * self.yd
        J[:, 1, _ASPECT] = f * self.yd
        J[:, 0, _CX] = J[:, 1, _CY] = 1
        J[:, 0, _SKEW] = self.yd
        for name in plumb_bob.COEFFICIENTS:
            index = _PLACE[name]
            if free is None or free[index]:
                bx, by = plumb_bob.by_coefficient(name, x, y)
                J[:, 0, index] = f * bx + skew * by
                J[:, 1, index] = f * aspect * by
        return J


def to_parameters(covariance: np.ndarray, lens: Lens) -> np.ndarray:
    """
    Carry a covariance of `INTRINSIC_NAMES` to `PARAMETER_NAMES`.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
        Its first rows belong to `INTRINSIC_NAMES`; others are left out.
    lens : Lens

    Returns
    -------
    ndarray, shape (k, k)

    """
    J = np.eye(INTRINSICS)
    J[_ASPECT, _F], J[_ASPECT, _ASPECT] = lens['aspect'], lens['f']     # fy = ζ f
    carried: np.ndarray = J @ covariance[:INTRINSICS, :INTRINSICS] @ J.T
    return carried


def to_intrinsics(covariance: np.ndarray, lens: Lens) -> np.ndarray:
    """
    Carry a covariance of `PARAMETER_NAMES` to `INTRINSIC_NAMES`: `to_parameters` undone.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
    lens : Lens

    Returns
    -------
    ndarray, shape (k, k)

    """
    J = np.eye(INTRINSICS)
    J[_ASPECT, _F], J[_ASPECT, _ASPECT] = -lens['aspect'] / lens['f'], 1 / lens['f']
    carried: np.ndarray = J @ covariance @ J.T
    return carried
