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
"""The focal length over the frames, where it varies."""

from __future__ import annotations

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.style import (BLUE, counted_along_x, Drawing, figure_of, GREY, new_panel,
                                      styled)


def focal_figure(result: Calibration) -> Drawing | None:
    """
    Draw the focal length of every frame, with a band of 2 sigma.

    Parameters
    ----------
    result : Calibration

    Returns
    -------
    Drawing or None
        None where it is constant.

    """
    course = result.focal
    if course is None:
        return None
    with styled():
        axes = new_panel()
        axes.axhline(result.camera.K[0, 0], color=GREY, linewidth=1, linestyle='--',
                     label='mean: fx of the camera')
        axes.plot(course.frames, course.fx, '.-', color=BLUE, markersize=4, linewidth=1,
                  label='of each image')
        axes.fill_between(course.frames, course.fx - 2 * course.sigma,
                          course.fx + 2 * course.sigma, color=BLUE, alpha=0.3, linewidth=0,
                          label='± 2 σ')
        counted_along_x(axes, 'image')
        axes.set_ylabel('fx / px')
        axes.set_title('Focal length over the recording')
        axes.spines[['top', 'right']].set_visible(False)
        axes.legend(loc='best', handlelength=1.4)
    share = 100 * (course.fx.max() / course.fx.min() - 1)
    caption = (f'The focal length varied by {share:.2g} %. Each image has its own camera: all '
               'else is the same, and the distortion goes with the magnification.')
    return Drawing('focal', 'The focal length', caption, (figure_of(axes),), 'certainty')
