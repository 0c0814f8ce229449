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
"""Plane polygons in space: their normal, whether they are usable, and their triangles."""

from __future__ import annotations

import numpy as np


def newell_normal(points: np.ndarray) -> np.ndarray:
    """
    Area vector of a polygon: along the normal, as long as the area.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        Corners in order, counter-clockwise seen from where the normal points to.

    Returns
    -------
    ndarray, shape (3,)

    """
    points = points - points[0]
    area: np.ndarray = 0.5 * np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    return area


def plane_coordinates(points: np.ndarray) -> np.ndarray:
    """Coordinates (N, 2) of corners (N, 3) in the polygon's plane, counter-clockwise."""
    normal = newell_normal(points)
    normal = normal / np.linalg.norm(normal)
    across = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    across /= np.linalg.norm(across)
    xy: np.ndarray = (points - points[0]) @ np.column_stack([across, np.cross(normal, across)])
    return xy


def cut_into_triangles(points: np.ndarray) -> np.ndarray | None:
    """
    Cut a simple polygon, convex or not, into triangles by clipping ears.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        Corners in order; three of them in a row may lie on one line.

    Returns
    -------
    ndarray of int, shape (T, 3), or None
        Indices of corners; None where the polygon crosses itself or has no area.

    """
    span = np.linalg.norm(points - points[0], axis=1).max()
    area = np.linalg.norm(newell_normal(points))
    if not area > 1e-9 * span * span:
        return None
    xy = plane_coordinates(points) / span
    left, found = list(range(len(xy))), []
    while len(left) > 3:
        ear = _best_ear(xy, left)
        if ear is None:
            return None
        found.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    triangles = np.array([*found, left])
    a, b, c = (xy[triangles[:, k]] for k in range(3))
    areas = 0.5 * _cross(b - a, c - a)
    whole = areas > 1e-12
    # a polygon that crosses itself is not covered by its ears
    if abs(areas.sum() - area / span**2) > 1e-6 or areas.min() < -1e-9:
        return None
    covered: np.ndarray = triangles[whole]
    return covered


def _best_ear(xy: np.ndarray, left: list[int]) -> int | None:
    """Index in `left` of the ear with the largest smallest angle, None where there is none."""
    corner = xy[left]
    before, after = np.roll(corner, 1, axis=0), np.roll(corner, -1, axis=0)
    turn = _cross(corner - before, after - corner)
    quality = turn / (np.linalg.norm(corner - before, axis=1)
                      * np.linalg.norm(after - corner, axis=1) + 1e-300)
    best = None
    for k in np.argsort(-quality):
        if turn[k] < -1e-12:
            break
        a, b, c = before[k], corner[k], after[k]
        inside = ((_cross(b - a, corner - a) > -1e-12) & (_cross(c - b, corner - b) > -1e-12)
                  & (_cross(a - c, corner - c) > -1e-12))
        # the ear's own corners, and others in the same places, do not spoil it
        own = _same(corner, a) | _same(corner, b) | _same(corner, c)
        if not (inside & ~own).any():
            best = int(k)
            break
    return best


def _same(points: np.ndarray, point: np.ndarray) -> np.ndarray:
    same: np.ndarray = np.abs(points - point).max(axis=1) < 1e-12
    return same


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Third component of the cross product of plane vectors (..., 2)."""
    third: np.ndarray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return third
