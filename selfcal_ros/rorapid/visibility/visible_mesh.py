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
What a mesh shows from a pose: creases, and the outline of its round parts.

The rim of a round part is where the surface turns away: n . (X - c) = 0 with the normal n between
those of the smooth vertices. On each edge of the mesh where it changes its sign lies a point of
the rim; the image of the rim runs along n x (X - c) there. What hides what is found with a coarse
depth buffer. Where the background begins beside it, the rim is an outline. Where a round part
turns away before another one, as a handle does before its mug, an edge may be seen: it is searched
as well, in fewer places. Nothing is concluded where none is found, as one grey of the object may
meet the same grey.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.rorapid.visibility.depth_buffer import DepthBuffer
from selfcal_ros.rorapid.visibility.visible_geometry import ControlPoints, VisibleGeometry
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.wireframe import WireframeModel

#: Places on the outline, and of these so many make a primitive.
OUTLINE_POINTS, _TOGETHER = 108, 6
#: Places where a round part turns away before another one.
_INNER = 36
#: Points on the surface that fill the depth buffer.
_SURFACE_POINTS = 20_000
#: What is nearer than this share of the diameter hides: the surface itself bends away.
_NEARER = 0.06
#: What is wider than so many images is nearly at the camera, or behind it.
_WIDEST = 4
#: A crease is a line in the image where its control points are so far apart, share of diameter.
_APART = 0.04


def visible_of(model: WireframeModel, per_line: int, per_conic: int,
               outline: int | None = None) -> VisibleGeometry:
    """Return what a model shows: of a mesh with so many places on its outline."""
    # the one place that asks for the kind of model: here it is chosen what stands for it
    if isinstance(model, MeshModel):
        return VisibleMesh(model, outline or OUTLINE_POINTS)
    return VisibleModel(model, per_line, per_conic)


class VisibleMesh:
    """
    A mesh with control points on its creases and its outline; a `SurfaceGeometry`.

    Parameters
    ----------
    model : MeshModel
    outline_points : int
        Places on the outline.

    """

    def __init__(self, model: MeshModel, outline_points: int = OUTLINE_POINTS):
        """Lay out points on creases and on the surface."""
        self.model = model
        ends = model.edges()
        span = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(span, axis=1)
        step = _APART * model.diameter_m
        # short pieces of a long crease have a point now and then
        counts = np.maximum(np.rint(length / step).astype(int), 0)
        if len(length) and counts.sum() < len(length) / 2:
            counts = (np.cumsum(length) // step - (np.cumsum(length) - length) // step).astype(int)
        line = np.repeat(np.arange(len(length)), counts)
        place = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
        share = (place + 0.5) / np.maximum(counts[line], 1)
        self._points = ends[line, 0] + share[:, None] * span[line]
        self._tangents = span[line] / np.maximum(length[line], 1e-300)[:, None]
        self._sides = model.line_sides[line]
        groups = -(-outline_points // _TOGETHER)
        self._outline = groups * _TOGETHER
        inner = _INNER // _TOGETHER
        self.primitive = np.concatenate([line, len(length) + np.repeat(
            np.arange(inner + groups), _TOGETHER)])
        self.kind = ('line',) * len(length) + ('rim',) * inner + ('contour',) * groups
        self.names = tuple(f'{kind} {k}' for k, kind in enumerate(self.kind))
        self.size = len(self.primitive)
        self.counts = np.concatenate([counts, np.full(inner + groups, _TOGETHER)])
        #: Rims before other parts of the object, then the outline.
        self.outline, self.limb = len(length), len(length) + inner
        end_m = np.minimum(share, 1 - share) * length[line]
        self.end_m = np.concatenate([end_m, np.full(_INNER + self._outline, np.inf)])
        self.bends = np.zeros((self.size, 3))
        corners = model.vertices[model.triangles]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2]
                                       - corners[:, 0]), axis=1)
        # a regular share of points to each face by its area; the same at every start
        many = np.diff(np.floor(np.concatenate([[0], np.cumsum(area)]) / area.sum()
                                * _SURFACE_POINTS)).astype(int)
        owner = np.repeat(np.arange(len(area)), many)
        u, v = (np.modf(np.arange(len(owner)) * ratio)[0] for ratio in (0.7548777, 0.5698403))
        over = u + v > 1
        u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
        self._surface = corners[owner, 0] + u[:, None] * (
            corners[owner, 1] - corners[owner, 0]) + v[:, None] * (
            corners[owner, 2] - corners[owner, 0])
        # coordinates in rows: a sum or a minimum over thousands of points is ten times as fast
        self._surface_rows = np.ascontiguousarray(self._surface.T)
        # of the two faces beside each place on a crease, and of the smooth vertices
        self._side_normals = model.normals[self._sides]
        self._side_heights = (self._side_normals * self._points[:, None]).sum(axis=2)
        self._normals, self._places = model.smooth_normals, model.smooth_points
        self._heights = (self._normals * self._places).sum(axis=1)
        self._first, self._second = (np.ascontiguousarray(ends) for ends in model.smooth_edges.T)

    @property
    def surface(self) -> VisibleMesh:
        """The mesh itself is a curved surface."""
        return self

    @property
    def faceted(self) -> None:
        """It is not made of plane faces."""
        return None

    def nearest_in(self, other: VisibleGeometry) -> np.ndarray:
        """Return the number of the control point in another layout; the layouts are alike."""
        return np.arange(self.size)

    def remembered(self) -> np.ndarray:
        """Which control points stay where they are on the object, (size,) bool."""
        return np.arange(self.size) < len(self._points)

    def control_points(self, rotation: ArrayLike, translation: ArrayLike,
                       focal_px: float | None = None) -> ControlPoints:
        """
        Control points that are seen from a pose.

        Parameters
        ----------
        rotation : ndarray, shape (3, 3)
        translation : ndarray, shape (3,)
        focal_px : float, optional
            Not used.

        Returns
        -------
        ControlPoints

        """
        rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
        centre = -translation @ rotation
        sides = self._side_normals @ centre > self._side_heights
        rim, tangents, normals = self._rim(centre)
        buffer = DepthBuffer(rotation @ self._surface_rows + translation[:, None])
        nearer = _NEARER * self.model.diameter_m
        placed = rotation @ self._points.T + translation[:, None]
        crease = sides.any(axis=1) & ~buffer.hides(placed, nearer)
        lone = np.flatnonzero(crease & ~sides.all(axis=1))
        lone = lone[buffer.ends_beside(
            placed[:, lone], rotation @ self._side_normals[lone].sum(axis=1).T)]
        seen = rotation @ rim.T + translation[:, None]
        near = np.flatnonzero(~buffer.hides(seen, nearer))
        out = rotation @ normals[near].T
        ends = buffer.ends_beside(seen[:, near], out)
        chosen = self._spread(seen[:, near[ends]].T, near[ends], self._outline)
        inner = near[buffer.farther_beside(seen[:, near], out, nearer)]
        inner = self._spread(seen[:, inner].T, inner, _INNER)
        at = np.zeros(_INNER + self._outline, int)
        at[:len(inner)] = inner
        at[_INNER:_INNER + len(chosen)] = chosen
        if not len(rim):
            rim, tangents, normals = centre[None] * 0, np.eye(3)[:1], np.eye(3)[:1]
        visible = np.concatenate([crease, np.arange(_INNER) < len(inner),
                                  np.arange(self._outline) < len(chosen)])
        kept = np.flatnonzero(visible)
        # an outline is convex across: the object lies against the mean of the two normals
        bent = np.zeros((len(self._points), 3))
        bent[lone] = -self._side_normals[lone].sum(axis=1)
        inward = np.concatenate([bent, np.zeros((_INNER, 3)), -normals[at[_INNER:]]])[kept]
        both = np.concatenate([self._points, rim[at]])[kept]
        slopes = np.concatenate([self._tangents, tangents[at]])[kept]
        return ControlPoints(both, slopes, self.primitive[kept], np.ones(len(kept), bool), kept,
                             inward, self.kind, self.names)

    def _rim(self, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points, tangents and normals (N, 3) where smooth parts turn away from a camera."""
        away = self._heights - self._normals @ centre
        back = away < 0
        turning = np.flatnonzero(back[self._first] != back[self._second])
        a, b = self._first[turning], self._second[turning]
        share = (away[a] / (away[a] - away[b]))[:, None]
        points = (1 - share) * self._places[a] + share * self._places[b]
        normals = (1 - share) * self._normals[a] + share * self._normals[b]
        tangents = np.cross(normals, points - centre)
        length = np.linalg.norm(tangents, axis=1, keepdims=True)
        return points, tangents / np.maximum(length, 1e-300), normals

    def mask(self, rotation: ArrayLike, translation: ArrayLike, shape: tuple[int, int],
             place: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """
        Mask of the object in an image, roughly: its surface's points, joined.

        Parameters
        ----------
        rotation : ndarray, shape (3, 3)
        translation : ndarray, shape (3,)
        shape : (int, int)
            Rows and columns.
        place : callable
            Pixels (N, 2) of points (N, 3) of the object frame.

        Returns
        -------
        ndarray of uint8, shape `shape`
            255 on the object; nothing where it is so near that it would fill several images.

        """
        mask = np.zeros(shape, np.uint8)
        places = np.rint(place(self._surface))
        span = np.ptp(places, axis=0)
        if not (span < _WIDEST * max(shape)).all():
            return mask
        pixels = places.astype(int)
        inside = ((pixels >= 0) & (pixels < shape[::-1])).all(axis=1)
        mask[pixels[inside, 1], pixels[inside, 0]] = 255
        # half of the points are on the far side; gaps are closed to twice their usual distance
        gap = 2 * int(np.ceil(np.sqrt(2 * span.prod() / len(self._surface)))) + 1
        return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((gap, gap), np.uint8))

    def behind(self, points: np.ndarray, rotation: np.ndarray,
               translation: np.ndarray) -> np.ndarray:
        """Which points (N, 3) lie behind the surface, by the depth buffer, (N,) bool."""
        buffer = DepthBuffer(rotation @ self._surface_rows + translation[:, None])
        return buffer.hides(rotation @ points.T + translation[:, None],
                            _NEARER * self.model.diameter_m)

    def _spread(self, seen: np.ndarray, keep: np.ndarray, most: int) -> np.ndarray:
        """Choose at most so many places (N, 3, camera frame), spread evenly around the object."""
        order = self._around(seen)
        if len(keep) <= most:
            kept: np.ndarray = keep[order]
            return kept
        xy = (seen[:, :2] / seen[:, 2:])[order]
        step = np.minimum(np.linalg.norm(np.diff(xy, axis=0, prepend=xy[-1:]), axis=1),
                          4 * np.ptp(xy, axis=0).max() / len(xy))
        along = np.cumsum(step)
        pick = np.searchsorted(along, (np.arange(most) + 0.5) / most * along[-1])
        chosen: np.ndarray = keep[order[np.unique(np.minimum(pick, len(order) - 1))]]
        return chosen

    @staticmethod
    def _around(seen: np.ndarray) -> np.ndarray:
        xy = seen[:, :2] / seen[:, 2:]
        middle = 0.5 * (xy.min(axis=0) + xy.max(axis=0)) if len(xy) else np.zeros(2)
        return np.argsort(np.arctan2(*(xy - middle).T[::-1]), kind='stable')
