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
"""How well the camera is known: parameter by parameter, and over the image."""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.projection_uncertainty import (parameter_effect,
                                                       projection_uncertainty)
from selfcal_ros.report.style import (BLACK, BLUE, Drawing, figure_of, image_axes, image_height_in,
                                      new_panel, SEQUENTIAL, styled, WHITE)

#: The colours of projection uncertainty end at so many medians.
MOST_SHOWN = 10.0


def sigma_figure(result: Calibration) -> Drawing | None:
    """
    Draw the effect of each parameter's sigma, and the correlations.

    Parameters
    ----------
    result : Calibration

    Returns
    -------
    Drawing or None
        None if nothing was estimated.

    """
    variance = np.diag(np.asarray(result.covariance, float))
    free = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    if not len(free):
        return None
    sigma = np.sqrt(variance[free])
    names = [result.parameter_names[k] for k in free]
    correlation = np.asarray(result.covariance)[np.ix_(free, free)] / np.outer(sigma, sigma)
    effect = _corner_effect(result)[free] * sigma
    with styled():
        left, right = new_panel(), new_panel()
        left.barh(range(len(free)), effect, color=BLUE, height=0.6)
        left.set_yticks(range(len(free)), names)
        left.invert_yaxis()
        left.set_xlabel('shift of a point in the corner of the image / px')
        left.set_title('Effect of one sigma')
        left.spines[['top', 'right']].set_visible(False)
        for k, value in enumerate(effect):
            left.annotate(f'{value:.2g}', (value, k), (3, 0), textcoords='offset points',
                          va='center', fontsize=8)
        left.margins(x=0.15)
        picture = right.imshow(100 * correlation, cmap='RdBu_r', vmin=-100, vmax=100)
        right.set_xticks(range(len(free)), names)
        right.set_yticks(range(len(free)), names)
        right.tick_params(length=0)
        for i, row in enumerate(correlation):
            for j, value in enumerate(row):
                # in per cent, as two decimals run into each other
                right.text(j, i, f'{100 * value:z.0f}', ha='center', va='center', fontsize=8,
                           color=WHITE if abs(value) > 0.6 else BLACK)
        right.set_title('Correlation, %')
        right.figure.colorbar(picture, ax=right, fraction=0.046, pad=0.03)
    return Drawing('sigmas', 'Uncertainty of the parameters', 'What one sigma of each parameter '
                   'alone moves in the corner of the image; parameters that are strongly '
                   'correlated move together and hide part of this.',
                   (figure_of(left), figure_of(right)), 'certainty')


def _corner_effect(result: Calibration) -> np.ndarray:
    """Return the shift of a corner per unit of each parameter, pixels, shape (k,)."""
    camera = result.camera
    centre = camera.K[:2, 2]
    # a size that is not known is as if the principal point were in the middle
    corner = np.array([camera.width, camera.height]) - 0.5 if camera.width else 2 * centre
    # where a fisheye has no ray in its corner, the last that it has on the way there
    way = centre + np.linspace(1, 0.02, 50)[:, None] * (corner - centre)
    effect = parameter_effect(camera, way, rotate=False)
    first = int(np.argmax(np.isfinite(effect).all(axis=(1, 2))))
    return np.asarray(np.linalg.norm(effect[first], axis=0))


def projection_figure(result: Calibration) -> Drawing | None:
    """
    Draw the uncertainty of projection over the image, in pixels.

    Parameters
    ----------
    result : Calibration

    Returns
    -------
    Drawing or None
        None if nothing was estimated, or the image size is not known.

    """
    camera = result.camera
    covariance = np.asarray(result.covariance, float)
    known = np.isfinite(covariance).all() and covariance.any()
    if min(camera.width, camera.height) <= 0 or not known:
        return None
    found = projection_uncertainty(camera, covariance, 60)
    sigma = np.ma.masked_invalid(found.sigma_px)
    if sigma.count() == 0:
        return None
    with styled():
        axes = new_panel(image_height_in(camera.width, camera.height))
        top = float(sigma.max())
        # a corner beyond all observations would make the rest one colour
        shown = min(top, MOST_SHOWN * float(np.ma.median(sigma)))
        picture = axes.pcolormesh(found.u, found.v, sigma, cmap=SEQUENTIAL, vmin=0, vmax=shown,
                                  shading='gouraud' if not sigma.mask.any() else 'nearest',
                                  rasterized=True)
        if sigma.max() > 1.05 * sigma.min():
            whole = shown == top
            lines = axes.contour(found.u, found.v, sigma,
                                 6 if whole else np.linspace(0, shown, 4)[1:], colors=WHITE,
                                 linewidths=0.6)
            if whole:    # else they crowd where the observations end
                axes.clabel(lines, fmt='%.2g', fontsize=8)
        image_axes(axes, camera.width, camera.height)
        axes.plot(camera.K[0, 2], camera.K[1, 2], '+', color=WHITE, markersize=7)
        bar = axes.figure.colorbar(picture, ax=axes, fraction=0.035, pad=0.02,
                                   extend='max' if shown < top else 'neither')
        bar.set_label('σ / px')
        axes.set_title('σ of a projected point, worst direction')
    return Drawing('projection', 'Uncertainty of projection', f'All parameters together, after '
                   f'the best small rotation: at most {top:.2g} px, '
                   f'{float(np.ma.median(sigma)):.2g} px in the median.',
                   (figure_of(axes),), 'seen')
