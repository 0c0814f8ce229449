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
"""Faces of a mesh, their edges and normals, and which way they look: out of what they bound."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

#: An open part's own volume tells its outside, if it is more than this share of area x size.
_HOLLOW = 0.02
#: Corners of a part that are looked for inside another one, at the most.
_ASKED = 16


def borders(triangles: np.ndarray) -> np.ndarray:
    """Return all first borders of triangles (T, 3), then all second, then all third: (3 T, 2)."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def edges_of(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges (E, 2) of triangles (T, 3), in order, and how many each bounds, (E,)."""
    low, high = np.sort(borders(triangles), axis=1).T
    count = int(high.max(initial=0)) + 1
    key, size = np.unique(low * count + high, return_counts=True)
    return np.column_stack([key // count, key % count]), size


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) of length 1; those of none stay as they are."""
    shortened: np.ndarray = vectors / np.maximum(
        np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
    return shortened


def face_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return normals (T, 3) of faces, as long as twice their area."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def oriented(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """
    Turn faces so that neighbours agree and each body's volume is positive.

    A part inside another one bounds a void, or is not seen: it stays as it is.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Metres.
    triangles : ndarray of int, shape (F, 3)

    Returns
    -------
    triangles : ndarray of int, shape (F, 3)
    turned : int
        How many were turned.

    """
    agreed, part = _agreed(triangles)
    corners = vertices[agreed] - vertices.mean(axis=0)
    volume = np.bincount(part, np.linalg.det(corners) / 6)
    area = 0.5 * np.linalg.norm(face_normals(vertices, agreed), axis=1)
    bounds = np.stack([_over(np.minimum, part, corners.min(axis=1)),
                       _over(np.maximum, part, corners.max(axis=1))], axis=1)
    # about its own middle the volume of a flat part is none
    whole = np.bincount(part, area)
    middle = np.column_stack([np.bincount(part, area * corners[:, :, k].mean(axis=1))
                              for k in range(3)]) / np.maximum(whole, 1e-300)[:, None]
    own = np.bincount(part, np.linalg.det(corners - middle[part][:, None]) / 6)
    closed = _closed(agreed, part)
    size = np.linalg.norm(bounds[:, 1] - bounds[:, 0], axis=1)
    clear = closed | (np.abs(own) > _HOLLOW * whole * size)
    # parts whose own volume tells nothing go together
    backwards = np.where(clear, own < 0, volume[~clear].sum() < 0)
    for k in np.flatnonzero(backwards & clear):
        around = closed & (bounds[:, 0] <= bounds[k, 0]).all(axis=1) & (
            bounds[:, 1] >= bounds[k, 1]).all(axis=1) & (size > size[k])
        points = corners[part == k].reshape(-1, 3)
        points = points[::max(len(points) // _ASKED, 1)][:_ASKED]
        backwards[k] = not any(_inside(points, corners[part == other])
                               for other in np.flatnonzero(around))
    result = np.where(backwards[part][:, None], agreed[:, ::-1], agreed)
    return result, int((result[:, 0] != triangles[:, 0]).sum())


def _agreed(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Turn faces so that neighbours agree; return them (F, 3) and the part of each (F,).

    Each face is two nodes of a graph, one for each way round. Faces on an edge link the ways that
    agree, so a part that can be oriented makes two components, one the reverse of the other.
    """
    count = len(triangles)
    ends = borders(triangles)
    face, along = np.tile(np.arange(count), 3), ends[:, 0] < ends[:, 1]
    low, high = np.sort(ends, axis=1).T
    _, index, size = np.unique(low * (int(high.max()) + 1) + high, return_inverse=True,
                               return_counts=True)
    order = np.argsort(index.ravel(), kind='stable')
    begin = (np.cumsum(size) - size)[size == 2]
    first, second = order[begin], order[begin + 1]
    # neighbours agree where they run along their edge in opposite ways
    agree = along[first] != along[second]
    one, other = face[first], face[second] + np.where(agree, 0, count)
    rows = np.concatenate([one, one + count])
    columns = np.concatenate([other, (other + count) % (2 * count)])
    _, part = connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)),
                                              shape=(2 * count, 2 * count)), directed=False)
    # of the two ways of a part that which more of its faces have already
    has = np.bincount(part[:count], minlength=part.max() + 1)
    turn = has[part[count:]] > has[part[:count]]
    tied = (has[part[count:]] == has[part[:count]]) & (part[count:] < part[:count])
    agreed = np.where((turn | tied)[:, None], triangles[:, ::-1], triangles)
    _, whole = np.unique(np.minimum(part[:count], part[count:]), return_inverse=True)
    return agreed, whole.ravel()


def _over(function: np.ufunc, part: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Reduce rows (F, 3) over the faces of each part."""
    order = np.argsort(part, kind='stable')
    return function.reduceat(rows[order], np.flatnonzero(np.diff(part[order], prepend=-1)))


def _closed(triangles: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Which parts have no border, (P,) bool."""
    ends = np.sort(borders(triangles), axis=1)
    keys, count = np.unique(np.column_stack([np.tile(part, 3), ends]), axis=0,
                            return_counts=True)
    closed: np.ndarray = np.bincount(keys[:, 0], count % 2) == 0
    return closed


def _inside(points: np.ndarray, corners: np.ndarray) -> bool:
    """Whether a closed surface of triangles (F, 3, 3) winds around all points (N, 3)."""
    for point in points:
        a, b, c = np.moveaxis(corners - point, 1, 0)
        one, two, three = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        # solid angles of triangles (van Oosterom and Strackee)
        angle = np.arctan2(np.linalg.det(np.stack([a, b, c], axis=1)),
                           one * two * three + (a * b).sum(axis=1) * three
                           + (b * c).sum(axis=1) * one + (c * a).sum(axis=1) * two)
        if abs(angle.sum()) < np.pi:
            return False
    return True
