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
"""The camera: its parameters, and what they do to points and pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
# facts were here before, and programs import them so
from selfcal_ros.geometry.camera_facts import CameraFacts as CameraFacts, is_number  # noqa: F401
from selfcal_ros.geometry.lenses.catalogue import lens_model
from selfcal_ros.geometry.lenses.model import LensModel
from selfcal_ros.geometry.lenses.plumb_bob import PLUMB_BOB

#: Parameters of the calibration matrix, the first of every covariance, table and file.
MATRIX_PARAMETERS = ('fx', 'fy', 'cx', 'cy', 'skew')
#: All parameters of a perspective camera with a plumb-bob lens.
PARAMETER_NAMES = (*MATRIX_PARAMETERS, *PLUMB_BOB.coefficients)
#: Polynomial models, the poorer first: one that leaves the other's coefficients at zero is it.
_POLYNOMIAL = ('plumb_bob', 'rational_polynomial')


@dataclass(frozen=True)
class Camera:
    """
    A camera with one of the lens models that files and messages know.

    Pixel (0, 0) is the centre of the top-left pixel; the optical frame is x right, y down,
    z forward (REP 103).

    Parameters
    ----------
    K : array_like, shape (3, 3)
        Calibration matrix in pixels, K[2, 2] = 1.
    distortion : array_like, shape (k,)
        Coefficients of the lens model in its own order, fewer are filled up with zeros:
        k1 k2 p1 p2 k3 for 'plumb_bob' (OpenCV's order, on normalised coordinates).
    width, height : int
        Image size in pixels at full resolution; 0 when unknown.
    model : str
        One of `selfcal_ros.geometry.lenses.catalogue.LENS_MODELS`.

    Raises
    ------
    ArgumentError
        If K is not a finite upper triangular matrix with positive focal lengths, or the lens
        model is unknown or cannot have these coefficients.

    References
    ----------
    D. C. Brown (1966), Decentering distortion of lenses: the distortion. J. Kannala and
    S. Brandt (2006), A generic camera model: the fisheye.

    Examples
    --------
    >>> from selfcal_ros import Camera
    >>> camera = Camera([[520, 0, 320], [0, 520, 240], [0, 0, 1]], width=640, height=480)
    >>> camera.project([[0.0, 0.0, 2.0], [1.0, 0.5, 2.0]])
    array([[320., 240.],
           [580., 370.]])

    """

    K: np.ndarray
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(0))
    width: int = 0
    height: int = 0
    model: str = 'plumb_bob'

    if TYPE_CHECKING:
        # what may be given; the fields say what is kept
        def __init__(self, K: ArrayLike, distortion: ArrayLike = (), width: int = 0,
                     height: int = 0, model: str = 'plumb_bob') -> None: ...

    def __post_init__(self) -> None:
        """Check and freeze the arrays."""
        lens = lens_model(self.model)
        K = np.array(self.K, dtype=float)
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise ArgumentError(f'K must be a finite 3x3 matrix, not {K.tolist()!r}.')
        if K[0, 0] <= 0 or K[1, 1] <= 0 or abs(K[2, 2] - 1) > 1e-9 or np.tril(K, -1).any():
            raise ArgumentError('K must be upper triangular with positive focal lengths and '
                                f'K[2, 2] = 1; {K.tolist()!r} is not.')
        given = np.array(self.distortion, dtype=float).ravel()
        distortion = np.zeros(len(lens.coefficients))
        if given.size > distortion.size or not np.isfinite(given).all():
            raise ArgumentError(f'The distortion of the lens model {self.model} is '
                                f'{" ".join(lens.coefficients)}, all finite; '
                                f'{given.tolist()!r:.80} is not.')
        distortion[:given.size] = given
        lens.check(distortion)
        K.flags.writeable = False
        distortion.flags.writeable = False
        object.__setattr__(self, 'K', K)
        object.__setattr__(self, 'distortion', distortion)
        for name in ('width', 'height'):
            size = getattr(self, name)
            if not (is_number(size) and size >= 0 and size == int(size)):
                raise ArgumentError(f'The {name} of an image is a whole number of pixels, 0 where '
                                    f'it is not known, not {size!r:.40}.')
            object.__setattr__(self, name, int(size))

    def __eq__(self, other: object) -> bool:
        """Tell whether model, size and all values are the same."""
        if not isinstance(other, Camera):
            return NotImplemented
        return self._values() == other._values()

    def __hash__(self) -> int:
        """Be a key: nothing of a camera changes."""
        return hash(self._values())

    def _values(self) -> tuple[str | float, ...]:
        return (self.model, self.width, self.height, *self.K.ravel().tolist(),
                *self.distortion.tolist())

    @classmethod
    def from_parameters(cls, values: ArrayLike, width: int = 0, height: int = 0,
                        model: str = 'plumb_bob') -> Camera:
        """Build a camera from the values of its `parameter_names`."""
        fx, fy, cx, cy, skew, *coefficients = np.asarray(values, dtype=float).ravel()
        return cls([[fx, skew, cx], [0, fy, cy], [0, 0, 1]], coefficients, width, height, model)

    @property
    def lens(self) -> LensModel:
        """The lens model."""
        return lens_model(self.model)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters: fx fy cx cy skew, then the lens's coefficients."""
        return (*MATRIX_PARAMETERS, *self.lens.coefficients)

    @property
    def parameters(self) -> np.ndarray:
        """The values of `parameter_names`, shape (n,)."""
        K = self.K
        return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1], *self.distortion])

    def magnified(self, factor: float) -> Camera:
        """Return the camera whose images are larger about the principal point by a factor."""
        K = self.K.copy()
        K[:2, :2] *= factor
        return Camera(K, self.distortion, self.width, self.height, self.model)

    @property
    def is_pinhole(self) -> bool:
        """Tell a camera without distortion."""
        return self.lens.is_perspective and not self.distortion.any()

    @property
    def pinhole(self) -> Camera:
        """The camera of the same calibration matrix without distortion."""
        return Camera(self.K, (), self.width, self.height)

    def distortion_as(self, model: str) -> np.ndarray | None:
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
            return self.distortion
        if self.model in _POLYNOMIAL and model in _POLYNOMIAL:
            size = len(lens_model(model).coefficients)
            if not self.distortion[size:].any():
                return np.resize(np.append(self.distortion, np.zeros(size)), size)
        return None

    def as_model(self, model: str) -> Camera:
        """
        Return the same camera under another lens model.

        Raises
        ------
        ArgumentError
            If that model cannot express this lens exactly.

        """
        coefficients = self.distortion_as(model)
        if coefficients is None:
            raise ArgumentError(f'The lens model {self.model} is not supported here; {model} is.')
        return Camera(self.K, coefficients, self.width, self.height, model)

    def project(self, points: ArrayLike) -> np.ndarray:
        """
        Project points (..., 3) of the optical frame to pixels (..., 2).

        NaN for points that the lens cannot see: behind a perspective, or beyond the widest
        angle of a fisheye.
        """
        points = np.asarray(points, float)
        image = self.lens.image(points, self.distortion)
        if self.lens.is_perspective:
            seen = points[..., 2] > 0
        else:
            angle = np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2])
            seen = angle <= self.lens.widest_angle(self.distortion)
        return np.where(seen[..., None], self._to_pixels(image.xy), np.nan)

    def rays(self, pixels: ArrayLike) -> np.ndarray:
        """Return the unit rays (..., 3) that pixels (..., 2) see, NaN where there is none."""
        return self.lens.rays(self._from_pixels(pixels), self.distortion)

    def pixels(self, xy: ArrayLike) -> np.ndarray:
        """Map undistorted normalised points of shape (..., 2) to pixels of the same shape."""
        xy = np.asarray(xy, float)
        ahead = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        return self._to_pixels(self.lens.image(ahead, self.distortion).xy)

    def normalised(self, pixels: ArrayLike) -> np.ndarray:
        """
        Map pixels (..., 2) to undistorted normalised points (..., 2).

        NaN where that is impossible: beyond the fold of the distortion, and at 90° from the axis
        and beyond, where a pinhole has no image.
        """
        if self.is_pinhole:
            return self._from_pixels(pixels)
        rays = self.rays(pixels)
        z = np.where(rays[..., 2:] > 0, rays[..., 2:], np.nan)
        flat: np.ndarray = rays[..., :2] / z
        return flat

    def field_of_view(self) -> tuple[float, float]:
        """Return the angles, radians, that the middle row and column span; NaN if unknown."""
        cx, cy = self.K[0, 2], self.K[1, 2]
        ends = self.rays([[[-0.5, cy], [self.width - 0.5, cy]],
                          [[cx, -0.5], [cx, self.height - 0.5]]])
        from_axis = np.arctan2(np.hypot(ends[..., 0], ends[..., 1]), ends[..., 2])
        across, down = from_axis.sum(axis=1) if self.width and self.height else (np.nan, np.nan)
        return float(across), float(down)

    def _to_pixels(self, xy: np.ndarray) -> np.ndarray:
        pixels: np.ndarray = xy @ self.K[:2, :2].T + self.K[:2, 2]
        return pixels

    def _from_pixels(self, pixels: ArrayLike) -> np.ndarray:
        pixels, K = np.asarray(pixels, float), self.K
        y = (pixels[..., 1] - K[1, 2]) / K[1, 1]
        return np.stack([(pixels[..., 0] - K[0, 2] - K[0, 1] * y) / K[0, 0], y], axis=-1)
