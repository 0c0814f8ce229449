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
The lens as a curve: how far from the principal point a ray appears, against its angle.

A line runs from the principal point to the farthest corner of the image, or as far as the lens has
rays. At a fixed angle the radius is uncertain by what the covariance does there, less what it does
to the principal point itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.observations import ObservationTable
from selfcal_ros.report.projection_uncertainty import axis_scale, parameter_effect
from selfcal_ros.report.style import (BLUE, Drawing, figure_of, GREY, new_panel, ORANGE, PALE,
                                      styled)

#: Points of the curve.
_POINTS = 160
#: Points along each side by which it is measured how much of the image has rays.
_GRID = 30
#: A lens is followed to this share of its widest angle.
_NEARLY = 0.9999
#: A pinhole is drawn as far as this many times the radius of the lens.
_TALLEST = 1.25
#: Observations beyond the angle that this share has reached are single ones, perhaps outliers.
_REACHED = 0.999


@dataclass(frozen=True)
class LensCurve:
    """
    Radius in the image against angle from the axis.

    Attributes
    ----------
    angle_deg, radius_px, sigma_px : ndarray, shape (N,)
        The sigma is that of the radius at the angle; NaN where the covariance is not finite.
    focal_px : float
        Pixels to a radian on the axis, in the direction of the curve.
    is_perspective : bool
    reached_deg : float or None
        Angle up to which there were observations.
    blind : float
        Share of the image that has no rays: there the lens model is not valid.

    """

    angle_deg: np.ndarray
    radius_px: np.ndarray
    sigma_px: np.ndarray
    focal_px: float
    is_perspective: bool
    reached_deg: float | None = None
    blind: float = 0.0

    @property
    def reference_px(self) -> np.ndarray:
        """Radius of the pinhole, or of the equidistant lens, of the same focal length."""
        angle = np.radians(self.angle_deg)
        return np.asarray(self.focal_px * (np.tan(angle) if self.is_perspective else angle))


def lens_curve(camera: Camera, covariance: np.ndarray, seen: np.ndarray | None = None,
               ) -> LensCurve | None:
    """
    Follow the lens from its axis to the farthest corner.

    Parameters
    ----------
    camera : Camera
        With its image size.
    covariance : ndarray, shape (k, k)
    seen : ndarray, shape (N, 2), optional
        Pixels of the observations that were used.

    Returns
    -------
    LensCurve or None
        None where the lens has no rays.

    """
    centre = camera.K[:2, 2]
    corners = np.array([[x, y] for x in (-0.5, camera.width - 0.5)
                        for y in (-0.5, camera.height - 0.5)]) - centre
    corner = corners[np.argmax(np.linalg.norm(corners, axis=1))]
    length = float(np.linalg.norm(corner))
    along = corner / length
    focal = 1 / float(np.linalg.norm(np.linalg.solve(camera.K[:2, :2], along)))
    widest = camera.lens.widest_angle(camera.distortion) * _NEARLY
    end = np.array([[np.sin(widest), 0, np.cos(widest)]])
    last = camera.lens.image(end, camera.distortion).xy[0, 0]
    if last > 0:
        length = min(length, focal * float(last))
    # the axis itself is first: what moves it moves the principal point
    radius = np.linspace(0.0, length, _POINTS)
    pixels = centre + radius[:, None] * along
    angle = _angles(camera, pixels)
    known = np.isfinite(angle) & (np.fmax.accumulate(angle) == angle)
    if known.sum() < 3:
        return None
    effect = parameter_effect(camera, pixels[known], rotate=False)
    slope = np.einsum('nij,i->nj', effect - effect[0], along)
    with np.errstate(invalid='ignore'):
        variance = np.einsum('ni,ij,nj->n', slope, np.asarray(covariance, float), slope)
    reached = None
    if seen is not None and len(seen):
        reached = float(np.nanquantile(_angles(camera, seen), _REACHED))
    return LensCurve(angle[known], radius[known], np.sqrt(np.maximum(variance, 0)),
                     focal * axis_scale(camera), camera.lens.is_perspective, reached,
                     _blind(camera))


def _blind(camera: Camera) -> float:
    """Return the share of the image for which the lens has no rays."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _GRID),
                       np.linspace(0, camera.height - 1, _GRID))
    rays = camera.rays(np.stack([u, v], axis=-1))
    return float(1 - np.isfinite(rays).all(axis=-1).mean())


def _angles(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return the angles of pixels from the axis, degrees."""
    rays = camera.rays(pixels)
    return np.asarray(np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])))


def lens_figure(result: Calibration, seen: ObservationTable | None) -> Drawing | None:
    """
    Draw the curve of the lens, and what remains of it less an ideal one, with bands of 2 sigma.

    Parameters
    ----------
    result : Calibration
    seen : ObservationTable or None
        None: how far observations reach is not shown.

    Returns
    -------
    Drawing or None
        None if the image size is not known, or the lens is an ideal one and held as such.

    """
    camera, covariance = result.camera, np.asarray(result.covariance, float)
    if min(camera.width, camera.height) <= 0:
        return None
    lens = [result.parameter_names.index(name) for name in camera.lens.coefficients]
    if camera.is_pinhole and not np.nan_to_num(covariance[lens][:, lens], nan=1.0).any():
        return None
    curve = lens_curve(camera, covariance, None if seen is None else seen.xy[seen.used])
    if curve is None:
        return None
    ideal = 'pinhole' if curve.is_perspective else 'equidistant'
    with styled():
        left, right = new_panel(), new_panel()
        top = _TALLEST * curve.radius_px.max()
        shown = curve.reference_px <= top
        left.plot(curve.angle_deg[shown], curve.reference_px[shown], '--', color=GREY,
                  linewidth=1, label=f'{ideal} of the same focal length')
        left.plot(curve.angle_deg, curve.radius_px, color=BLUE, label='this lens')
        left.fill_between(curve.angle_deg, curve.radius_px - 2 * curve.sigma_px,
                          curve.radius_px + 2 * curve.sigma_px, color=BLUE, alpha=0.3,
                          linewidth=0, label='± 2 σ')
        left.set_ylim(0, top)
        left.set_ylabel('radius in the image / px')
        left.set_title('Radius against angle')
        off = curve.radius_px - curve.reference_px
        right.axhline(0.0, color=GREY, linewidth=1, linestyle='--')
        right.plot(curve.angle_deg, off, color=BLUE, label='this lens')
        right.fill_between(curve.angle_deg, off - 2 * curve.sigma_px, off + 2 * curve.sigma_px,
                           color=BLUE, alpha=0.3, linewidth=0, label='± 2 σ')
        right.set_ylabel(f'radius less that of the {ideal} / px')
        right.set_title('Distortion')
        # what a pinhole does far out would hide all else
        low, high = np.percentile(off, [0, 100])
        band = 2 * np.nanmax(curve.sigma_px, initial=0.0)
        right.set_ylim(max(low - band, -4 * curve.radius_px.max()) - 0.05 * (high - low) - 0.1,
                       high + min(band, curve.radius_px.max()) + 0.05 * (high - low) + 0.1)
        for axes in (left, right):
            axes.set_xlabel('angle from the axis / degrees')
            axes.set_xlim(0, curve.angle_deg.max())
            axes.spines[['top', 'right']].set_visible(False)
            if curve.reached_deg is not None:
                axes.axvspan(curve.reached_deg, max(curve.angle_deg.max(), curve.reached_deg),
                             color=PALE, alpha=0.6, linewidth=0, zorder=0)
                axes.axvline(curve.reached_deg, color=ORANGE, linewidth=1,
                             label='observations end')
            axes.legend(loc='best', handlelength=1.4)
    return Drawing('lens', 'The lens', _caption(curve),
                   (figure_of(left), figure_of(right)), 'certainty')


def _caption(curve: LensCurve) -> str:
    """Say how far the lens was seen, and how well it is known at its end."""
    end = f'{curve.angle_deg[-1]:.0f} degrees from the axis, {curve.radius_px[-1]:.0f} px'
    known = (f' There the radius is known to ± {curve.sigma_px[-1]:.2g} px (one σ).'
             if np.isfinite(curve.sigma_px[-1]) else '')
    words = f'The curve ends {end} from the principal point, at the farthest corner or before.'
    if curve.reached_deg is not None:
        words += f' Observations reach {curve.reached_deg:.0f} degrees; grey is extrapolated.'
    if curve.blind > 0:
        known += (f' The model is valid up to there only: {100 * curve.blind:.1f} % of the '
                  'image lies beyond, and has no rays.')
    return words + known
