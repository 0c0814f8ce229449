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
Residuals against the distance from the principal point.

What a distortion model cannot follow is a function of the radius first of all, so it shows here
before it shows anywhere else (mrcal and Kalibr draw it, too).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.observations import ObservationTable
from selfcal_ros.report.style import BLUE, Drawing, figure_of, GREY, new_panel, ORANGE, styled

#: Rings hold equally many observations: so many at least, and there are so many rings at most.
LEAST_IN_RING, MOST_RINGS = 40, 16
#: Rings whose mean is so many of its sigmas away from zero are worth a sentence.
BEYOND_CHANCE = 4.0


@dataclass(frozen=True)
class RadialResiduals:
    """
    Residuals in rings about the principal point; predicted less measured, pixels.

    Attributes
    ----------
    radius_px : ndarray, shape (R,)
        Mean of each ring.
    outwards_px, around_px : ndarray, shape (R,)
        Mean along the radius, and across it (clockwise in the image).
    sigma_px : ndarray, shape (R,)
        Of these means, if errors were independent.
    spread_px : ndarray, shape (R,)
        Root mean square of one coordinate.

    """

    radius_px: np.ndarray
    outwards_px: np.ndarray
    around_px: np.ndarray
    sigma_px: np.ndarray
    spread_px: np.ndarray


def radial_residuals(centre: np.ndarray, xy: np.ndarray,
                     residual: np.ndarray) -> RadialResiduals | None:
    """
    Average residuals in rings.

    Parameters
    ----------
    centre : ndarray, shape (2,)
        Principal point, pixels.
    xy, residual : ndarray, shape (N, 2)
        Pixels; rows that are not finite are left out.

    Returns
    -------
    RadialResiduals or None
        None if there are too few for two rings.

    """
    good = np.isfinite(residual).all(axis=1)
    away, residual = xy[good] - centre, residual[good]
    radius = np.linalg.norm(away, axis=1)
    rings = min(len(radius) // LEAST_IN_RING, MOST_RINGS)
    if rings < 2:
        return None
    outwards = away / np.maximum(radius, 1e-9)[:, None]
    along = np.einsum('ni,ni->n', residual, outwards)
    across = residual[:, 1] * outwards[:, 0] - residual[:, 0] * outwards[:, 1]
    # the rank by radius tells the ring
    rank = np.empty(len(radius), int)
    rank[np.argsort(radius, kind='stable')] = np.arange(len(radius))
    ring = rank * rings // len(radius)
    count = np.bincount(ring, minlength=rings)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(ring, values, minlength=rings) / count

    power, outwards_px, around_px = mean((along**2 + across**2) / 2), mean(along), mean(across)
    scatter = np.sqrt(np.maximum(power - (outwards_px**2 + around_px**2) / 2, 0))
    return RadialResiduals(mean(radius), outwards_px, around_px, scatter / np.sqrt(count),
                           np.sqrt(power))


def radial_figure(result: Calibration, seen: ObservationTable | None) -> Drawing | None:
    """
    Draw mean and spread of the residuals against the radius.

    Parameters
    ----------
    result : Calibration
    seen : ObservationTable or None

    Returns
    -------
    Drawing or None
        None where there are too few observations.

    """
    course = None if seen is None else radial_residuals(
        result.camera.K[:2, 2], seen.xy[seen.used], seen.residual[seen.used])
    if course is None:
        return None
    with styled():
        left, right = new_panel(2.9), new_panel(2.9)
        left.axhline(0.0, color=GREY, linewidth=1)
        for values, colour, label in ((course.outwards_px, BLUE, 'outwards'),
                                      (course.around_px, ORANGE, 'around')):
            left.errorbar(course.radius_px, values, 2 * course.sigma_px, fmt='.-', color=colour,
                          linewidth=1, elinewidth=0.8, label=f'{label}, ± 2 σ')
        left.set_ylabel('mean residual / px')
        left.set_title('Mean by radius')
        right.plot(course.radius_px, course.spread_px, '.-', color=BLUE, label='of the residuals')
        if result.noise_sigma_px > 0:
            right.axhline(result.noise_sigma_px, color=GREY, linewidth=1, linestyle='--',
                          label='image noise σ')
        right.set_ylim(bottom=0)
        right.set_ylabel('rms of a coordinate / px')
        right.set_title('Spread by radius')
        for axes in (left, right):
            axes.set_xlabel('distance from the principal point / px')
            axes.spines[['top', 'right']].set_visible(False)
            axes.legend(loc='best', handlelength=1.4)
    return Drawing('radial', 'Residuals by radius', _caption(course),
                   (figure_of(left), figure_of(right)))


def _caption(course: RadialResiduals) -> str:
    """Say whether the means leave zero, and where they do most."""
    words = 'Where the distortion model fits the lens, both means stay at zero.'
    beyond = np.abs(course.outwards_px) / np.maximum(course.sigma_px, 1e-12)
    k = int(np.argmax(beyond))
    if beyond[k] < BEYOND_CHANCE:
        return words + ' Here they do, as far as chance lets one see.'
    way = 'farther out' if course.outwards_px[k] < 0 else 'farther in'
    return (f'{words} At {course.radius_px[k]:.0f} px from the principal point, points were '
            f'measured {abs(course.outwards_px[k]):.2g} px {way} than the camera says.')
