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
"""The robot's frame and the camera on it, from above and from the side, with their sigmas."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.patches import Ellipse
import numpy as np

from selfcal_ros.calibration.mount import Mount, mount_rotation, PLACE, TURN
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.report.mounts.record import known_angles, known_matrix
from selfcal_ros.report.mounts.words import (axis_sentence, floor_sentence, mount_rows,
                                             roll_and_yaw_sentence)
from selfcal_ros.report.page_table import PageTable
from selfcal_ros.report.style import (BLUE, Drawing, figure_of, GREEN, GREY, INK, new_panel, RED,
                                      styled)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Colours of the axes x, y and z, as RViz has them.
_AXES = (RED, GREEN, BLUE)
#: Coordinates of the panels: to the right, and upwards.
_PANELS = (('From above', 0, 1), ('From its right side', 0, 2))
#: Sigmas are enlarged to about this share of the drawing.
_SHARE = 0.06


def mount_figure(result: Calibration) -> Drawing | None:
    """
    Draw the mount of a camera.

    Parameters
    ----------
    result : Calibration

    Returns
    -------
    Drawing or None
        None where there is no mount.

    """
    mount = result.mount
    if not isinstance(mount, Mount):
        return None
    known = known_matrix(mount)[:3, 3]
    place = np.where(np.isfinite(known), known, 0.0)
    angles = known_angles(mount)
    R = mount_rotation(*(float(np.nan_to_num(np.array(angles[name], float))) for name in TURN))
    reach = max(float(np.linalg.norm(place)), 0.1)
    spread = _spread(mount)
    factor = _factor(spread, reach)
    open_ones = [name for name in PLACE if mount.status[name] == 'unobservable']
    corners = _view(result, R, place, 0.35 * reach)
    panels = []
    with styled():
        for title, across, up in _PANELS:
            axes = new_panel(3.4)
            _draw_body(axes, across, up, 0.3 * reach, mount.frame)
            for k in (1, 3):
                axes.plot(*corners[[0, k]][:, [across, up]].T, color=INK, linewidth=0.9)
            axes.fill(*corners[1:][:, [across, up]].T, color=GREY, alpha=0.25, linewidth=0.9,
                      edgecolor=INK)
            for k in (2, 4):
                axes.plot(*corners[[0, k]][:, [across, up]].T, color=INK, linewidth=0.9)
            axes.plot(place[across], place[up], 'o', color=INK, markersize=4, label='camera')
            _draw_spread(axes, place[[across, up]], spread[np.ix_([across, up], [across, up])],
                         factor)
            for name, draw in ((PLACE[across], axes.axvline), (PLACE[up], axes.axhline)):
                if name in open_ones:
                    draw(0.0, color=INK, linestyle=':', linewidth=1,
                         label=f'{name} of the camera is open: drawn at 0')
            axes.set_aspect('equal', adjustable='datalim')
            axes.margins(0.12)
            axes.set_xlabel(f'{PLACE[across]} / m, forward')
            axes.set_ylabel(f'{PLACE[up]} / m, {"left" if up == 1 else "up"}')
            axes.set_title(title)
            axes.spines[['top', 'right']].set_visible(False)
            axes.legend(loc='best', handlelength=1.2)
            panels.append(figure_of(axes))
    return Drawing('mount', 'The camera on the robot', f'The axes of {mount.frame} (x red, y '
                   'green, z blue) and what the camera sees from its place. Ellipses are one '
                   f'sigma of the place, {factor:g} times as large as they are.' if factor > 0
                   else f'The axes of {mount.frame} (x red, y green, z blue) and what the camera '
                   'sees from its place.', tuple(panels), 'robot')


def _spread(mount: Mount) -> np.ndarray:
    """Return the covariance of the place (3, 3), zero where it is not known."""
    spread = np.array(mount.covariance[:3, :3], float)
    for k, name in enumerate(PLACE):
        if mount.status[name] == 'unobservable':
            spread[k, :] = spread[:, k] = 0.0
    return np.where(np.isfinite(spread), spread, 0.0)


def _factor(spread: np.ndarray, reach: float) -> float:
    """Choose by how much to enlarge sigmas: 1, 2, 5, 10 and so on; 0 where all are zero."""
    sigma = float(np.sqrt(np.diag(spread).max().clip(0)))
    if not sigma > 0:
        return 0.0
    wanted = max(_SHARE * reach / sigma, 1.0)
    power = 10.0**np.floor(np.log10(wanted))
    steps = [step * power for step in (1, 2, 5) if step * power <= wanted]
    return float(steps[-1])


def _view(result: Calibration, R: np.ndarray, place: np.ndarray, depth: float) -> np.ndarray:
    """Return the centre and the corners of the image before it, in the body, shape (5, 3)."""
    K = result.camera.K
    right, low = result.camera.width - 0.5, result.camera.height - 0.5
    pixels = np.array([(-0.5, -0.5), (right, -0.5), (right, low), (-0.5, low)])
    if min(result.camera.width, result.camera.height) <= 0:
        pixels = K[:2, 2] + 0.4 * np.diag(K)[:2] * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    rays = np.column_stack([(pixels - K[:2, 2]) / np.diag(K)[:2], np.ones(4)])
    # a wide lens sees more than a drawing shows
    rays[:, :2] = rays[:, :2].clip(-1.2, 1.2)
    corners = place + depth * rays @ R.T
    return np.vstack([place, corners])


def _draw_body(axes: Axes, across: int, up: int, length: float, frame: str) -> None:
    """Draw the axes of the body, and the plane at its height zero."""
    if up == 2:
        axes.axhline(0.0, color=GREY, linewidth=0.7, linestyle='--',
                     label=f'height 0 of {frame}')
    for k, colour in enumerate(_AXES):
        tip = length * np.eye(3)[k]
        axes.plot([0, tip[across]], [0, tip[up]], color=colour, linewidth=2,
                  solid_capstyle='round')
    axes.plot(0, 0, 's', color=GREY, markersize=5, label=frame)


def _draw_spread(axes: Axes, centre: np.ndarray, covariance: np.ndarray, factor: float) -> None:
    """Draw one sigma of the place, enlarged."""
    values, vectors = np.linalg.eigh(covariance)
    if not values[-1] > 0 or factor <= 0:
        return
    lengths = 2 * factor * np.sqrt(values.clip(0))
    axes.add_patch(Ellipse(tuple(centre), lengths[1], lengths[0],
                           angle=float(np.degrees(np.arctan2(*vectors[::-1, 1]))),
                           facecolor=BLUE, alpha=0.3, linewidth=0))


def mount_table(result: Calibration) -> PageTable | None:
    """Return the degrees of freedom of the mount as a table; None where there is no mount."""
    mount = result.mount
    if not isinstance(mount, Mount):
        return None
    words = {'estimated': 'estimated', 'held': 'a fact', 'unobservable': 'not determined'}
    rows: tuple[tuple[str, ...], ...] = tuple(
        (f'{row.name}, {row.meaning}',
         f'{row.value} {row.unit}'.strip() if row.value else '–',
         f'± {row.sigma} {row.unit}' if row.sigma else '–',
         words.get(row.status, row.status), row.why)
        for row in mount_rows(mount, motion=result.motion))
    columns: tuple[str, ...] = ('', 'value', 'σ', 'where from', 'by, or what would show it')
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], tuple(row[:-1] for row in rows)
    below = ' '.join(filter(None, (roll_and_yaw_sentence(mount), axis_sentence(mount),
                                   floor_sentence(mount))))
    return PageTable(
        'mount-numbers', f'The camera on {mount.frame}',
        'The pose of the lens on the body: x forward, y left, z up. Angles are against a level '
        'camera that looks straight ahead. Scale is the length of the median step between '
        f'views. {mount.pose_count} poses were used, {mount.outlier_count} set aside.'
        + (f' {below}' if below else ''),
        columns, rows, 'robot', words=(3, 4))
