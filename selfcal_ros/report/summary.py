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
"""What one asks of a calibration first: may I use it, what is K, and what does it rest on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.projection_uncertainty import (projection_uncertainty,
                                                       ProjectionUncertainty)
from selfcal_ros.values.measured_digits import with_sigma

#: Where a parameter is from, by its status.
ORIGINS = {'estimated': 'images', 'held': 'fact', 'unobservable': 'unknown'}
#: A camera that is so many times less certain than one image point can be improved with ease.
MUCH_MORE = 3.0
#: The entries of K, rows first; None: zero or one by definition.
_K = (('fx', 'skew', 'cx'), (None, 'fy', 'cy'), (None, None, None))


@dataclass(frozen=True)
class Entry:
    """
    A number with its sigma and where it is from.

    Attributes
    ----------
    name, value, sigma : str
        The sigma is empty where there is none.
    origin : str
        'images', 'fact', 'unknown' or 'definition'.

    """

    name: str
    value: str
    sigma: str
    origin: str


def _entry(result: Calibration, name: str) -> Entry:
    k = result.parameter_names.index(name)
    status = result.status.get(name, 'estimated')
    variance = float(np.asarray(result.covariance, float)[k, k])
    sigma = float(np.sqrt(max(variance, 0))) if np.isfinite(variance) else np.inf
    value, spread = with_sigma(float(result.camera.parameters[k]),
                               sigma if status == 'estimated' else 0.0)
    return Entry(name, value, spread, ORIGINS.get(status, 'unknown'))


def matrix(result: Calibration) -> list[list[Entry]]:
    """Return the rows of K, entry by entry."""
    return [[Entry('', '1' if i == j == 2 else '0', '', 'definition') if name is None
             else _entry(result, name) for j, name in enumerate(row)] for i, row in enumerate(_K)]


def distortion(result: Calibration) -> list[Entry]:
    """Return the distortion coefficients in the order of ROS."""
    return [_entry(result, name) for name in result.camera.lens.coefficients]


def _projection(result: Calibration) -> ProjectionUncertainty | None:
    """Return the uncertainty of projection over the image, where it is known."""
    camera, covariance = result.camera, np.asarray(result.covariance, float)
    if min(camera.width, camera.height) <= 0 or not np.isfinite(covariance).all() \
            or not covariance.any():
        return None
    return projection_uncertainty(camera, covariance, 40)


def _middle_and_worst(sigma: np.ndarray) -> tuple[float, float] | None:
    """Return the median and the largest of what is known."""
    sigma = sigma[np.isfinite(sigma)]
    return (float(np.median(sigma)), float(sigma.max())) if len(sigma) else None


def quality(result: Calibration) -> str:
    """Say in a sentence or two how well the camera projects: in pixels, and far ahead."""
    found = _projection(result)
    if found is None:
        return ''
    in_pixels = _middle_and_worst(found.sigma_px)
    in_angle = _middle_and_worst(found.direction_sigma_rad(result.camera))
    if in_pixels is None or in_angle is None:
        return ''
    median, worst = in_pixels
    near, far = (_length_text(10 * sigma_rad) for sigma_rad in in_angle)
    sentence = (f'Where a point of the scene appears in the image is known to ± {px_text(median)} '
                f'in the median and ± {px_text(worst)} at worst (one σ): ± {near} and ± {far} '
                'sideways at a range of 10 m.')
    noise = result.noise_sigma_px
    if not noise > 0 or not np.isfinite(noise):
        return sentence
    sentence += f' A single image point was measured to ± {px_text(noise)}'
    if median > MUCH_MORE * noise:
        sentence += (', so there is room: more views, more rotation and points near the border '
                     'would make the camera more certain')
    return sentence + '.'


def _length_text(metres: float) -> str:
    """Write a length with two digits, in the unit that suits it."""
    for unit, size in (('m', 1.0), ('cm', 0.01), ('mm', 0.001)):
        if metres >= size or unit == 'mm':
            break
    text = px_text(metres / size).removesuffix(' px')
    return f'{text} {unit}'


def px_text(value: float) -> str:
    """Write with two digits that mean something, and without an exponent."""
    if not 0 < value < 1e6:
        return f'{value:.0f} px'
    return f'{value:.{max(1 - int(np.floor(np.log10(value))), 0)}f} px'
