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
A triangle mesh as a model to track: its creases are lines, its round parts have outlines.

What cannot be used is left out with a remark: faces without area, faces given twice. A mesh of
more faces than are needed is simplified.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.phrase import put_in_words
from selfcal_ros.values.mesh_orientation import (
    borders, edges_of, face_normals, oriented, unit)
from selfcal_ros.values.mesh_simplified import simplified
from selfcal_ros.values.mesh_symmetry import free_turns
from selfcal_ros.values.same_place import LARGEST_M, same_place
from selfcal_ros.values.wireframe import WireframeModel

#: Faces that meet under more than this angle meet in a crease.
CREASE_RAD = np.deg2rad(30.0)
#: A crease runs on at a vertex where it meets one other, under less than this angle. One that runs
#: on for this share of the size is long. Where most of their length is short, the surface is rough
#: (a scanned one, scales, spikes): then only long ones are creases.
_RUNS_ON_RAD, _LONG = np.deg2rad(45.0), 0.2
#: A finer mesh is simplified to about so many faces.
MOST_FACES = 20_000
#: Vertices nearer than this share of the extent are one: files hold single precision, and noise.
_SAME = 1e-5
#: Creases that are followed, the longest of them.
_MOST_CREASES = 400


@dataclass(frozen=True)
class MeshModel(WireframeModel):
    """
    A model of triangles. Its `lines` are the creases and the borders; it has no plane faces.

    Make it with `build`.

    Parameters
    ----------
    normals : ndarray, shape (F, 3)
        Unit normals of the triangles.
    smooth : ndarray of int, shape (F, 3)
        For each corner its smooth vertex: corners of one vertex that no crease parts.
    line_sides : ndarray of int, shape (L, 2)
        The two faces of each line; the same one twice at a border.

    """

    normals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    smooth: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), int))
    line_sides: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), int))

    def __post_init__(self) -> None:
        """Take what `build` has checked."""

    # a constructor by another name: it is called on a class that is named, never on a variable
    @classmethod
    def build(cls, vertices: ArrayLike, triangles: ArrayLike,  # type: ignore[override]
              name: str = '', **_: object) -> MeshModel:
        """
        Make a model of a mesh.

        Parameters
        ----------
        vertices : array_like, shape (V, 3)
            Metres.
        triangles : array_like of int, shape (F, 3)
        name : str

        Returns
        -------
        MeshModel

        Raises
        ------
        ArgumentError
            If a number is not finite, an index names no vertex, or no face has an area.

        """
        vertices, triangles = np.asarray(vertices, float), np.asarray(triangles, int)
        if not (np.abs(vertices) < LARGEST_M).all():
            raise ArgumentError('its coordinates must be finite numbers.')
        if len(triangles) and not (0 <= triangles.min() and triangles.max() < len(vertices)):
            raise ArgumentError(f'a face names a point that does not exist; there are '
                                f'{len(vertices)}.')
        remarks = []
        vertices, triangles, lost, twice = _clean(vertices, triangles,
                                                  same_place(vertices, _SAME))
        if lost:
            remarks.append(_counted('{n} face{n:plural} without area {n:was|were} left out.',
                                    lost))
        if twice:
            remarks.append(_counted('{n} face{n:plural} that {n:is|are} given twice {n:was|were} '
                                    'left out once.', twice))
        if not len(triangles):
            raise ArgumentError('none of its faces has an area.')
        triangles, turned = oriented(vertices, triangles)
        if turned:
            remarks.append(_counted('{n} face{n:plural} that looked inwards {n:was|were} turned '
                                    'round.', turned))
        open_edges = int((edges_of(triangles)[1] == 1).sum())
        if open_edges:
            remarks.append(_counted('The mesh is open: {n} edge{n:plural} {n:bounds|bound} one '
                                    'face only.', open_edges))
        if len(triangles) > MOST_FACES:
            before = len(triangles)
            vertices, triangles, off = simplified(vertices, triangles, MOST_FACES)
            vertices, triangles = _clean(vertices, triangles, np.arange(len(vertices)))[:2]
            remarks.append(f'{before} faces were simplified to {len(triangles)}, which lie up to '
                           f'{1e3 * off:.2g} mm off.')
        normals = unit(face_normals(vertices, triangles))
        lines, sides, smooth = _creases(vertices, triangles, normals)
        model = cls(vertices, lines, name=name, normals=normals, smooth=smooth, line_sides=sides,
                    remarks=tuple(remarks))
        for key, value in (('line_names', ('',) * len(lines)), ('triangles', triangles),
                           ('line_min_length_px', np.zeros(len(lines))),
                           ('triangle_face', np.zeros(len(triangles), int))):
            object.__setattr__(model, key, value)
        return model

    @cached_property
    def extent(self) -> np.ndarray:
        """Points (N, 3) that span the object: corners of its convex hull."""
        used: np.ndarray = self.vertices[np.unique(self.triangles)]
        try:
            outer: np.ndarray = used[ConvexHull(used).vertices]
        except QhullError:
            return used
        return outer

    @property
    def is_outlined(self) -> bool:
        """Whether it is known by the outline of a curved surface."""
        return True

    @cached_property
    def surface_net(self) -> np.ndarray:
        """Edges (N, 2, 3) between smooth vertices, metres."""
        net: np.ndarray = self.smooth_points[self.smooth_edges]
        return net

    @cached_property
    def smooth_normals(self) -> np.ndarray:
        """Unit normals (S, 3) of the smooth vertices, weighed by the angles of their corners."""
        corners = self.vertices[self.triangles]
        one = unit(np.roll(corners, -1, axis=1) - corners)
        two = unit(np.roll(corners, 1, axis=1) - corners)
        angle = np.arccos(np.clip((one * two).sum(axis=2), -1, 1))
        total = np.zeros((int(self.smooth.max()) + 1, 3))
        np.add.at(total, self.smooth.ravel(),
                  (angle[..., None] * self.normals[:, None]).reshape(-1, 3))
        return unit(total)

    @cached_property
    def smooth_points(self) -> np.ndarray:
        """Places (S, 3) of the smooth vertices."""
        points = np.zeros((int(self.smooth.max()) + 1, 3))
        points[self.smooth.ravel()] = self.vertices[self.triangles.ravel()]
        return points

    @cached_property
    def free_turns(self) -> np.ndarray:
        """Turns (k, 6) about the middle that do not change it: see `mesh_symmetry`."""
        area = 0.5 * np.linalg.norm(face_normals(self.vertices, self.triangles), axis=1)
        share = np.bincount(self.smooth.ravel(), np.repeat(area / 3, 3))
        return free_turns(self.smooth_points - self.centre, self.smooth_normals, share)

    @cached_property
    def smooth_edges(self) -> np.ndarray:
        """Pairs (E, 2) of smooth vertices that a face joins."""
        return edges_of(self.smooth)[0]


def _counted(sentence: str, count: int) -> str:
    """Put a number, and the words that go with it, into a sentence."""
    return put_in_words(sentence, {'n': count})


def _clean(vertices: np.ndarray, triangles: np.ndarray, same: np.ndarray,
           ) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Join vertices in one place; leave out what is unused, and faces twice or without area."""
    triangles = same[triangles] if len(triangles) else triangles.reshape(0, 3)
    before = len(triangles)
    area = np.linalg.norm(face_normals(vertices, triangles), axis=1)
    size = max(float(np.ptp(vertices, axis=0).max(initial=0.0)), 1e-12) if len(vertices) else 1.0
    good = (area > 1e-10 * size**2) & (triangles[:, 0] != triangles[:, 1]) & (
        triangles[:, 1] != triangles[:, 2]) & (triangles[:, 2] != triangles[:, 0])
    triangles = triangles[good]
    lost = before - len(triangles)
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    triangles = triangles[np.sort(first)]
    used, index = np.unique(triangles, return_inverse=True)
    return vertices[used], index.reshape(-1, 3), lost, before - lost - len(index.ravel()) // 3


def _creases(vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray,
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return creases and borders (L, 2), their faces (L, 2), and smooth corners."""
    count = len(triangles)
    pairs = np.sort(borders(triangles), axis=1)
    face = np.tile(np.arange(count), 3)
    edges, index, size = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(index.ravel(), kind='stable')
    first = np.concatenate([[0], np.cumsum(size)[:-1]])
    sides = np.column_stack([face[order[first]], face[order[first + np.minimum(size - 1, 1)]]])
    bend = (normals[sides[:, 0]] * normals[sides[:, 1]]).sum(axis=1)
    sharp = (size != 2) | (bend < np.cos(CREASE_RAD))
    length = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    crease = np.flatnonzero(sharp)
    long = _runs(vertices, edges[crease]) > _LONG * np.linalg.norm(np.ptp(vertices, axis=0))
    if length[crease[long]].sum() < 0.5 * length[crease].sum():
        sharp = size != 2
        sharp[crease[long]] = True
        crease = crease[long]
    # corners of one vertex are one smooth vertex where their faces meet in no crease
    flat = np.flatnonzero(~sharp)
    links = []
    for end in (0, 1):
        vertex = edges[flat, end]
        links.append([sides[flat, k] * 3 + (triangles[sides[flat, k]] == vertex[:, None]).argmax(
            axis=1) for k in (0, 1)])
    rows, columns = (np.concatenate([link[k] for link in links]) for k in (0, 1))
    _, smooth = connected_components(coo_matrix(
        (np.ones(len(rows)), (rows, columns)), shape=(3 * count, 3 * count)), directed=False)
    kept = crease[np.argsort(-length[crease])][:_MOST_CREASES]
    return edges[kept], sides[kept], smooth.reshape(-1, 3)


def _runs(vertices: np.ndarray, creases: np.ndarray) -> np.ndarray:
    """Length (L,) of the run that each of the creases (L, 2) belongs to."""
    if not len(creases):
        return np.zeros(0)
    span = vertices[creases[:, 1]] - vertices[creases[:, 0]]
    length = np.linalg.norm(span, axis=1)
    away = np.concatenate([span, -span]) / np.tile(length, 2)[:, None]
    vertex, count = creases.T.ravel(), len(creases)
    order, at = np.argsort(vertex, kind='stable'), np.bincount(vertex, minlength=len(vertices))
    first = (np.cumsum(at) - at)[at == 2]
    one, other = order[first], order[first + 1]
    straight = (away[one] * away[other]).sum(axis=1) < -np.cos(_RUNS_ON_RAD)
    links = one[straight] % count, other[straight] % count
    _, run = connected_components(coo_matrix((np.ones(len(links[0])), links),
                                             shape=(count, count)), directed=False)
    run_m: np.ndarray = np.bincount(run, length)[run]
    return run_m
