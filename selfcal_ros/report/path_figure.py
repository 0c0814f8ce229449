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
"""The camera's path and the structure, seen along the rotation axis."""

from __future__ import annotations

from matplotlib.collections import LineCollection
import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.report.style import Drawing, figure_of, GREY, INK, new_panel, SEQUENTIAL, styled

#: More cameras than this hide each other.
MAX_CONES = 24


def path_figure(result: Calibration) -> Drawing | None:
    """
    Draw the plan view of the camera path and the points.

    The unit of length is the root mean square distance between successive views: images alone
    tell no other.

    Parameters
    ----------
    result : Calibration

    Returns
    -------
    Drawing or None
        None if there are fewer than two views.

    """
    if result.motion == 'known-object':
        return None     # poses of a board held anyhow: no path
    poses = np.asarray(result.reconstructed.cam_from_world, float)
    if len(poses) < 2 or not np.isfinite(poses).all():
        return None
    R = poses[:, :, :3]
    centres = camera_centres(poses)
    step = float(np.sqrt(np.mean(np.sum(np.diff(centres, axis=0)**2, axis=1))))
    if not step > 0:
        return None
    # seen from the side that the image calls up, so that a left turn looks like one
    flip = -1.0 if R[:, 1, 2].mean() > 0 else 1.0
    mirror = np.array([1.0, flip])
    path = centres[:, :2] / step * mirror
    ahead = R[:, 2, :2] * mirror
    points = _finite_points(result.reconstructed.points) / step
    points = points[:, :2] * mirror
    with styled():
        axes = new_panel(4.2)
        low, high = _window(path, points)
        axes.plot(*points.T, '.', color=GREY, markersize=2.6, markeredgewidth=0, alpha=0.7,
                  rasterized=True, label=f'points ({len(points)})')
        axes.plot(*path.T, color=INK, linewidth=0.8)
        reach = min(0.04 * float((high - low).max()), 2.0)
        some = np.unique(np.linspace(0, len(path) - 1, MAX_CONES).astype(int))
        lines = LineCollection(_cones(path, ahead, reach, result)[some], cmap=SEQUENTIAL,
                               linewidths=1.2)
        lines.set_array(some)
        axes.add_collection(lines)
        axes.plot(*path[0], 'o', color=INK, markersize=4, label='first view')
        axes.set_aspect('equal')
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_xlabel('x / distance between views')
        axes.set_ylabel('y / distance between views')
        axes.set_title('Plan view')
        axes.legend(loc='best', handlelength=1.2, markerscale=2)
        bar = axes.figure.colorbar(lines, ax=axes, fraction=0.035, pad=0.02)
        bar.set_label('view')
    return Drawing('path', 'Camera path and structure', 'Seen along the rotation axis; the unit '
                   'is the root mean square distance between successive views, because images '
                   'alone tell no scale.', (figure_of(axes),), 'still')


def _finite_points(points: np.ndarray) -> np.ndarray:
    """Return the points that are not at infinity, shape (n, 3)."""
    points = np.asarray(points, float)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[np.abs(points[:, 3]) > 1e-6]
    return np.asarray(points[:, :3] / points[:, 3:])


def _window(path: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Show the path and most of the points, but not those that are far away."""
    low, high = path.min(axis=0), path.max(axis=0)
    if len(points) > 20:
        low = np.minimum(low, np.percentile(points, 6, axis=0))
        high = np.maximum(high, np.percentile(points, 94, axis=0))
    # points near infinity would make the path a dot
    extent = max(float(np.ptp(path, axis=0).max()), 1.0)
    low = np.maximum(low, path.min(axis=0) - 6 * extent)
    high = np.minimum(high, path.max(axis=0) + 6 * extent)
    margin = 0.08 * float((high - low).max())
    return low - margin, high + margin


def _cones(path: np.ndarray, ahead: np.ndarray, reach: float, result: Calibration) -> np.ndarray:
    """Return a small triangle of the field of view at every camera, shape (V, 4, 2)."""
    spread = np.clip(0.5 * result.camera.width / result.camera.K[0, 0], 0.15, 1.0)
    across = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    left = path + reach * (ahead + spread * across)
    right = path + reach * (ahead - spread * across)
    return np.stack([path, left, right, path], axis=1)
