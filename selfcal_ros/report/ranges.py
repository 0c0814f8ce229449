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
"""What the uncertainty of a camera is at a range, in millimetres, and over the radius."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.page_table import PageTable
from selfcal_ros.report.projection_uncertainty import projection_uncertainty

#: Ranges of arms, rooms, halls and streets, metres.
RANGES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
#: Parts of the image: name, and distances from its centre as shares of the half diagonal.
_PARTS = (('in the middle', 0.0, 0.25), ('halfway out', 0.4, 0.6), ('near the corners', 0.85, 1.0))


def angular_sigmas(result: Calibration) -> dict[str, float]:
    """
    Return the sigma of the direction to a point by part of the image, radians.

    After the best small rotation, as in the figure of projection. Parts that the lens does not
    see are left out; so is everything where the covariance is not known.
    """
    camera, covariance = result.camera, np.asarray(result.covariance, float)
    if min(camera.width, camera.height) <= 0 or not np.isfinite(covariance).all() \
            or not covariance.any():
        return {}
    found = projection_uncertainty(camera, covariance, 40)
    u, v = np.meshgrid(found.u, found.v)
    sigma = found.direction_sigma_rad(camera).reshape(-1)
    place = np.hypot(u / (camera.width - 1) - 0.5, v / (camera.height - 1) - 0.5)
    place = place.reshape(-1) * np.sqrt(2)
    sigmas = {}
    for name, low, high in _PARTS:
        here = sigma[(place >= low) & (place <= high) & np.isfinite(sigma)]
        if len(here):
            sigmas[name] = float(np.sqrt(np.mean(here**2)))
    return sigmas


def ranges_table(result: Calibration, ranges_m: Sequence[float] = RANGES_M) -> PageTable | None:
    """
    Tell how far sideways a point is uncertain at ranges.

    Parameters
    ----------
    result : Calibration
    ranges_m : sequence of float
        Metres. A known object adds the median range of its views.

    Returns
    -------
    PageTable or None
        None where the covariance or the image size is not known.

    """
    sigmas = angular_sigmas(result)
    if not sigmas:
        return None
    rows = [(f'{one:g} m', *(_millimetres(1e3 * one * sigma) for sigma in sigmas.values()))
            for one in ranges_m]
    own = _range_of_object(result)
    if own is not None:
        rows.append((f'{own:.2g} m, of the object\'s views',
                     *(_millimetres(1e3 * own * sigma) for sigma in sigmas.values())))
    focal = max(result.sigma[name] / result.camera.K[k, k]
                for k, name in enumerate(('fx', 'fy')))
    return PageTable(
        'ranges', 'Uncertainty at a range',
        'By how much (one σ) a point is misplaced sideways because of the camera alone, after '
        'the best small rotation: a mounting that is calibrated along takes that up. An object of '
        f'known size is misplaced by {100 * focal:.2g} % of its range along the ray.',
        ('range', *sigmas), tuple(rows), 'certainty')


def _millimetres(value: float) -> str:
    """Write a length of two digits in the unit that suits it."""
    if value >= 1000:
        return f'{value / 1000:.2g} m' if value < 1e5 else f'{value / 1000:.0f} m'
    return f'{value:.2g} mm' if value < 100 else f'{value:.0f} mm'


def _range_of_object(result: Calibration) -> float | None:
    """Return the median distance of a known object from its views, metres."""
    shape = result.reconstruction
    if result.motion != 'known-object' or shape is None or not len(shape.points):
        return None
    points = np.asarray(shape.points, float)
    middle = np.mean(points[:, :3] / points[:, 3:], axis=0)
    poses = np.asarray(shape.cam_from_world, float)
    away = float(np.median(np.linalg.norm(poses[:, :, :3] @ middle + poses[:, :, 3], axis=1)))
    return away if np.isfinite(away) and away > 0 else None
