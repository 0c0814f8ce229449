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
"""The difference of two calibrations over the image, as mrcal's show-projection-diff draws it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure
import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.comparison import Comparison, GRID
from selfcal_ros.report.style import (Drawing, image_axes, image_height_in, INK, ORANGE,
                                      PANEL_WIDTH_IN, round_down, SEQUENTIAL, styled, WHITE)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Every so many points of the grid has an arrow.
_ARROW_STEP = 3
#: The longest arrow is so many steps between arrows long.
_ARROW_LENGTH = 0.9


def comparison_figure(found: Comparison, camera: Camera, names: tuple[str, str] = ('', ''),
                      ) -> Drawing:
    """
    Draw where the second camera sees what the first one sees, after the best rotation.

    Parameters
    ----------
    found : Comparison
    camera : Camera
        The first one.
    names : (str, str)
        Where both come from.

    Returns
    -------
    Drawing
        In pixels, with arrows; beside it in sigmas where a covariance is known.

    """
    count = 1 if found.sigmas is None else 2
    height_in = image_height_in(camera.width, camera.height)
    with styled():
        figure = Figure(figsize=(count * PANEL_WIDTH_IN, height_in + 0.3), layout='constrained')
        axes = figure.subplots(1, count, squeeze=False)[0]
        _heat(axes[0], found, camera, found.distance_px, 'px', 'B - A, in pixels')
        _arrows(axes[0], found)
        if found.sigmas is not None:
            _heat(axes[1], found, camera, found.sigmas, 'sigmas', 'B - A, in sigmas')
        # dollars in the name of a file are no formula
        figure.suptitle(f'A {names[0]}   B {names[1]}', x=0.01, ha='left', fontsize=9,
                        parse_math=False)
    return Drawing('comparison', 'Difference over the image', found.verdict, (figure,))


def _heat(axes: Axes, found: Comparison, camera: Camera, values: np.ndarray, unit: str, title: str,
          ) -> None:
    """Draw a quantity on the grid of a comparison."""
    u, v = (found.pixels[:, k].reshape(GRID, GRID) for k in (0, 1))
    shown = np.ma.masked_invalid(values.reshape(GRID, GRID))
    top = max(float(shown.max()), 1e-9)
    picture = axes.pcolormesh(u, v, shown, cmap=SEQUENTIAL, vmin=0, vmax=top, rasterized=True,
                              shading='nearest' if shown.mask.any() else 'gouraud')
    image_axes(axes, camera.width, camera.height)
    bar = axes.figure.colorbar(picture, ax=axes, fraction=0.035, pad=0.02)
    bar.set_label(unit)
    if top > 1.05 * float(shown.min()) and top > 1e-6:
        # the scale tells which line is which: labels would overlap where lines are close
        bar.add_lines(axes.contour(u, v, shown, 6, colors=WHITE, linewidths=0.6))
    axes.set_title(title)


def _arrows(axes: Axes, found: Comparison) -> None:
    """Draw which way points go; the longest arrow is as long as there is room."""
    some = (slice(1, None, _ARROW_STEP),) * 2
    at, way = (values.reshape(GRID, GRID, 2)[some].reshape(-1, 2)
               for values in (found.pixels, found.difference_px))
    good = np.isfinite(way).all(axis=1)
    longest = float(np.linalg.norm(way[good], axis=1).max(initial=0.0))
    if longest < 1e-6:
        return
    room = _ARROW_STEP * float(np.ptp(found.pixels, axis=0).min()) / (GRID - 1)
    scale = longest / (_ARROW_LENGTH * room)
    arrows = axes.quiver(*at[good].T, *way[good].T, angles='xy', scale_units='xy', scale=scale,
                         color=ORANGE, width=0.004)
    sample = round_down(longest)
    axes.quiverkey(arrows, 0.8, 1.04, sample, f'{sample:g} px', labelpos='E', color=ORANGE,
                   labelcolor=INK, coordinates='axes', fontproperties={'size': 8})
