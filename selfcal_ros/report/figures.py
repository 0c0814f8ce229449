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
The figures of a calibration.

Every figure is drawn by an object of its own, without a display and without the state of pyplot.
"""

from __future__ import annotations

from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.report.board_figure import board_figure
from selfcal_ros.report.fixed_point_figure import fixed_points_figure
from selfcal_ros.report.focal_figure import focal_figure
from selfcal_ros.report.lens_curve import lens_figure
from selfcal_ros.report.mounts.figure import mount_figure, mount_table
from selfcal_ros.report.object_views import object_views_figure
from selfcal_ros.report.observations import observations
from selfcal_ros.report.page_table import PageTable
from selfcal_ros.report.path_figure import path_figure
from selfcal_ros.report.pose_course import pose_figure
from selfcal_ros.report.radial_residuals import radial_figure
from selfcal_ros.report.ranges import ranges_table
from selfcal_ros.report.residual_figures import coverage_figure, residual_figure
from selfcal_ros.report.style import Drawing
from selfcal_ros.report.uncertainty_figures import projection_figure, sigma_figure
from selfcal_ros.report.worst import images_figure, worst_tables
from selfcal_ros.values.tracks import Tracks

__all__ = ['draw_figures', 'Drawing', 'draw_tables']


def draw_figures(result: Calibration | NotCalibrated,
                 tracks: Tracks | None = None) -> list[Drawing]:
    """
    Draw everything that there is to be seen.

    Parameters
    ----------
    result : Calibration or NotCalibrated
    tracks : Tracks, optional
        Those that were calibrated from; residuals over the image and coverage need them.

    Returns
    -------
    list of Drawing
        Figures for which the result holds nothing are left out.

    """
    if not result:
        drawings = [] if tracks is None or not tracks.image_size else [
            coverage_figure(tracks.xy, tracks.image_size)]
    else:
        size = (result.camera.width, result.camera.height)
        seen = observations(result, tracks) if tracks is not None else None
        drawings = [fixed_points_figure(result, seen), projection_figure(result),
                    focal_figure(result), lens_figure(result, seen), sigma_figure(result),
                    residual_figure(result, seen), radial_figure(result, seen),
                    images_figure(result, seen), path_figure(result), pose_figure(result, tracks),
                    object_views_figure(result), board_figure(result), mount_figure(result),
                    None if seen is None else coverage_figure(seen.xy[seen.used], size)]
    return [drawing for drawing in drawings if drawing is not None]


def draw_tables(result: Calibration | NotCalibrated,
                tracks: Tracks | None = None) -> list[PageTable]:
    """Return what is better read than seen; see `draw_figures` for the parameters."""
    if not result:
        return []
    ranges, mount = ranges_table(result), mount_table(result)
    seen = None if tracks is None else observations(result, tracks)
    return [*(table for table in (ranges, mount) if table is not None),
            *worst_tables(result, seen)]
