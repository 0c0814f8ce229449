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
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.chain_inverse import ChainInverse
from selfcal_ros.geometry.lenses.model import LensModel
from selfcal_ros.geometry.lenses.plumb_bob import PLUMB_BOB

#: The calibration matrix alone, the first unknowns of the block.
MATRIX_NAMES = ('f', 'aspect', 'cx', 'cy', 'skew')
_F, _ASPECT, _CX, _CY, _SKEW = range(5)


def intrinsic_names(model: LensModel) -> tuple[str, ...]:
    """Name the unknowns of the block, in the order of every covariance of the lens."""
    return (*MATRIX_NAMES, *model.coefficients)


def places_among(names: tuple[str, ...], wanted: Iterable[str]) -> np.ndarray:
    """Return where some of `names` stand, shape (k,)."""
    return np.array([names.index(name) for name in wanted], dtype=int)


@dataclass(frozen=True)
class Lens:
    """
    Values of the lens block.

    Attributes
    ----------
    values : ndarray, shape (k,)
        Of `names`.
    model : LensModel

    """

    values: np.ndarray
    model: LensModel = PLUMB_BOB

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return intrinsic_names(self.model)

    @property
    def named(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Names and values of the unknowns."""
        return self.names, self.values

    def __len__(self) -> int:
        """Count the unknowns."""
        return len(self.values)

    def __getitem__(self, name: str) -> float:
        """Return the value of one unknown."""
        return float(self.values[self.names.index(name)])

    @classmethod
    def of(cls, camera: Camera) -> Lens:
        """Take the values of a camera."""
        fx, fy, *rest = camera.parameters
        return cls(np.array([fx, fy / fx, *rest]), camera.lens)

    @property
    def focal_lengths(self) -> np.ndarray:
        """The focal length of every camera, pixels, shape (C,)."""
        return self.values[[_F]]

    @property
    def distortion(self) -> np.ndarray:
        """The coefficients of the model."""
        return self.values[len(MATRIX_NAMES):]

    def places(self, names: Iterable[str]) -> np.ndarray:
        """Return where some unknowns stand, shape (k,)."""
        return places_among(self.names, names)

    def take(self, names: Iterable[str]) -> np.ndarray:
        """Return the values of some unknowns, shape (k,)."""
        return np.take(self.values, self.places(names))

    def camera(self, width: int = 0, height: int = 0) -> Camera:
        """Return the camera."""
        f, aspect, *rest = self.values
        return Camera.from_parameters([f, aspect * f, *rest], width, height, self.model.name)

    def with_values(self, values: dict[str, float]) -> Lens:
        """Return the lens with some values replaced."""
        changed = self.values.copy()
        for name, value in values.items():
            changed[self.names.index(name)] = value
        return replace(self, values=changed)

    def moved(self, step: np.ndarray) -> Lens:
        """Return the lens after a step (k,) of its unknowns."""
        return replace(self, values=self.values + step)

    @property
    def is_possible(self) -> bool:
        """Tell whether such a lens can exist at all."""
        if not (np.isfinite(self.values).all() and (self.values[:2] > 0).all()):
            return False
        try:
            self.model.check(self.distortion)
        except ArgumentError:
            return False
        return self.model.is_smooth(self.distortion)

    @property
    def parts(self) -> tuple[tuple[Lens, slice], ...]:
        """The lens of every camera, and where it stands in the block."""
        return ((self, slice(0, len(self))),)

    def pixel_directions(self, xy: np.ndarray) -> np.ndarray:
        """
        Return about where pixels look, shape (N, 3), good enough to tell ahead from behind.

        A perspective looks along its axis; elsewhere the angle is the radius, as it is of a
        lens without distortion.
        """
        if self.model.is_perspective:
            return np.broadcast_to([0.0, 0.0, 1.0], (len(xy), 3))
        f, aspect, cx, cy = self.values[:4]
        across = np.column_stack([(xy[:, 0] - cx) / f, (xy[:, 1] - cy) / (f * aspect)])
        angle = np.linalg.norm(across, axis=1)
        # sin(θ) / θ, which is one on the axis
        return np.column_stack([across * np.sinc(angle / np.pi)[:, None], np.cos(angle)])


class Projection:
    """
    Pixels of points of the camera frame, and the derivatives that every adjustment shares.

    Parameters
    ----------
    lens : Lens
    X : ndarray, shape (N, 3)

    Attributes
    ----------
    uv : ndarray, shape (N, 2)
        Pixels.

    """

    def __init__(self, lens: Lens, X: np.ndarray):
        self.lens, self._image = lens, lens.model.image(X, lens.distortion)
        f, aspect, cx, cy, skew = lens.values[:5]
        self.xd, self.yd = self._image.xy[:, 0], self._image.xy[:, 1]
        self.uv = self._image.xy * [f, f * aspect]
        self.uv += [cx, cy]
        if skew:
            self.uv[:, 0] += skew * self.yd

    def by_points(self) -> np.ndarray:
        """Differentiate by the points; shape (N, 2, 3)."""
        f, aspect, _, _, skew = self.lens.values[:5]
        J = self._image.by_ray()
        J[:, 0] *= f
        if skew:
            J[:, 0] += skew * J[:, 1]
        J[:, 1] *= f * aspect
        return J

    def by_intrinsics(self, free: np.ndarray | None = None, columns: int = 0) -> np.ndarray:
        """
        Differentiate by the unknowns of the lens.

        Parameters
        ----------
        free : ndarray of bool, shape (k,) or longer, optional
            Distortion coefficients that are fixed get zero derivatives; all are free by default.
        columns : int
            Width of the result, if it is to be wider; columns after those of the lens are zero.

        Returns
        -------
        ndarray, shape (N, 2, columns)

        """
        f, aspect, _, _, skew = self.lens.values[:5]
        # each number of all points in a row in memory
        J = np.zeros((max(columns, len(self.lens)), 2, len(self.xd))).transpose(2, 1, 0)
        J[:, 0, _F], J[:, 1, _F] = self.xd, aspect * self.yd
        J[:, 1, _ASPECT] = f * self.yd
        J[:, 0, _CX] = J[:, 1, _CY] = 1
        J[:, 0, _SKEW] = self.yd
        for index, name in enumerate(self.lens.model.coefficients, len(MATRIX_NAMES)):
            if free is None or free[index]:
                bx, by = self._image.by_coefficient(name)
                J[:, 0, index] = f * bx + skew * by
                J[:, 1, index] = f * aspect * by
        return J

    def by_parameters(self) -> np.ndarray:
        """Differentiate by the parameters of the camera, fx and fy among them; (N, 2, k)."""
        f, aspect = self.lens.values[:2]
        J = self.by_intrinsics()
        J[:, :, _F] -= aspect / f * J[:, :, _ASPECT]
        J[:, :, _ASPECT] /= f
        return J


def to_parameters(covariance: np.ndarray | ChainInverse, lens: Lens) -> np.ndarray:
    """
    Carry a covariance of `lens.names` to the parameters of the camera.

    Parameters
    ----------
    covariance : ndarray or ChainInverse, shape (n, n)
        Its first rows belong to `lens.names`; others are left out.
    lens : Lens

    Returns
    -------
    ndarray, shape (k, k)
        Of `Camera.parameter_names`.

    """
    count, J = len(lens), to_parameters_slopes(lens)
    carried: np.ndarray = J @ covariance[:count, :count] @ J.T
    return carried


def to_parameters_slopes(lens: Lens) -> np.ndarray:
    """Differentiate the camera's parameters by `lens.names`, shape (k, k)."""
    J = np.eye(len(lens))
    J[_ASPECT, _F], J[_ASPECT, _ASPECT] = lens['aspect'], lens['f']     # fy = ζ f
    return J


def to_intrinsics(covariance: np.ndarray, lens: Lens) -> np.ndarray:
    """
    Carry a covariance of the camera's parameters to `lens.names`: `to_parameters` undone.

    Parameters
    ----------
    covariance : ndarray, shape (k, k)
    lens : Lens

    Returns
    -------
    ndarray, shape (k, k)

    """
    J = np.eye(len(lens))
    J[_ASPECT, _F], J[_ASPECT, _ASPECT] = -lens['aspect'] / lens['f'], 1 / lens['f']
    carried: np.ndarray = J @ covariance @ J.T
    return carried
