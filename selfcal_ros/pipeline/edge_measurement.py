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
"""Edges of a known object, measured around its model in images with approximate poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.edge_rows import EdgeRows
from selfcal_ros.calibration.known_object.edge_views import EdgeViews
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.edges.edgels import find_edgels, sample_normals
from selfcal_ros.rorapid.options import ReadLines
from selfcal_ros.rorapid.visibility.visible_geometry import ControlPoints
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel

#: Control points that are measured on each line and each circle of a view.
LINE_POINTS, CONIC_POINTS = 16, 24
#: Control points that are left out at each end of a line.
END_POINTS = 2
#: Edges nearer than this to the border are not measured, pixels.
BORDER_PX = 6
#: Weakest edge that is measured, grey levels, and candidates on each normal.
CONTRAST, CANDIDATES = 5.0, 3
#: How often the line of a point is asked anew.
READ_ROUNDS = 2
#: Line delay by which displacements are differentiated where none is known, seconds.
PROBE_S = 1e-7


@dataclass(frozen=True)
class PosedImage:
    """
    One image that is kept.

    Attributes
    ----------
    index : int
    image : ndarray, shape (H, W), uint8
    rotation, translation : ndarray, shape (3, 3) and (3,)
        Of the object in the camera's frame, when the middle line is read.
    move : ndarray, shape (6,), or None
        How it turns (radians, camera axes) and shifts (metres) in a second; None where nobody
        knows, or all lines are read at once.
    line_delay_s : float
        Seconds from one line to the next, as far as is known.
    lines : {'rows', 'columns'}
        What is read one after the other.

    """

    index: int
    image: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    move: np.ndarray | None = None
    line_delay_s: float = 0.0
    lines: ReadLines = 'rows'

    def when_read(self, camera: Camera, X: np.ndarray, turned: np.ndarray,
                  line_delay_s: float) -> np.ndarray:
        """
        Move points on to where they are when their line is read.

        Parameters
        ----------
        camera : Camera
        X, turned : ndarray, shape (N, 3)
            In the camera's frame when the middle line is read, and less the translation.
        line_delay_s : float

        Returns
        -------
        ndarray, shape (N, 3)

        """
        if self.move is None:
            return X
        axis = 1 if self.lines == 'rows' else 0
        count = (camera.width, camera.height)[axis]
        a_line, moved = line_delay_s * (np.cross(self.move[:3], turned) + self.move[3:]), X
        for _ in range(READ_ROUNDS):
            late = np.clip(camera.project(moved)[:, axis] - 0.5 * (count - 1), -count, count)
            moved = X + np.nan_to_num(late)[:, None] * a_line
        return moved


def measure_edges(fine: VisibleModel, camera: Camera, views: list[PosedImage],
                  reach: int, interval_s: float | None = None) -> EdgeViews | None:
    """
    Measure the edges of all views around the model.

    Parameters
    ----------
    fine : VisibleModel
    camera : Camera
    views : list of PosedImage
    reach : int
        How far from the model an edge is looked for, pixels.
    interval_s : float, optional
        Between two images, where it is known how the object moves.

    Returns
    -------
    EdgeViews or None
        Where the edges were when the middle line was read; None where there are none.

    """
    measured = [(view, found) for view in views
                if (found := _measure(fine, camera, view, reach)) is not None]
    if len(measured) < 2:
        return None
    frames = np.concatenate([np.full(len(found[0]), view.index) for view, found in measured])
    point, primitive, points, tangents, xy, slope = (
        np.concatenate([found[k] for _, found in measured]) for k in range(6))
    poses = [np.column_stack([view.rotation, view.translation]) for view, _ in measured]
    first = measured[0][0]
    rows = None if interval_s is None or not slope.any() else EdgeRows(
        first.line_delay_s, slope, first.lines, interval_s)
    return EdgeViews(frames, point, primitive, points, tangents, xy, np.array(poses),
                     (camera.width, camera.height), rows)


def _measure(fine: VisibleModel, camera: Camera, view: PosedImage, reach: int,
             ) -> tuple[np.ndarray, ...] | None:
    """Look for edges in one image; returns columns of `EdgeViews` and the slopes, or None."""
    laid = _lay_out(fine, camera, view)
    if laid is None:
        return None
    points, index, pixels, normal, slope = laid
    edgels = find_edgels(sample_normals(view.image, pixels, normal, reach), CANDIDATES, CONTRAST)
    # the nearest, not the strongest: the poses are those of the last adjustment
    distance = np.where(np.isfinite(edgels.offset), np.abs(edgels.offset), np.inf)
    nearest = np.argmin(distance, axis=1)
    offset = edgels.offset[np.arange(len(pixels)), nearest]
    found = np.isfinite(offset) & (np.abs(offset) <= reach)
    if not found.any():
        return None
    index = index[found]
    return (points.ids[index], points.primitive[index], points.object_points[index],
            points.tangents[index],
            pixels[found] + normal[found] * offset[found, None] - view.line_delay_s * slope[found],
            slope[found])


def _lay_out(fine: VisibleModel, camera: Camera, view: PosedImage,
             ) -> tuple[ControlPoints, np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """
    Project the control points.

    Returns
    -------
    points : ControlPoints
    index : ndarray, shape (N,)
        Which are usable.
    pixels, normal : ndarray, shape (N, 2)
        When their line is read.
    slope : ndarray, shape (N, 2)
        How far they have moved since the middle line was read, pixels for every second of line
        delay.

    """
    points = fine.control_points(view.rotation, view.translation)
    kind = np.array(points.kind)[points.primitive]
    # where a silhouette lies on the object depends on the pose
    usable = points.visible & (kind != 'silhouette')
    # next to a corner the other edges bend what is measured; lines have the first numbers
    place = points.ids % LINE_POINTS
    usable &= (kind != 'line') | ((place >= END_POINTS) & (place < LINE_POINTS - END_POINTS))
    index = np.flatnonzero(usable)
    turned = points.object_points[index] @ view.rotation.T
    ahead = turned[:, 2] + view.translation[2] > 1e-6
    index, turned = index[ahead], turned[ahead]
    if not len(index):
        return None
    along = points.tangents[index] @ view.rotation.T
    still = turned + view.translation
    delay_s = view.line_delay_s or PROBE_S
    late = view.when_read(camera, still, turned, delay_s)
    slope = (camera.project(late) - camera.project(still)) / delay_s
    X = late if view.line_delay_s else still
    pixels = camera.project(X)
    run = camera.project(X + 1e-4 * X[:, 2:] * along) - pixels
    run /= np.maximum(np.linalg.norm(run, axis=1, keepdims=True), 1e-12)
    size = np.array([camera.width, camera.height])
    inside = ((pixels > BORDER_PX) & (pixels < size - 1 - BORDER_PX)).all(axis=1)
    if not inside.any():
        return None
    normal = np.column_stack([-run[:, 1], run[:, 0]])
    return points, index[inside], pixels[inside], normal[inside], slope[inside]


def edge_misfit(fine: VisibleModel, camera: Camera, views: list[PosedImage]) -> float:
    """Mean square distance of the edges from the model, none counting more than 3 px."""
    total, count = 0.0, 0
    for view in views:
        laid = _lay_out(fine, camera, view)
        if laid is None:
            continue
        edgels = find_edgels(sample_normals(view.image, laid[2], laid[3], 4), CANDIDATES, CONTRAST)
        distance = np.nanmin(np.where(np.isfinite(edgels.offset), np.abs(edgels.offset), 3.0),
                             axis=1)
        total += float(np.sum(np.minimum(distance, 3.0)**2))
        count += len(distance)
    return total / count if count else np.inf
