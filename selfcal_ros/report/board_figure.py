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
"""How a board bends, as it was estimated with the camera."""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.board_shape import board_shape
from selfcal_ros.report.style import Drawing, figure_of, new_panel, styled

#: Lines of equal height.
_LEVELS = 9


def board_figure(result: Calibration) -> Drawing | None:
    """
    Draw the heights of a board's points over the plane that fits them best.

    Parameters
    ----------
    result : Calibration

    Returns
    -------
    Drawing or None
        None where no bend shows.

    """
    shape = board_shape(result)
    if shape is None or not shape['bent'] or result.reconstruction is None:
        return None
    points = result.reconstruction.points[:, :3] / result.reconstruction.points[:, 3:]
    centred = points - points.mean(axis=0)
    along = np.linalg.svd(centred, full_matrices=False)[2]
    # up is where the object's own axis points
    along[2] *= np.sign(along[2][np.argmax(np.abs(along[2]))])
    x, y, height = (1e3 * centred @ along.T).T
    with styled():
        axes = new_panel()
        filled = axes.tricontourf(x, y, height, _LEVELS, cmap='viridis')
        axes.plot(x, y, '.', color='0.15', markersize=2)
        axes.figure.colorbar(filled, ax=axes, label='height / mm', shrink=0.8)
        axes.set(xlabel='along the board / mm', ylabel='across / mm', aspect='equal')
        axes.set_title('Heights of the board\'s points')
    bend = shape['bend_m']
    caption = (f'The board bends by {1e3 * bend["value"]:.2g} ± {1e3 * bend["sigma"]:.1g} mm from '
               'its lowest to its highest point. The camera is estimated with it; dots are the '
               'points of the board.')
    return Drawing('board', 'The shape of the board', caption, (figure_of(axes),), 'scene')
