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
"""The camera and what may be known of it beforehand."""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses import plumb_bob

#: Order of the calibration parameters in every covariance, status table and JSON file.
PARAMETER_NAMES = ('fx', 'fy', 'cx', 'cy', 'skew', *plumb_bob.COEFFICIENTS)

#: Distortion coefficients that each model leaves free, from the simplest to the richest.
DISTORTION_MODELS = {
    'none': (),
    'radial1': ('k1',),
    'radial2': ('k1', 'k2'),
    'plumb_bob': ('k1', 'k2', 'p1', 'p2'),
}


@dataclass(frozen=True)
class Camera:
    """
    A pinhole camera with plumb-bob distortion.

    Pixel (0, 0) is the centre of the top-left pixel; the optical frame is x right, y down,
    z forward (REP 103).

    Parameters
    ----------
    K : array_like, shape (3, 3)
        Calibration matrix in pixels, K[2, 2] = 1.
    distortion : array_like, shape (4,) or (5,)
        k1, k2, p1, p2[, k3], OpenCV's order, on normalised coordinates.
    width, height : int
        Image size in pixels at full resolution; 0 when unknown.

    Raises
    ------
    ArgumentError
        If K is not a finite upper triangular matrix with positive focal lengths.

    References
    ----------
    D. C. Brown (1966), Decentering distortion of lenses: the distortion.

    Examples
    --------
    >>> from selfcal_ros import Camera
    >>> camera = Camera([[520, 0, 320], [0, 520, 240], [0, 0, 1]], width=640, height=480)
    >>> camera.project([[0.0, 0.0, 2.0], [1.0, 0.5, 2.0]])
    array([[320., 240.],
           [580., 370.]])

    """

    K: np.ndarray
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))
    width: int = 0
    height: int = 0

    if TYPE_CHECKING:
        # what may be given; the fields say what is kept
        def __init__(self, K: ArrayLike, distortion: ArrayLike = (), width: int = 0,
                     height: int = 0) -> None: ...

    def __post_init__(self) -> None:
        """Check and freeze the arrays."""
        K = np.array(self.K, dtype=float)
        distortion = np.zeros(5)
        given = np.array(self.distortion, dtype=float).ravel()
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise ArgumentError(f'K must be a finite 3x3 matrix, not {K.tolist()!r}.')
        if given.size not in (0, 4, 5) or not np.isfinite(given).all():
            raise ArgumentError('Distortion must be k1 k2 p1 p2 [k3], all finite; '
                                f'{given.tolist()!r} is not.')
        if K[0, 0] <= 0 or K[1, 1] <= 0 or abs(K[2, 2] - 1) > 1e-9 or np.tril(K, -1).any():
            raise ArgumentError('K must be upper triangular with positive focal lengths and '
                                f'K[2, 2] = 1; {K.tolist()!r} is not.')
        distortion[:given.size] = given
        K.flags.writeable = False
        distortion.flags.writeable = False
        object.__setattr__(self, 'K', K)
        object.__setattr__(self, 'distortion', distortion)
        object.__setattr__(self, 'width', int(self.width))
        object.__setattr__(self, 'height', int(self.height))

    @classmethod
    def from_parameters(cls, values: ArrayLike, width: int = 0, height: int = 0) -> Camera:
        """Build a camera from the values of `PARAMETER_NAMES`."""
        fx, fy, cx, cy, skew, *coefficients = np.asarray(values, dtype=float).ravel()
        return cls([[fx, skew, cx], [0, fy, cy], [0, 0, 1]],
                   plumb_bob.as_opencv(np.array(coefficients)), width, height)

    @property
    def parameters(self) -> np.ndarray:
        """The values of `PARAMETER_NAMES`, shape (n,)."""
        K = self.K
        return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1],
                         *(self.distortion[plumb_bob.OPENCV_PLACE[name]]
                           for name in plumb_bob.COEFFICIENTS)])

    def distort(self, xy: np.ndarray) -> np.ndarray:
        """Distort normalised image points (..., 2)."""
        x, y = np.moveaxis(np.asarray(xy, float), -1, 0)
        return np.stack(plumb_bob.distort(self.distortion, x, y), axis=-1)

    def undistort(self, xy: np.ndarray, iterations: int = 20) -> np.ndarray:
        """
        Remove the distortion from normalised image points (..., 2) by Newton's method.

        Points outside the region where the polynomial can be inverted come back as NaN.
        """
        target = np.asarray(xy, float)
        if not self.distortion.any():
            return target.copy()
        point = target.copy()
        for _ in range(iterations):
            residual = self.distort(point) - target
            a, b, d = plumb_bob.by_point(self.distortion, *np.moveaxis(point, -1, 0))
            determinant = a * d - b * b
            with np.errstate(divide='ignore', invalid='ignore'):
                step = np.stack([d * residual[..., 0] - b * residual[..., 1],
                                 a * residual[..., 1] - b * residual[..., 0]],
                                axis=-1) / determinant[..., None]
            point = point - step
            if not np.nanmax(np.abs(step), initial=0.0) > 1e-13:
                break
        bad = ~(np.abs(self.distort(point) - target).max(axis=-1) < 1e-9)
        # beyond the fold the polynomial has another root, on the wrong branch
        a, b, d = plumb_bob.by_point(self.distortion, *np.moveaxis(point, -1, 0))
        bad |= ~((a * d - b * b > 0) & (a + d > 0))
        point[bad] = np.nan
        return point

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project points (..., 3) of the optical frame to pixels (..., 2)."""
        points = np.asarray(points, float)
        return self.pixels(points[..., :2] / points[..., 2:])

    def pixels(self, xy: np.ndarray) -> np.ndarray:
        """Map undistorted normalised points of shape (..., 2) to pixels of the same shape."""
        pixels: np.ndarray = self.distort(xy) @ self.K[:2, :2].T + self.K[:2, 2]
        return pixels

    def normalised(self, pixels: np.ndarray) -> np.ndarray:
        """Map pixels (..., 2) to undistorted normalised points (..., 2), NaN where impossible."""
        K = self.K
        pixels = np.asarray(pixels, float)
        y = (pixels[..., 1] - K[1, 2]) / K[1, 1]
        x = (pixels[..., 0] - K[0, 2] - K[0, 1] * y) / K[0, 0]
        return self.undistort(np.stack([x, y], axis=-1))


@dataclass(frozen=True)
class CameraFacts:
    """
    What the user knows of the camera beforehand; a fact is data, with a sigma.

    Parameters
    ----------
    aspect_ratio : float, optional
        fy / fx. None: not known.
    skew : float, optional
        Skew in pixels. None: not known.
    principal_point : (float, float), optional
        In pixels. None: not known.
    aspect_ratio_sigma, skew_sigma_px, principal_point_sigma_px : float
        Standard deviation of each fact; 0 means exact, and the parameter is held.
    distortion : {'auto', 'none', 'radial1', 'radial2', 'plumb_bob'}
        Which distortion coefficients are estimated; the others are held at zero. 'auto': the
        richest radial model with which the images still determine the camera.

    Raises
    ------
    ArgumentError
        If a value is impossible.

    References
    ----------
    M. N. Armstrong (1996), section 5.3: what each fact determines.

    Examples
    --------
    Square pixels, exactly, and a principal point that is known to 20 px:

    >>> from selfcal_ros import CameraFacts
    >>> facts = CameraFacts(aspect_ratio=1.0, skew=0.0, principal_point=(320, 240),
    ...                     principal_point_sigma_px=20.0)
    >>> facts.principal_point
    (320.0, 240.0)

    """

    aspect_ratio: float | None = None
    skew: float | None = None
    principal_point: tuple[float, float] | None = None
    aspect_ratio_sigma: float = 0.0
    skew_sigma_px: float = 0.0
    principal_point_sigma_px: float = 0.0
    distortion: str = 'auto'

    def __post_init__(self) -> None:
        """Refuse impossible facts."""
        if self.distortion not in ('auto', *DISTORTION_MODELS):
            raise ArgumentError(f'Distortion model {self.distortion!r} is unknown; choose one of '
                                f'auto, {", ".join(DISTORTION_MODELS)}.')
        if self.aspect_ratio is not None and not (
                math.isfinite(self.aspect_ratio) and 0.1 <= self.aspect_ratio <= 10):
            raise ArgumentError('The aspect ratio fy/fx must lie between 0.1 and 10, '
                                f'not {self.aspect_ratio!r}.')
        if self.skew is not None and not math.isfinite(self.skew):
            raise ArgumentError(f'The skew must be a finite number, not {self.skew!r}.')
        if self.principal_point is not None:
            point = tuple(float(v) for v in self.principal_point)
            if len(point) != 2 or not all(map(math.isfinite, point)):
                raise ArgumentError('The principal point must be two finite numbers, '
                                    f'not {self.principal_point!r}.')
            object.__setattr__(self, 'principal_point', point)
        for name in ('aspect_ratio_sigma', 'skew_sigma_px', 'principal_point_sigma_px'):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ArgumentError(f'{name} must be zero or a positive number, not {value!r}.')
