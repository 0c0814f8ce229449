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
Visibility by viewing direction, worked out beforehand.

The view sphere is cut into cells, and each cell into a block of camera centres between two
distances. A point X is hidden by a triangle from exactly the centres in a convex region: the
pyramid from X through the triangle, beyond it, bounded by four planes. If all corners of a block
lie inside that region, X is hidden from the whole block; if all lie outside one of the planes,
the triangle hides it from nowhere in the block. Both are exact; what is left is tested when
asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from selfcal_ros.errors import ArgumentError
from selfcal_ros.rorapid.visibility.visible_model import VisibleModel
from selfcal_ros.values.mesh_orientation import borders
from selfcal_ros.values.wireframe import WireframeModel

_HIDDEN, _VISIBLE, _UNSURE = 0, 1, 2
_LARGEST = 4_000_000
#: More work than this (points x triangles x cells) takes over 15 s.
_MAX_WORK = 2e8


class VisibilityTable(VisibleModel):
    """
    A `VisibleModel` that looks up what is hidden; its answers are the same.

    Pays for models of a hundred faces or more, two to three times; a cube is tested as fast as
    it is looked up.

    Parameters
    ----------
    model : WireframeModel
    nearest_m, farthest_m : float
        Distances of the camera from the middle of the object that the table covers; from
        elsewhere everything is tested.
    subdivisions : int
        Of the icosahedron: 3 gives 642 directions, 8 degrees apart.
    **options
        As for `VisibleModel`.

    Raises
    ------
    ArgumentError
        If the distances are not positive and in order, or the table would be too large.

    """

    def __init__(self, model: WireframeModel, nearest_m: float, farthest_m: float,
                 subdivisions: int = 3, **options: Any) -> None:
        """Fill the table."""
        super().__init__(model, **options)
        if not 0 < nearest_m < farthest_m < np.inf:
            raise ArgumentError('The distances of a visibility table must be positive, the '
                                'nearest first.')
        if not 0 <= subdivisions <= 5:
            raise ArgumentError('A visibility table takes 0 to 5 subdivisions.')
        self._range = float(nearest_m), float(farthest_m)
        self._directions, around, cells, reach = _view_sphere(subdivisions)
        if len(self._points) * len(self._corners) * len(self._directions) > _MAX_WORK:
            raise ArgumentError('A visibility table of so many control points and faces would '
                                'take too long; ask for fewer subdivisions, or use '
                                'VisibleModel.')
        # chords between the corners of a cell must not cut off its far side
        shells = np.array([nearest_m, farthest_m / np.cos(reach)])
        self._state, doubtful = self._fill(model.centre + shells[:, None] * around[:, None],
                                           cells)
        self._doubtful = [np.flatnonzero(triangles) for triangles in doubtful]

    def _fill(self, corners: np.ndarray, cells: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """
        Fill the table from the corners (N, 2, 3) and those of each cell.

        Returns the state (cells, points), and which triangles (cells, T) may hide some point
        that is unsure.
        """
        state = np.full((len(cells), len(self._points)), _VISIBLE, dtype=np.uint8)
        doubtful = np.zeros((len(cells), len(self._corners)), bool)
        if not len(self._corners):
            return state, doubtful
        chunk = max(1, _LARGEST // (8 * corners.shape[0] * len(self._corners)))
        for start in range(0, len(self._points), chunk):
            part = slice(start, start + chunk)
            inside = self._inside(self._points[part], corners)
            # all corners of a block within a plane, or all without
            within = np.stack([inside[cell].all(axis=(0, 1)) for cell in cells])
            without = np.stack([~inside[cell].any(axis=(0, 1)) for cell in cells])
            drawn_on = self._on_face[part]
            hidden = np.asarray((within.all(axis=-1) & ~drawn_on).any(axis=-1))
            may_hide = ~without.any(axis=-1) & ~drawn_on & ~hidden[..., None]
            state[:, part] = np.where(hidden, _HIDDEN,
                                      np.where(may_hide.any(axis=-1), _UNSURE, _VISIBLE))
            doubtful |= may_hide.any(axis=1)
        return state, doubtful

    def _inside(self, points: np.ndarray, corners: np.ndarray) -> np.ndarray:
        """Tell which corners lie inside the planes, (N, 2, points, triangles, 4) bool."""
        a, b, c = (self._corners[None, :, k] - points[:, None] for k in range(3))
        normals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
        volume = (a * normals[:, :, 0]).sum(axis=-1)
        # relative to X the centre is beyond the triangle, inside the three sides
        face = np.cross(b - a, c - a)
        planes = np.concatenate([normals, face[:, :, None]], axis=2)
        planes *= np.sign(volume)[:, :, None, None]
        offset = (points[:, None, None] * planes).sum(axis=-1)
        offset[:, :, 3] += np.abs(volume)
        flat = corners.reshape(-1, 3) @ planes.reshape(-1, 3).T - offset.ravel()
        inside: np.ndarray = (flat > 0).reshape(*corners.shape[:2], *offset.shape)
        return inside

    def _hidden_static(self, centre: np.ndarray) -> np.ndarray:
        """Look up; test what depends on where in its block the camera is."""
        offset = centre - self.model.centre
        distance = np.linalg.norm(offset)
        if not self._range[0] <= distance <= self._range[1]:
            return super()._hidden_static(centre)
        cell = (self._directions @ offset).argmax()
        state = self._state[cell]
        hidden: np.ndarray = state == _HIDDEN
        unsure = np.flatnonzero(state == _UNSURE)
        if len(unsure):
            hidden[unsure] = self.hidden(self._points[unsure], centre, self._on_face[unsure],
                                         self._doubtful[cell])
        return hidden

    @property
    def share_decided(self) -> float:
        """Share of the table that needs no test."""
        return float((self._state != _UNSURE).mean()) if self._state.size else 1.0


def _view_sphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], float]:
    """
    Cut the unit sphere evenly into the cells that are nearest to one direction each.

    Returns directions (G, 3); corners of cells (N, 3); for each cell the indices of its corners;
    the largest angle from a direction to the corners of its cell, radians.
    """
    golden = (1 + 5**0.5) / 2
    first = np.array([(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([np.roll(first, k, axis=1) for k in range(3)])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    for _ in range(subdivisions):
        faces = ConvexHull(points).simplices
        edges = np.unique(np.sort(borders(faces), axis=1), axis=0)
        middle = points[edges].sum(axis=1)
        points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1)[:, None]])
    faces = ConvexHull(points).simplices
    a, b, c = points[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= np.sign((normal * a).sum(axis=1, keepdims=True))
    reach = np.arccos(np.clip((normal * a).sum(axis=1), 0, 1)).max()
    cells = [np.flatnonzero((faces == k).any(axis=1)) for k in range(len(points))]
    return points, normal, cells, float(reach)
