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
"""Residuals over the image, their distribution, and where the image was covered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import MaxNLocator
import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.report.observations import ObservationTable
from selfcal_ros.report.style import (BLUE, Drawing, figure_of, GREY, image_axes, image_height_in,
                                      INK, new_panel, ORANGE, PALE, round_down, SEQUENTIAL, styled)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Cells along the longer side of the image.
RESIDUAL_CELLS, COVERAGE_CELLS = 16, 32
#: From what chance leaves to what it does not, to be seen on light and on dark paper.
_SURPRISE = LinearSegmentedColormap.from_list('surprise', ['#9aa3ad', '#d98a1e', '#d4213d'])
#: A cell with fewer residuals has no mean worth drawing.
MIN_IN_CELL = 5


def residual_figure(result: Calibration, seen: ObservationTable | None) -> Drawing | None:
    """
    Draw the mean residual in cells of the image, and the histogram of all.

    Parameters
    ----------
    result : Calibration
    seen : ObservationTable or None
        None: the histogram alone.

    Returns
    -------
    Drawing or None
        None if there are no residuals.

    """
    if min(result.camera.width, result.camera.height) <= 0:
        seen = None
    if seen is not None and seen.used.any():
        residual = seen.residual[seen.used]
    elif result.residuals is not None and len(result.residuals):
        seen, residual = None, np.asarray(result.residuals, float)
    else:
        return None
    values = residual[np.isfinite(residual)]
    if len(values) < 10:
        return None
    caption = ('Residuals of a lens that the model describes are noise: short arrows in all '
               'directions, and a bell.')
    if seen is not None and _exceeds(residual, result):
        caption = ('The arrows show how the lens deviates from the distortion model, which the '
                   'calibration allows for')
        beside = np.empty(0) if result.residuals is None else np.asarray(result.residuals)
        beside = beside[np.isfinite(beside)]
        caption += '.' if len(beside) < 10 else '; the distribution is that of what remains.'
        values = values if len(beside) < 10 else beside
    with styled():
        panels = [new_panel()]
        _histogram(panels[0], values)
        if seen is not None:
            height = image_height_in(result.camera.width, result.camera.height) + 0.5
            panels.insert(0, new_panel(height))
            _field(panels[0], result, seen.xy[seen.used], residual)
        else:
            caption = 'Residuals in both image coordinates.'
    caption += (' The bell is that of the middle of the residuals, without their tails. The image '
                f'noise σ of {result.noise_sigma_px:.2g} px counts the tails. The reprojection '
                f'rms of {result.reprojection_rms_px:.2g} px is '
                + ('of the distances from edges.' if _is_of_edges(result)
                   else 'of both coordinates together.'))
    return Drawing('residuals', 'Residuals', caption, tuple(map(figure_of, panels)))


def _is_of_edges(result: Calibration) -> bool:
    """Tell whether residuals are distances from edges: one number each."""
    return result.residuals is not None and np.shape(result.residuals)[-1] == 1


def _exceeds(residual: np.ndarray, result: Calibration) -> bool:
    """Tell whether the residuals hold something that the calibration accounted for."""
    rms = float(np.sqrt(np.nanmean(np.sum(residual**2, axis=1))))
    return rms > 1.3 * result.reprojection_rms_px


def cells(size: tuple[int, int], xy: np.ndarray, along: int,
          ) -> tuple[np.ndarray, tuple[int, ...], float]:
    """
    Sort image points into square cells.

    Returns
    -------
    index : ndarray of int, shape (N,)
        Flat index of the cell of each point, rows first.
    shape : (int, int)
        Rows and columns.
    side_px : float

    """
    side = max(size) / along
    shape = tuple(max(int(np.ceil(n / side - 1e-9)), 1) for n in size[::-1])
    place = np.floor((xy + 0.5) / side).astype(int)
    place = np.clip(place, 0, [shape[1] - 1, shape[0] - 1])
    return place[:, 1] * shape[1] + place[:, 0], shape, side


def _field(axes: Axes, result: Calibration, xy: np.ndarray, residual: np.ndarray) -> None:
    """Draw an arrow for the mean residual of each cell."""
    camera = result.camera
    good = np.isfinite(residual).all(axis=1)
    xy, residual = xy[good], residual[good]
    index, shape, side = cells((camera.width, camera.height), xy, RESIDUAL_CELLS)
    count = np.bincount(index, minlength=shape[0] * shape[1])
    keep = count >= MIN_IN_CELL
    image_axes(axes, camera.width, camera.height)
    if not keep.any():
        axes.set_title('Mean residual: too few in each cell')
        return
    mean = np.stack([np.bincount(index, residual[:, k], minlength=len(count))
                     for k in (0, 1)], axis=1)[keep] / count[keep, None]
    place = np.stack([np.bincount(index, xy[:, k], minlength=len(count))
                      for k in (0, 1)], axis=1)[keep] / count[keep, None]
    length = np.linalg.norm(mean, axis=1)
    # most arrows stay within their cell
    scale = side / max(float(np.percentile(length, 80)), 1e-12)
    # what chance alone leaves of the mean of so many residuals
    chance = np.std(residual) * np.sqrt(2 / count[keep])
    arrows = axes.quiver(place[:, 0], place[:, 1], mean[:, 0], mean[:, 1], length / chance,
                         angles='xy', scale_units='xy', scale=1 / scale, cmap=_SURPRISE,
                         clim=(0, 4), width=0.005)
    bar = axes.figure.colorbar(arrows, ax=axes, location='bottom', shrink=0.6,
                               aspect=35, pad=0.02, extend='max')
    bar.set_label('length / expected from noise')
    sample = round_down(side / scale)
    axes.quiverkey(arrows, 0.82, 1 - 0.1 / figure_of(axes).get_figheight(), sample,
                   f'{sample:g} px', labelpos='E', color=INK, coordinates='figure',
                   fontproperties={'size': 8})
    axes.set_title('Mean residual in cells')


def _histogram(axes: Axes, values: np.ndarray) -> None:
    """Draw the distribution of the residuals' coordinates against a Gaussian."""
    sigma = float(robust_sigma(values - np.median(values)))
    sigma = sigma if sigma > 0 else float(values.std()) or 1.0
    reach = 4.5 * sigma
    edges = np.linspace(-reach, reach, 61)
    # of all, so that what lies beyond the ends takes its share of the area
    share = np.full(len(values), 1 / (len(values) * (edges[1] - edges[0])))
    axes.hist(values, edges.tolist(), weights=share, color=BLUE, alpha=0.45,
              label=f'{len(values)} residual coordinates')
    beyond = float(np.mean(np.abs(values) > reach))
    if beyond:
        axes.plot([], [], ' ', label=f'{100 * beyond:.2g} % lie beyond the ends')
    x = np.linspace(-reach, reach, 200)
    axes.plot(x, np.exp(-0.5 * (x / sigma)**2) / (sigma * np.sqrt(2 * np.pi)), color=ORANGE,
              linewidth=1.4, label=f'Gaussian, σ = {sigma:.3g} px')
    axes.set_xlabel('residual / px')
    axes.set_ylabel('density / px⁻¹')
    axes.set_title('Distribution')
    axes.spines[['top', 'right']].set_visible(False)
    axes.set_ylim(0, axes.get_ylim()[1] * 1.25)
    axes.legend(loc='upper left')


def coverage_figure(xy: np.ndarray, size: tuple[int, int]) -> Drawing | None:
    """
    Draw how many observations each part of the image has.

    Parameters
    ----------
    xy : ndarray, shape (N, 2)
        Observations, pixels.
    size : (int, int)
        Width and height of the image, pixels.

    Returns
    -------
    Drawing or None
        None if there are no observations or no image.

    """
    if not len(xy) or min(size) <= 0:
        return None
    index, shape, _ = cells(size, xy, COVERAGE_CELLS)
    count = np.bincount(index, minlength=shape[0] * shape[1]).reshape(shape)
    with styled():
        axes = new_panel(image_height_in(*size))
        shown = np.ma.masked_equal(count, 0)
        side = max(size) / COVERAGE_CELLS
        picture = axes.imshow(shown, extent=(-0.5, shape[1] * side - 0.5,
                                             shape[0] * side - 0.5, -0.5),
                              cmap=SEQUENTIAL, interpolation='nearest', vmin=0)
        image_axes(axes, *size)
        axes.set_facecolor(PALE)
        bar = axes.figure.colorbar(picture, ax=axes, fraction=0.035, pad=0.02,
                                   ticks=MaxNLocator('auto', integer=True))
        bar.set_label('observations')
        bar.outline.set_edgecolor(GREY)
        axes.set_title('Observations in cells')
    empty = float(np.mean(count == 0))
    caption = ('There are observations all over the image.' if empty < 0.005 else
               f'{100 * empty:.0f} % of the image has no observation. A calibration extrapolates '
               'the distortion there.')
    return Drawing('coverage', 'Coverage of the image', caption, (figure_of(axes),), 'seen')
