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
Plumb-bob distortion (Brown 1966): radial k1, k2, k3 and tangential p1, p2, in OpenCV's convention.

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y

A coefficient is estimated when it is among `COEFFICIENTS`; what every other part of the package
has to know of it stands in the tables here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

#: Coefficients that can be estimated, in the order of covariances and files.
COEFFICIENTS = ('k1', 'k2', 'p1', 'p2')
#: Place of each coefficient in OpenCV's vector of distortion.
OPENCV_PLACE = {'k1': 0, 'k2': 1, 'p1': 2, 'p2': 3, 'k3': 4}
#: Displacement of the image's corner by a unit of the coefficient, over the corner's distance r
#: from the middle, is r to this power.
CORNER_POWER = {'k1': 2, 'k2': 4, 'p1': 1, 'p2': 1, 'k3': 6}
#: Standard deviation of the coefficient among ordinary lenses, where one has to be supposed.
USUAL_SIGMA = {'k1': 0.2, 'k2': 0.1}


def radial_factor(distortion: np.ndarray, r2: np.ndarray) -> np.ndarray:
    """
    Return the factor by which distortion stretches the distance from the middle.

    Parameters
    ----------
    distortion : ndarray, shape (5,)
        k1, k2, p1, p2, k3.
    r2 : ndarray, shape (...)
        Squared distance of normalised points from the middle.

    Returns
    -------
    ndarray, shape (...)

    """
    k1, k2, _, _, k3 = distortion
    factor: np.ndarray = 1 + r2 * (k1 + r2 * (k2 + r2 * k3 if k3 else k2))
    return factor


def distort(distortion: np.ndarray, x: np.ndarray, y: np.ndarray,
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Distort normalised points.

    Parameters
    ----------
    distortion : ndarray, shape (5,)
        k1, k2, p1, p2, k3.
    x, y : ndarray, shape (...)

    Returns
    -------
    xd, yd : ndarray, shape (...)

    """
    p1, p2 = distortion[2:4]
    r2 = x * x + y * y
    radial = radial_factor(distortion, r2)
    return (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)


def by_point(distortion: np.ndarray, x: np.ndarray, y: np.ndarray,
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Differentiate `distort` by the point; the derivative is symmetric.

    Parameters
    ----------
    distortion : ndarray, shape (5,)
        k1, k2, p1, p2, k3.
    x, y : ndarray, shape (...)

    Returns
    -------
    xx, xy, yy : ndarray, shape (...)
        ∂x'/∂x, ∂x'/∂y = ∂y'/∂x, ∂y'/∂y.

    """
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = radial_factor(distortion, r2)
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2)) if k3 else 2 * (k1 + 2 * k2 * r2)
    return (radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
            slope * x * y + 2 * p1 * x + 2 * p2 * y,
            radial + slope * y * y + 6 * p1 * y + 2 * p2 * x)


def by_coefficient(name: str, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Differentiate `distort` by one coefficient; the model is linear in all of them.

    Parameters
    ----------
    name : str
        Among `OPENCV_PLACE`.
    x, y : ndarray, shape (...)

    Returns
    -------
    x, y : ndarray, shape (...)

    """
    r2 = x * x + y * y
    if name == 'p1':
        return 2 * x * y, r2 + 2 * y * y
    if name == 'p2':
        return r2 + 2 * x * x, 2 * x * y
    power = r2**(CORNER_POWER[name] // 2)
    return x * power, y * power


def as_opencv(coefficients: ArrayLike) -> np.ndarray:
    """
    Put the values of `COEFFICIENTS` in OpenCV's order.

    Parameters
    ----------
    coefficients : array_like, shape (len(COEFFICIENTS),)

    Returns
    -------
    ndarray, shape (5,)
        k1, k2, p1, p2, k3; zero where a coefficient is not among `COEFFICIENTS`.

    """
    distortion = np.zeros(5)
    for name, value in zip(COEFFICIENTS, np.asarray(coefficients, float)):
        distortion[OPENCV_PLACE[name]] = value
    return distortion
