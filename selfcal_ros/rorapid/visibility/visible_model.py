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
Which primitives can be seen, and the control points on them.

A point X is hidden by a triangle with corners A, B, C where the ray from the camera's centre c
meets the triangle first: X - c = l1 (A - c) + l2 (B - c) + l3 (C - c) with no l negative and l1 +
l2 + l3 > 1. This needs no image plane and no orientation of the faces. It is exact for every set
of plane faces, convex or not, closed or open.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.rorapid.visibility.silhouettes import SolidCylinders
from selfcal_ros.rorapid.visibility.visible_geometry import ControlPoints, VisibleGeometry
from selfcal_ros.values.wireframe import WireframeModel

#: A primitive that lies in the plane of a face up to this share of the object's diameter is
#: drawn on the face, not behind it.
ON_FACE = 5e-4
#: No model may have more control points times triangles.
MAX_TESTS = 50_000_000
#: Numbers in the largest array that the test may make.
_LARGEST = 2_000_000
#: Coordinates after and before x, y, z in turn.
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def check_size(model: WireframeModel, control_points_per_line: int, per_conic: int) -> None:
    """
    Refuse what would take too long: every control point is tested against every triangle.

    Raises
    ------
    ArgumentError
        If there were more than `MAX_TESTS` tests.

    """
    if model.is_outlined:
        return                        # its depth buffer takes the same time whatever it is made of
    points = control_points_per_line * len(model.lines) + per_conic * len(model.conics)
    if points * len(model.triangles) > MAX_TESTS:
        raise ArgumentError(f'{points} control points and {len(model.triangles)} triangles are '
                            'too many to be tested; simplify the model, or use fewer points.')


class VisibleModel:
    """
    A model with control points on its primitives.

    Primitives are numbered: first the lines, then the conics, then two silhouettes a cylinder.

    Parameters
    ----------
    model : WireframeModel
    control_points_per_line, per_conic : int
        Control points on each line or silhouette, and on each conic.
    min_visible : int
        A primitive with fewer visible control points is left out.
    min_length_px : float
        A line or silhouette that is shorter in the image is left out, if the focal length is told.

    Raises
    ------
    ArgumentError
        If there were a primitive without control points, or the model is too large.

    """

    def __init__(self, model: WireframeModel, control_points_per_line: int = 6,
                 per_conic: int = 10, min_visible: int = 1, min_length_px: float = 0.0):
        """Lay out the control points."""
        if control_points_per_line < 1 or per_conic < 1:
            raise ArgumentError('There must be at least one control point on each primitive.')
        check_size(model, control_points_per_line, per_conic)
        self.model = model
        self.min_visible = int(min_visible)
        n = int(control_points_per_line)
        L, K, S = len(model.lines), len(model.conics), 2 * len(model.cylinders)
        self.kind = ('line',) * L + ('conic',) * K + ('silhouette',) * S
        self.names = tuple(
            given or f'{kind} {index}' for given, kind, index in zip(
                model.line_names + tuple(c.name for c in model.conics)
                + tuple(f'{c.name} {side}' if c.name else ''
                        for c in model.cylinders for side in ('left', 'right')),
                self.kind, [*range(L), *range(K), *range(S)]))
        share = (np.arange(n) + 0.5) / n
        ends = model.edges()
        span = ends[:, 1] - ends[:, 0]
        angles = (np.arange(per_conic) + 0.5) * 2 * np.pi / per_conic
        conics = [c.points(angles) for c in model.conics]
        slopes = [c.tangents(angles) for c in model.conics]
        along = span / np.linalg.norm(span, axis=1, keepdims=True)
        self._points = np.concatenate(
            [(ends[:, :1] + share[:, None] * span[:, None]).reshape(-1, 3), *conics])
        self._tangents = np.concatenate([np.repeat(along, n, axis=0), *slopes])
        #: Control points of each primitive, (P,).
        self.counts = np.array([n] * L + [per_conic] * K + [n] * S)
        #: Primitive of each control point, (size,).
        self.primitive = np.repeat(np.arange(L + K + S), self.counts)
        self._first = np.concatenate([[0], np.cumsum(self.counts)[:-1]]).astype(int)
        self._static = len(self._points)
        #: Number of all control points.
        self.size = len(self.primitive)
        lengths = np.r_[np.linalg.norm(span, axis=1), np.repeat(
            [np.linalg.norm(np.subtract(c.end, c.start)) for c in model.cylinders], 2)]
        ends_m = np.minimum(share, 1 - share) * lengths[:, None]
        bends = np.zeros((len(self.primitive), 3))
        #: Curvature vectors of conics, per metre, up to a part along the tangent, (size, 3).
        self.bends = bends
        for k, conic in enumerate(model.conics):
            part = slice(L * n + k * per_conic, L * n + (k + 1) * per_conic)
            speed = np.outer(np.cos(angles), conic.axis_v) - np.outer(np.sin(angles), conic.axis_u)
            bends[part] = (conic.centre - conics[k]) / (speed**2).sum(axis=1, keepdims=True)
        #: Distance of each control point from the nearer end of its line, (size,).
        self.end_m = np.concatenate([ends_m[:L].ravel(), np.full(K * per_conic, np.inf),
                                     ends_m[L:].ravel()])
        self._corners = model.vertices[model.triangles]
        self._middle = np.asarray(model.centre, float)
        around = self._corners - self._middle
        self._radius = float(np.abs(around).max(initial=0.0))
        following, last = (np.roll(around, -k, axis=1) for k in (1, 2))
        #: Of each corner of each triangle, (3, T, 3): product and difference of the other two.
        self._across = np.cross(following, last).swapaxes(0, 1)
        self._spans = (last - following).swapaxes(0, 1)
        self._on_face = self._drawn_on(ends)
        self._solids = SolidCylinders(model.cylinders, n, model.diameter_m) \
            if model.cylinders else None
        #: Primitives from this on are pieces of rims: none.
        self.outline = len(self.kind)
        #: Primitives from this on are limbs of round parts.
        self.limb = L + K
        self._ends, self._L, self._line = ends, L, n
        self._has_min_area = any(face.min_area_px2 > 0 for face in model.faces)
        of_cylinders = np.repeat([c.min_length_px for c in model.cylinders], 2)
        self._min_length = np.concatenate([
            np.maximum(model.line_min_length_px, min_length_px), np.zeros(K),
            np.maximum(of_cylinders, min_length_px)])
        self._has_thresholds = self._has_min_area or bool(self._min_length.any())
        self._sides = self._contour_sides()

    def _drawn_on(self, ends: np.ndarray) -> np.ndarray:
        """For each static control point and each triangle: does the one lie in the other."""
        model = self.model
        normals = model.face_normals[model.triangle_face]
        offset = (normals * self._corners[:, 0]).sum(axis=1)
        spans = [ends, *(c.points(np.linspace(0, 2 * np.pi, 8))[None] for c in model.conics)]
        worst = np.concatenate([np.abs(part @ normals.T - offset).max(axis=1) for part in spans])
        return np.repeat(worst < ON_FACE * model.diameter_m, self.counts[:len(worst)], axis=0)

    def _contour_sides(self) -> np.ndarray:
        """Directions (L, K, 3) from each line into its faces; the first is repeated."""
        faces = self.model.line_faces
        sides = np.zeros((self._L, max([2, *map(len, faces)]), 3))
        for k, around in enumerate(faces):
            if around:
                sides[k] = self.model.into_face(k, around[0])
            for j, face in enumerate(around[1:], start=1):
                sides[k, j] = self.model.into_face(k, face)
        return sides

    @property
    def surface(self) -> None:
        """All faces are plane: there is no curved surface."""
        return None

    @property
    def faceted(self) -> VisibleModel:
        """The model itself is made of plane faces."""
        return self

    def remembered(self) -> np.ndarray:
        """Which control points stay where they are on the object, (size,) bool."""
        return np.ones(self.size, bool)

    def resting_points(self) -> np.ndarray:
        """Control points (size, 3) of lines and conics; on silhouettes a point of the axis."""
        axes = [0.5 * np.add(c.start, c.end) for c in self.model.cylinders]
        return np.concatenate([self._points, np.repeat(np.reshape(axes, (-1, 3)), 2 * self._line,
                                                       axis=0)])

    @property
    def free_points(self) -> np.ndarray:
        """Which control points are on no line between vertices, (size,) bool."""
        return np.arange(self.size) >= self._L * self._line

    def carried(self, shifts: np.ndarray) -> np.ndarray:
        """Carry shifts of the vertices (V, 3) to the control points of the lines, (size, 3)."""
        out = np.zeros((self.size, 3))
        share = ((np.arange(self._line) + 0.5) / self._line)[:, None]
        a, b = np.moveaxis(shifts[self.model.lines], 1, 0)
        out[:self._L * self._line] = ((1 - share) * a[:, None] + share * b[:, None]).reshape(-1, 3)
        return out

    def nearest_in(self, other: VisibleGeometry) -> np.ndarray:
        """Return the number of the control point in another layout that lies nearest to each."""
        primitive, first = self.primitive, np.cumsum(other.counts) - other.counts
        place = np.arange(self.size) - self._first[primitive] + 0.5
        along = place / self.counts[primitive] * other.counts[primitive]
        points: np.ndarray = first[primitive] + along.astype(int)
        return points

    def hidden(self, points: np.ndarray, centre: np.ndarray, on_face: np.ndarray | None = None,
               triangles: np.ndarray | None = None) -> np.ndarray:
        """
        Tell which points are hidden by the faces.

        Parameters
        ----------
        points : ndarray, shape (N, 3)
            Object frame.
        centre : ndarray, shape (3,)
            Centre of the camera, object frame.
        on_face : ndarray of bool, shape (N, T), optional
            Triangles that are not to be tested, for each point.
        triangles : ndarray of int, optional
            Triangles to be tested; all of them by default.

        Returns
        -------
        ndarray of bool, shape (N,)

        """
        hidden = np.zeros(len(points), bool)
        rays = points - centre
        chosen = slice(None) if triangles is None else triangles
        if triangles is not None:
            on_face = on_face if on_face is None else on_face[:, triangles]
        here = centre - self._middle
        # with corners a, b, c as the camera sees them: b x c, which is linear in its place
        cofactors = self._across[:, chosen] + self._spans[:, chosen] @ cross_matrix(here)
        apart = self._corners[chosen, 0] - centre
        volume = (apart * cofactors[0]).sum(axis=1)
        size = self._radius + math.sqrt(here @ here)
        edge_on = np.abs(volume) < 1e-12 * size**3
        volume[edge_on] = 1.0
        cofactors /= volume[:, None]
        chunk = max(1, _LARGEST // max(1, 3 * len(points)))
        for start in range(0, len(volume), chunk):
            part = cofactors[:, start:start + chunk]
            a, b, c = rays @ part.swapaxes(1, 2)
            behind = np.minimum(np.minimum(a, b), c) > -1e-9
            behind &= a + b + c > 1 + 1e-9
            behind &= ~edge_on[start:start + chunk]
            if on_face is not None:
                behind &= ~on_face[:, start:start + chunk]
            hidden |= behind.any(axis=1)
        return hidden

    def behind(self, points: np.ndarray, rotation: np.ndarray,
               translation: np.ndarray) -> np.ndarray:
        """Which points (N, 3) lie behind faces or cylinders; those on them do not, (N,) bool."""
        centre = -translation @ rotation
        rays = centre - points
        length = np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-300)
        points = points + ON_FACE * self.model.diameter_m * rays / length
        hidden = self.hidden(points, centre)
        if self._solids is not None:
            hidden |= self._solids.hidden(points, centre)
        return hidden

    def control_points(self, rotation: ArrayLike, translation: ArrayLike,
                       focal_px: float | None = None) -> ControlPoints:
        """
        Control points of the primitives that are seen from a pose.

        Parameters
        ----------
        rotation : ndarray, shape (3, 3)
        translation : ndarray, shape (3,)
            The pose: object -> camera optical frame, metres.
        focal_px : float, optional
            Focal length; with it, what is too small in the image for the model's thresholds is
            left out.

        Returns
        -------
        ControlPoints

        """
        rotation = np.asarray(rotation, float)
        centre = -np.asarray(translation, float) @ rotation
        points, tangents = self._points, self._tangents
        hidden = self._hidden_static(centre)
        if self._solids is not None:
            hidden |= self._solids.hidden(points, centre)
            extra, slopes, exist = self._solids.silhouettes(centre)
            behind = self.hidden(extra, centre) | ~exist
            behind |= self._solids.hidden(extra, centre, own=True)
            points = np.concatenate([points, extra])
            tangents = np.concatenate([tangents, slopes])
            hidden = np.concatenate([hidden, behind])
        visible = ~hidden & ((points - centre) @ rotation[2] > 0)
        seen = np.add.reduceat(visible, self._first) >= self.min_visible
        if focal_px is not None and self._has_thresholds:
            seen &= self._large_enough(rotation, np.asarray(translation, float), focal_px)
        keep = np.flatnonzero(seen[self.primitive])
        primitive = self.primitive[keep]
        return ControlPoints(points[keep], tangents[keep], primitive, visible[keep],
                             keep, self._inward(centre, points, keep), self.kind, self.names)

    def _hidden_static(self, centre: np.ndarray) -> np.ndarray:
        """Which points of lines and conics the faces hide from a camera there, (N,) bool."""
        return self.hidden(self._points, centre, self._on_face)

    def _large_enough(self, rotation: np.ndarray, translation: np.ndarray, focal_px: float,
                      ) -> np.ndarray:
        """Which primitives are long enough in the image, on a large enough face, (P,) bool."""
        def place(points: np.ndarray) -> np.ndarray:
            seen = points @ rotation.T + translation
            xy: np.ndarray = focal_px * seen[..., :2] / np.maximum(
                seen[..., 2:], 1e-3 * self.model.diameter_m)
            return xy

        xy, length = place(self.model.vertices), np.full(len(self.kind), np.inf)
        span = xy[self.model.lines[:, 1]] - xy[self.model.lines[:, 0]]
        length[:self._L] = np.hypot(*span.T)
        if self.model.cylinders:
            axes = place(np.array([(c.start, c.end) for c in self.model.cylinders]))
            length[self.limb:] = np.repeat(np.hypot(*(axes[:, 1] - axes[:, 0]).T), 2)
        enough: np.ndarray = length >= self._min_length
        if self._has_min_area:
            a, b, c = np.moveaxis(xy[self.model.triangles], 1, 0)
            b, c = b - a, c - a
            area = np.bincount(self.model.triangle_face, 0.5 * np.abs(
                b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]), len(self.model.faces))
            large = area >= [face.min_area_px2 for face in self.model.faces]
            enough[:self._L] &= [not sides or large[list(sides)].any()
                                 for sides in self.model.line_faces]
        return enough

    def _inward(self, centre: np.ndarray, points: np.ndarray, keep: np.ndarray) -> np.ndarray:
        """Directions into the object where faces are seen on one side only, (C, 3)."""
        of_primitive = np.zeros((len(self.kind), 3))
        if self._L:
            view = _cross(self._ends[:, 0] - centre, self._ends[:, 1] - centre)
            side = (self._sides * view[:, None]).sum(axis=2)
            contour = side.min(axis=1) * side.max(axis=1) > 0
            of_primitive[:self._L] = np.where(contour[:, None], self._sides[:, 0], 0.0)
        primitive = self.primitive[keep]
        inward: np.ndarray = of_primitive[primitive]
        if self._solids is not None:
            round_part = np.flatnonzero(keep >= self._static)
            inward[round_part] = self._solids.towards_axis(points[keep[round_part]], (
                keep[round_part] - self._static) // (2 * self._line))
        return inward


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of rows (N, 3); numpy's own is slow on small arrays."""
    cross: np.ndarray = (a.take(_NEXT, 1) * b.take(_LAST, 1)
                         - a.take(_LAST, 1) * b.take(_NEXT, 1))
    return cross
