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
The wireframe model of an object: primitives to be tracked and opaque faces that hide them.

Lengths are metres, in the object's own frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.polygon import cut_into_triangles, newell_normal
from selfcal_ros.values.same_place import LARGEST_M, same_place

#: No model may have more vertices, lines or faces than this, and no face more corners.
LIMIT = 10_000
FACE_LIMIT = 250
#: Faces that meet under less than this angle are one plane: their common edge is no edge.
FLAT_RAD = np.deg2rad(0.5)


@dataclass(frozen=True)
class Conic:
    """
    A circle or an ellipse in space, X(t) = centre + cos t axis_u + sin t axis_v.

    Parameters
    ----------
    centre, axis_u, axis_v : array_like, shape (3,)
        The centre and two conjugate semi-axes, metres.
    name : str

    """

    centre: np.ndarray
    axis_u: np.ndarray
    axis_v: np.ndarray
    name: str = ''

    def __post_init__(self) -> None:
        """Check and freeze."""
        for key in ('centre', 'axis_u', 'axis_v'):
            object.__setattr__(self, key, _vector(getattr(self, key), f'{key} of a conic'))
        size = np.linalg.norm(self.axis_u) * np.linalg.norm(self.axis_v)
        if not np.linalg.norm(np.cross(self.axis_u, self.axis_v)) > 1e-6 * size or not size > 0:
            raise ArgumentError('The two axes of a conic must span a plane.')

    def points(self, angles: np.ndarray) -> np.ndarray:
        """Points (..., 3) at parameters (...) in radians."""
        angles = np.asarray(angles, float)[..., None]
        points: np.ndarray = (self.centre + np.cos(angles) * self.axis_u
                              + np.sin(angles) * self.axis_v)
        return points

    def tangents(self, angles: np.ndarray) -> np.ndarray:
        """Return unit tangents of shape (..., 3) at angles of shape (...) in radians."""
        angles = np.asarray(angles, float)[..., None]
        tangent = np.cos(angles) * self.axis_v - np.sin(angles) * self.axis_u
        unit: np.ndarray = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
        return unit


@dataclass(frozen=True)
class Cylinder:
    """
    A solid circular cylinder; its two silhouette lines are tracked, and it hides what is behind.

    Parameters
    ----------
    start, end : array_like, shape (3,)
        Ends of the axis, metres.
    radius_m : float
    name : str
    min_length_px : float
        The silhouette is left out while it is shorter in the image; 0: never.

    """

    start: np.ndarray
    end: np.ndarray
    radius_m: float
    name: str = ''
    min_length_px: float = 0.0

    def __post_init__(self) -> None:
        """Check and freeze."""
        for key in ('start', 'end'):
            object.__setattr__(self, key, _vector(getattr(self, key), f'{key} of a cylinder'))
        radius = float(self.radius_m)
        if not 0 < radius < LARGEST_M:
            raise ArgumentError(f'The radius of a cylinder must be positive, not {radius!r}.')
        if not np.linalg.norm(self.end - self.start) > 1e-9 * radius:
            raise ArgumentError('The two ends of a cylinder must be apart.')
        object.__setattr__(self, 'radius_m', radius)


@dataclass(frozen=True)
class Polygon:
    """
    An opaque plane face, convex or not, without holes; seen, and hiding, from both sides.

    Parameters
    ----------
    indices : sequence of int
        Vertices in order around the face, at least 3.
    name : str
    min_area_px2 : float
        Its edges are left out while it covers less of the image; 0: never.

    """

    indices: tuple[int, ...]
    name: str = ''
    min_area_px2: float = 0.0

    def __post_init__(self) -> None:
        """Freeze the indices."""
        object.__setattr__(self, 'indices', tuple(int(i) for i in self.indices))

    def borders(self) -> list[tuple[int, int]]:
        """Pairs of vertices that bound the face, in order."""
        return list(zip(self.indices, self.indices[1:] + self.indices[:1]))


@dataclass(frozen=True)
class WireframeModel:
    """
    What is known of an object: vertices, lines, conics, cylinders and opaque faces.

    Parameters
    ----------
    vertices : array_like, shape (V, 3)
    lines : array_like of int, shape (L, 2)
        All the lines to be tracked, as pairs of vertices. `build` adds the faces' borders.
    faces : sequence of Polygon
    conics : sequence of Conic
    cylinders : sequence of Cylinder
    line_names : sequence of str
        One a line; empty where there are none.
    line_min_length_px : array_like, shape (L,)
        A line is left out while it is shorter in the image; 0: never.
    name : str
    remarks : tuple of str
        What was left out of a file, or changed.

    Raises
    ------
    ArgumentError
        If an index names no vertex, a number is not finite, a face is not a simple polygon,
        or there is nothing to track.

    """

    vertices: np.ndarray
    lines: np.ndarray = ()                   # type: ignore[assignment]
    faces: tuple[Polygon, ...] = ()
    conics: tuple[Conic, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    line_names: tuple[str, ...] = ()
    line_min_length_px: np.ndarray = ()      # type: ignore[assignment]
    name: str = ''
    remarks: tuple[str, ...] = ()
    #: Faces cut into triangles, (T, 3) vertices, and the face of each, (T,).
    triangles: np.ndarray = field(init=False, repr=False, compare=False)
    triangle_face: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check and freeze."""
        vertices = np.array(self.vertices, dtype=float).reshape(-1, 3)
        lines = np.array(self.lines, dtype=int).reshape(-1, 2)
        lengths = np.array(self.line_min_length_px, dtype=float).ravel()
        lengths = lengths if lengths.size else np.zeros(len(lines))
        names = tuple(self.line_names) or ('',) * len(lines)
        if max(len(vertices), len(lines), len(self.faces), len(self.conics),
               len(self.cylinders)) > LIMIT:
            raise ArgumentError(f'A model may have at most {LIMIT} points, lines or faces.')
        if not (np.abs(vertices) < LARGEST_M).all():
            raise ArgumentError('The coordinates of a model must be finite, in metres.')
        if len(names) != len(lines) or lengths.shape != (len(lines),):
            raise ArgumentError('There must be one name and one least length for each line.')
        if ((lines < 0) | (lines >= len(vertices))).any():
            raise ArgumentError(f'A line names a point that does not exist; there are '
                                f'{len(vertices)}, counted from 0.')
        if not len(lines) + len(self.conics) + len(self.cylinders):
            raise ArgumentError('A model needs at least one line, conic or cylinder to track.')
        ends = vertices[lines]
        if (np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) <= 0).any():
            raise ArgumentError('A line of the model has no length.')
        for array in (vertices, lines, lengths):
            array.flags.writeable = False
        for key, value in (('vertices', vertices), ('lines', lines), ('line_names', names),
                           ('line_min_length_px', lengths), ('faces', tuple(self.faces)),
                           ('conics', tuple(self.conics)), ('cylinders', tuple(self.cylinders))):
            object.__setattr__(self, key, value)
        self._cut_faces()

    @classmethod
    def build(cls, vertices: ArrayLike, lines: Iterable[Sequence[int]] = (),
              faces: Sequence[Polygon] = (), line_names: Iterable[str] = (),
              line_min_length_px: Iterable[float] = (), **other: Any) -> WireframeModel:
        """
        Make a model whose lines are those given and the borders of its faces.

        An edge between two faces of one plane (a triangulated model has them) is no edge and is
        left out unless it is given. Vertices in the same place count as one.
        """
        vertices = np.array(vertices, dtype=float).reshape(-1, 3)
        lines = [tuple(int(i) for i in line) for line in lines]
        names = list(line_names) or [''] * len(lines)
        lengths = list(line_min_length_px) or [0.0] * len(lines)
        _check_faces(vertices, faces)
        same = same_place(vertices)
        known = {frozenset((same[a], same[b])) for a, b in lines
                 if 0 <= min(a, b) and max(a, b) < len(vertices)}
        for (a, b), sides in _borders(faces, same).items():
            if frozenset((a, b)) not in known and not _is_flat(vertices, faces, (a, b), sides,
                                                               same):
                lines.append((a, b))
                names.append('')
                lengths.append(0.0)
        return cls(vertices, np.array(lines, int), tuple(faces), line_names=tuple(names),
                   line_min_length_px=np.array(lengths), **other)

    def _cut_faces(self) -> None:
        """Cut the faces into triangles: (T, 3) vertices, and the face of each."""
        _check_faces(self.vertices, self.faces)
        triangles, owner = [np.zeros((0, 3), int)], [np.zeros(0, int)]
        for k, face in enumerate(self.faces):
            indices = np.array(face.indices)
            cut = cut_into_triangles(self.vertices[indices])
            if cut is None:
                raise ArgumentError(f'Face {k} crosses itself or has no area.')
            triangles.append(indices[cut])
            owner.append(np.full(len(cut), k))
        object.__setattr__(self, 'triangles', np.concatenate(triangles))
        object.__setattr__(self, 'triangle_face', np.concatenate(owner))

    @cached_property
    def line_faces(self) -> tuple[tuple[int, ...], ...]:
        """For each line the faces that it bounds: a tuple of none, one, two or more indices."""
        same = self._same
        borders = {frozenset(pair): sides
                   for pair, sides in _borders(self.faces, same).items()}
        return tuple(tuple(borders.get(frozenset((same[a], same[b])), ())) for a, b in self.lines)

    def into_face(self, line: int, face: int) -> np.ndarray:
        """Unit vector (3,) in the plane of a face, from a line that bounds it to its inside."""
        return _into(self.vertices, self.faces[face], self.lines[line], self._same)

    def same(self, vertex: int) -> np.ndarray:
        """Which vertices lie where this one does, (V,) bool."""
        same: np.ndarray = self._same == self._same[vertex]
        return same

    @cached_property
    def _same(self) -> np.ndarray:
        return same_place(self.vertices)

    @property
    def internal(self) -> np.ndarray:
        """Which lines bound no face: markings and texture, (L,) bool."""
        return np.array([not sides for sides in self.line_faces], dtype=bool)

    @cached_property
    def face_normals(self) -> np.ndarray:
        """Unit normals (F, 3), by the order of the corners."""
        normals = np.array([newell_normal(self.vertices[list(face.indices)])
                            for face in self.faces]).reshape(-1, 3)
        unit: np.ndarray = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return unit

    @cached_property
    def extent(self) -> np.ndarray:
        """Points (N, 3) that span the object: ends of lines, corners, points on round parts."""
        angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        used = np.unique(np.concatenate([self.lines.ravel(), self.triangles.ravel()]))
        parts = [self.vertices[used]] + [conic.points(angles) for conic in self.conics]
        for cylinder in self.cylinders:
            u, v = across_axes(cylinder)
            ring = cylinder.radius_m * (np.cos(angles)[:, None] * u + np.sin(angles)[:, None] * v)
            parts += [cylinder.start + ring, cylinder.end + ring]
        return np.concatenate(parts)

    @cached_property
    def centre(self) -> np.ndarray:
        """Middle of the bounding box, (3,) metres."""
        middle: np.ndarray = 0.5 * (self.extent.min(axis=0) + self.extent.max(axis=0))
        return middle

    @cached_property
    def diameter_m(self) -> float:
        """Diagonal of the bounding box."""
        return float(np.linalg.norm(np.ptp(self.extent, axis=0)))

    @property
    def is_outlined(self) -> bool:
        """Whether it is known by the outline of a curved surface: a mesh is, a wireframe not."""
        return False

    @cached_property
    def surface_net(self) -> np.ndarray:
        """Pieces (N, 2, 3) of a net over its curved surface, metres; a wireframe has none."""
        return np.zeros((0, 2, 3))

    @cached_property
    def free_turns(self) -> np.ndarray:
        """Turns (k, 6) about the middle that change nothing; none are known of a wireframe."""
        return np.zeros((0, 6))

    def edges(self) -> np.ndarray:
        """End points of the lines, (L, 2, 3) metres."""
        ends: np.ndarray = self.vertices[self.lines]
        return ends


def across_axes(cylinder: Cylinder) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3,) at right angles to a cylinder's axis and to each other."""
    axis = cylinder.end - cylinder.start
    axis = axis / np.linalg.norm(axis)
    u = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    u /= np.linalg.norm(u)
    return u, np.cross(axis, u)


def _check_faces(vertices: np.ndarray, faces: Sequence[Polygon]) -> None:
    """Raise ArgumentError on faces that name no vertex, one twice, or too many."""
    for k, face in enumerate(faces):
        indices = face.indices
        if not 3 <= len(indices) <= FACE_LIMIT:
            raise ArgumentError(f'Face {k} must have 3 to {FACE_LIMIT} points, '
                                f'not {len(indices)}.')
        if min(indices) < 0 or max(indices) >= len(vertices):
            raise ArgumentError(f'Face {k} names a point that does not exist; there are '
                                f'{len(vertices)}, counted from 0.')
        if len(set(indices)) != len(indices):
            raise ArgumentError(f'Face {k} names a point twice.')


def _borders(faces: Sequence[Polygon], same: np.ndarray) -> dict[tuple[int, int], list[int]]:
    """Faces on each border, by (vertex, vertex) as first met."""
    borders: dict[tuple[int, int], list[int]] = {}
    key: dict[frozenset[int], tuple[int, int]] = {}
    for k, face in enumerate(faces):
        for a, b in face.borders():
            a, b = int(same[a]), int(same[b])
            if a != b:
                pair = key.setdefault(frozenset((a, b)), (a, b))
                borders.setdefault(pair, []).append(k)
    return borders


def _into(vertices: np.ndarray, face: Polygon, line: Sequence[int] | np.ndarray, same: np.ndarray,
          ) -> np.ndarray:
    """Direction from a border of a face to its inside, (3,), unit."""
    a, b = same[list(line)]
    indices = same[list(face.indices)]
    forward = ((indices == a) & (np.roll(indices, -1) == b)).any()
    along = vertices[b] - vertices[a] if forward else vertices[a] - vertices[b]
    into = np.cross(newell_normal(vertices[list(face.indices)]), along)
    # a face without area is refused later on
    unit: np.ndarray = into / max(np.linalg.norm(into), 1e-300)
    return unit


def _is_flat(vertices: np.ndarray, faces: Sequence[Polygon], line: tuple[int, int],
             sides: list[int], same: np.ndarray) -> bool:
    """Whether an edge lies between two faces that go on from each other in one plane."""
    if len(sides) != 2:
        return False
    first, second = (_into(vertices, faces[k], line, same) for k in sides)
    return bool(np.linalg.norm(first + second) < FLAT_RAD)


def _vector(value: ArrayLike, what: str) -> np.ndarray:
    """Three finite numbers, frozen."""
    vector = np.array(value, dtype=float).ravel()
    if vector.shape != (3,) or not (np.abs(vector) < LARGEST_M).all():
        raise ArgumentError(f'The {what} must be three finite numbers in metres.')
    vector.flags.writeable = False
    return vector
