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
"""The images and the points that fit worst: where to look first when something is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.observations import ObservationTable
from selfcal_ros.report.page_table import PageTable
from selfcal_ros.report.style import (BLUE, counted_along_x, Drawing, figure_of, GREY, image_axes,
                                      image_height_in, INK, new_panel, ORANGE, styled)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Rows of each table.
WORST = 6
#: A point or an image with fewer observations says nothing of itself.
LEAST_SEEN = 3
#: The longest arrow is so large a share of the image.
_LONGEST_ARROW = 0.08


@dataclass(frozen=True)
class Fit:
    """
    How well images, or points, fit.

    Attributes
    ----------
    key : ndarray of int, shape (M,)
        Frame of an image, or track of a point.
    rms_px : ndarray, shape (M,)
        Root mean square distance of the observations used; NaN where there are none.
    used, rejected : ndarray of int, shape (M,)

    """

    key: np.ndarray
    rms_px: np.ndarray
    used: np.ndarray
    rejected: np.ndarray

    def worst(self, most: int = WORST) -> np.ndarray:
        """Return indices, the worst first, of those that are seen often enough."""
        usable = np.flatnonzero((self.used >= LEAST_SEEN) & np.isfinite(self.rms_px))
        return usable[np.argsort(-self.rms_px[usable], kind='stable')[:most]]


def fit_of_images(result: Calibration, seen: ObservationTable) -> Fit:
    """Measure the fit of every view."""
    return _fit(np.asarray(result.reconstructed.frames), seen.view, seen)


def fit_of_points(seen: ObservationTable) -> Fit:
    """Measure the fit of every track."""
    keys, index = np.unique(seen.track, return_inverse=True)
    return _fit(keys, index.reshape(-1), seen)


def _fit(keys: np.ndarray, index: np.ndarray, seen: ObservationTable) -> Fit:
    square = np.nan_to_num(np.sum(seen.residual**2, axis=1))
    used = np.bincount(index[seen.used], minlength=len(keys))
    total = np.bincount(index[seen.used], square[seen.used], minlength=len(keys))
    with np.errstate(invalid='ignore', divide='ignore'):
        rms = np.sqrt(total / used)
    return Fit(keys, rms, used, np.bincount(index[~seen.used], minlength=len(keys)))


def worst_tables(result: Calibration, seen: ObservationTable | None) -> list[PageTable]:
    """
    List the images and the points that fit worst.

    Parameters
    ----------
    result : Calibration
    seen : ObservationTable or None

    Returns
    -------
    list of PageTable
        Empty where there are too few.

    """
    if seen is None:
        return []
    images, points = fit_of_images(result, seen), fit_of_points(seen)
    tables = []
    rows: list[tuple[str, ...]] = [
        (str(images.key[k]), f'{images.rms_px[k]:.3f}', str(images.used[k]),
         str(images.rejected[k])) for k in images.worst()]
    if len(images.key) > LEAST_SEEN:
        tables.append(PageTable(
            'worst-images', 'Images that fit worst',
            'Blur, a jolt or a rolling shutter make one image stand out.',
            ('image', 'rms / px', 'used', 'rejected'), tuple(rows)))
    rows = []
    for k in points.worst():
        mine = np.flatnonzero(seen.used & (seen.track == points.key[k]))
        far = mine[np.nanargmax(np.linalg.norm(seen.residual[mine], axis=1))]
        frame = result.reconstructed.frames[seen.view[far]]
        rows.append((str(points.key[k]), f'{points.rms_px[k]:.3f}', str(points.used[k]),
                     str(points.rejected[k]),
                     f'{frame}: ({seen.xy[far, 0]:.0f}, {seen.xy[far, 1]:.0f})'))
    if rows:
        tables.append(PageTable(
            'worst-points', 'Points that fit worst',
            'A point that slides along an edge, moves, or was confused with another. Where it '
            'misses most is the image, and x and y in it.',
            ('track', 'rms / px', 'used', 'rejected', 'misses most in'), tuple(rows)))
    return [table for table in tables if table.rows]


def images_figure(result: Calibration, seen: ObservationTable | None) -> Drawing | None:
    """
    Draw how well each image fits, and every residual of the worst one.

    Parameters
    ----------
    result : Calibration
    seen : ObservationTable or None

    Returns
    -------
    Drawing or None
        None where there are too few images.

    """
    camera = result.camera
    if seen is None or min(camera.width, camera.height) <= 0:
        return None
    fit = fit_of_images(result, seen)
    worst = fit.worst(3)
    if not len(worst) or len(fit.key) <= LEAST_SEEN:
        return None
    with styled():
        height = image_height_in(camera.width, camera.height)
        left, right = new_panel(height), new_panel(height)
        left.vlines(fit.key, 0, fit.rms_px, color=BLUE, linewidth=1, alpha=0.5)
        left.plot(fit.key, fit.rms_px, 'o', color=BLUE, markersize=3.5)
        left.plot(fit.key[worst], fit.rms_px[worst], 'o', color=ORANGE, markersize=4.5)
        level = _levels(fit.key[worst], fit.rms_px[worst], np.ptp(fit.key),
                        float(np.nanmax(fit.rms_px)))
        for k, up in zip(worst, level):
            left.annotate(f'{fit.key[k]}', (fit.key[k], fit.rms_px[k]), (0, 4 + 9 * up),
                          textcoords='offset points', ha='center', fontsize=8)
        left.axhline(result.reprojection_rms_px, color=GREY, linewidth=1, linestyle='--',
                     label='of all images')
        left.set_ylim(0, (1.12 + 0.06 * max(level)) * float(np.nanmax(fit.rms_px)))
        counted_along_x(left, 'image')
        left.set_ylabel('rms residual / px')
        left.set_title('Residuals by image')
        left.spines[['top', 'right']].set_visible(False)
        left.legend(loc='lower right')
        _arrows(right, result, seen, int(worst[0]), int(fit.key[worst[0]]))
    return Drawing('images-fit', 'Which images fit', 'Left, the worst are named. Right, the '
                   'residuals of the worst: those of noise point in all directions; arrows that '
                   'agree tell of blur, of a rolling shutter, or of a lens unlike its model.',
                   (figure_of(left), figure_of(right)))


def _levels(at: np.ndarray, height: np.ndarray, width: float, top: float) -> list[int]:
    """Return how many lines up each label goes, so that no two overlap."""
    levels: list[int] = []
    for k in range(len(at)):
        # labels are a fourteenth of the axes wide and a line is a sixteenth high, at most
        near = [j for j in range(k) if abs(at[k] - at[j]) < 0.075 * max(width, 1)]
        up = 0
        while any(abs(height[k] / top + up / 16 - height[j] / top - levels[j] / 16) < 1 / 17
                  for j in near):
            up += 1
        levels.append(up)
    return levels


def _arrows(axes: Axes, result: Calibration, seen: ObservationTable, view: int, frame: int,
            ) -> None:
    """Draw the residuals of a view, from the measured to the predicted position."""
    camera = result.camera
    image_axes(axes, camera.width, camera.height)
    mine = seen.used & (seen.view == view)
    xy, residual = seen.xy[mine], seen.residual[mine]
    scale = arrow_scale(residual, camera.width)
    axes.quiver(xy[:, 0], xy[:, 1], residual[:, 0], residual[:, 1], angles='xy',
                scale_units='xy', scale=1 / scale, color=INK, width=0.003)
    axes.set_title(f'Image {frame}: residuals, {scale:.0f} times as long')


def arrow_scale(residual: np.ndarray, width: int) -> float:
    """Return the round factor by which arrows are long enough to be seen in an image."""
    length = np.linalg.norm(residual, axis=1)
    length = length[np.isfinite(length)]
    longest = float(np.percentile(length, 95)) if len(length) else 0.0
    if not longest > 0:
        return 1.0
    power = np.log10(max(_LONGEST_ARROW * width / longest, 1.0))
    return float(10 ** np.floor(power) * (1, 2, 5)[int(np.searchsorted(
        (0.301, 0.699), power % 1, side='right'))])
