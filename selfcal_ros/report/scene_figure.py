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
"""The scene as a still picture: for print, and for readers that run no scripts."""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.collections import LineCollection
import numpy as np

from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.report.scene import Scene
from selfcal_ros.report.style import (Drawing, figure_of, GREY, INK, new_panel, PALE, SEQUENTIAL,
                                      styled)

#: The eye is behind the cameras, turned by this and above them by that, as in the viewer.
TURN_RAD, PITCH_RAD = 0.5, 0.6
#: More cameras than this hide each other.
MAX_CAMERAS = 30


def scene_figure(scene: Scene) -> Drawing:
    """
    Draw the scene in perspective, from behind and above.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Drawing

    """
    R = scene.cam_from_world[:, :, :3]
    centres = camera_centres(scene.cam_from_world)
    low, high = centres.min(axis=0), centres.max(axis=0)
    if len(scene.points):
        low = np.minimum(low, np.percentile(scene.points, 6, axis=0))
        high = np.maximum(high, np.percentile(scene.points, 94, axis=0))
    size = max(float(np.linalg.norm(high - low)), 1e-9)
    project = _eye((low + high) / 2, size, R[:, 2].mean(axis=0))
    floor = float(centres[:, 2].min() + centres[:, 2].max()) / 2 if scene.path else 0.0
    near = ((scene.points >= low) & (scene.points <= high)).all(axis=1)
    with styled():
        axes = new_panel(3.6)
        axes.add_collection(LineCollection(list(project(_grid(low, high, size / 12, floor))),
                                           colors=PALE, linewidths=0.7))
        axes.plot(*project(scene.points[near]).T, '.', color=GREY, markersize=2.4,
                  markeredgewidth=0, rasterized=True)
        if scene.path:
            axes.plot(*project(centres).T, color=INK, linewidth=0.9)
            axes.plot(*project(centres[:1]).T, 'o', color=INK, markersize=3.5)
        some = np.unique(np.linspace(0, len(R) - 1, MAX_CAMERAS).astype(int))
        reach = max(min(0.035 * size, 1.6 if scene.path else size), 0.014 * size)
        cameras = LineCollection(
            list(project(_pyramids(centres[some], R[some], reach, scene.corners))),
            cmap=SEQUENTIAL, linewidths=0.9)
        cameras.set_array(some)
        axes.add_collection(cameras)
        axes.autoscale_view()
        axes.set_aspect('equal')
        axes.set_axis_off()
    what = 'the path and the structure' if scene.path else 'the views of the object'
    return Drawing('still', 'The scene', f'In perspective: {what}, from behind and above.',
                   (figure_of(axes),), 'still')


def _eye(middle: np.ndarray, size: float, ahead: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return what projects points (..., 3) to a picture (..., 2)."""
    yaw = np.arctan2(ahead[1], ahead[0]) + TURN_RAD
    c, s, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(PITCH_RAD), np.sin(PITCH_RAD)
    axes = np.array([[s, -c, 0], [sp * c, sp * s, cp], [cp * c, cp * s, -sp]])
    eye = middle - 1.5 * size * axes[2]

    def project(points: np.ndarray) -> np.ndarray:
        x = (np.asarray(points) - eye) @ axes.T
        return np.asarray(x[..., :2] / np.maximum(x[..., 2:], 0.05 * size))

    return project


def _grid(low: np.ndarray, high: np.ndarray, step: float, floor: float) -> np.ndarray:
    """Return the lines of a square grid on the floor, shape (n, 2, 3)."""
    power = 10.0 ** np.floor(np.log10(step))
    step = power * next(m for m in (1, 2, 5, 10) if m * power >= 0.999 * step)
    (x0, y0), (x1, y1) = step * np.floor(low[:2] / step), step * np.ceil(high[:2] / step)
    x, y = (np.arange(a, b + step / 2, step) for a, b in ((x0, x1), (y0, y1)))
    lines = [[(u, y0, floor), (u, y1, floor)] for u in x]
    return np.array(lines + [[(x0, v, floor), (x1, v, floor)] for v in y])


def _pyramids(centres: np.ndarray, R: np.ndarray, reach: float, corners: np.ndarray) -> np.ndarray:
    """Return each camera's field of view as one stroke, shape (V, 10, 3)."""
    rays = reach * np.column_stack([corners, np.ones(4)])
    ends = np.einsum('vji,cj->vci', R, rays) + centres[:, None]
    whole = np.concatenate([centres[:, None], ends], axis=1)
    # through the apex and all four corners, without lifting the pen
    return whole[:, [0, 1, 2, 0, 3, 4, 0, 3, 2, 1, 4]]
