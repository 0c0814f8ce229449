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
A mesh with fewer faces, nearly where it was: edges shrink to points, the cheapest first.

Each vertex keeps the sum of the squared distances from the planes of the faces that it stands for
(Garland and Heckbert, 1997). An edge shrinks to the point where the sum of both is least. So
planes and creases stay where they are. The two sides of a sheet have no edge between them to
shrink.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix

from selfcal_ros.values.mesh_orientation import borders, edges_of, face_normals, unit

#: Share of the edges that may shrink in one round, those that cost least.
_CHEAPEST = 0.25
#: What an edge costs by its length alone: then flat parts keep well-shaped faces.
_BY_LENGTH = 1e-6
#: An end of an edge is taken where the best point is better by less than this, in such units.
_ENDS = 1e-8
#: Weight of a border's plane, which stands on its face, against that of the face.
_BORDER = 10.0
#: A face may not turn by more than this (cosine) while an edge shrinks.
_TURNED = 0.2
#: Nor become flatter than this: twice the area over the square of the longest side.
_FLAT = 2e-3
#: Multiplier that mixes numbers (Knuth's).
_MIXED = 2654435761
#: What lies within this share of the size of a plane is flat: files hold single precision.
_FLAT_SHARE = 1e-6
#: A round that removes less than this share of the faces was a bad one.
_LEAST = 0.02
#: Of more faces than this, vertices of one cell of a grid are joined first: so many a side.
_MOST, _CELLS = 400_000, 250


def simplified(vertices: np.ndarray, triangles: np.ndarray,
               most: int) -> tuple[np.ndarray, np.ndarray, float]:
    """
    Shrink edges until few enough faces are left, and then what is flat.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Metres.
    triangles : ndarray of int, shape (F, 3)
    most : int
        Faces that may be left. There are more where too few edges can shrink.

    Returns
    -------
    vertices : ndarray, shape (W, 3)
    triangles : ndarray of int, shape (G, 3)
    deviation : float
        Largest distance of a vertex from the planes of the faces that stand for it, metres.

    """
    places, faces, stands = vertices.astype(float), triangles, np.arange(len(vertices))
    if len(faces) > _MOST:
        places, faces, stands = _in_cells(places, faces)
    quadrics = _quadrics(places, faces)
    share = _CHEAPEST
    enough, flat_m = True, _FLAT_SHARE * float(np.ptp(vertices, axis=0).max())
    while len(faces) > most and share <= 1 or enough and len(faces) <= most:
        # flat parts in many pieces have their creases in many pieces, too
        surplus, most_m = (len(faces) - most, np.inf) if len(faces) > most else (
            len(faces), flat_m)
        onto, moved, summed = _shrunk(places, faces, quadrics, surplus, share, most_m)
        left = onto[faces]
        left = left[(left != np.roll(left, 1, axis=1)).all(axis=1)]
        used, index = np.unique(left, return_inverse=True)
        before, faces = len(faces), index.reshape(-1, 3)
        # a vertex that no face is left of stands for nothing
        number = np.zeros(len(places), int)
        number[used] = np.arange(len(used))
        stands = number[onto[stands]]
        places, quadrics = moved[used], summed[used]
        # where the cheapest ones cannot shrink, others have to
        enough = before - len(faces) > _LEAST * min(before, 10 * surplus)
        share = _CHEAPEST if enough or len(faces) <= most else 2 * share
    return places, faces, _deviation(vertices, places, faces, stands)


def _in_cells(places: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Join vertices of one cell that look the same way; vertices, faces, and which went where."""
    normal, of_faces = np.zeros_like(places), face_normals(places, faces)
    for k in range(3):
        np.add.at(normal, faces[:, k], of_faces)
    widest = np.abs(normal).argmax(axis=1)
    side = 2 * widest + (normal[np.arange(len(places)), widest] > 0)
    size = float(np.ptp(places, axis=0).max())
    cell = ((places - places.min(axis=0)) / size * _CELLS).astype(np.int64)
    key = ((cell[:, 0] * (_CELLS + 1) + cell[:, 1]) * (_CELLS + 1) + cell[:, 2]) * 6 + side
    _, index = np.unique(key, return_inverse=True)
    count = np.bincount(index)
    middle = np.column_stack([np.bincount(index, places[:, k]) for k in range(3)])
    left = index[faces]
    left = left[(left != np.roll(left, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(left, axis=1), axis=0, return_index=True)
    return middle / count[:, None], left[np.sort(first)], index


def _flatness(places: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Twice the area of faces (F,) over the square of their longest side."""
    corners = places[faces]
    longest = ((corners - np.roll(corners, 1, axis=1))**2).sum(axis=2).max(axis=1)
    flatness: np.ndarray = np.linalg.norm(normals, axis=1) / np.maximum(longest, 1e-300)
    return flatness


def _quadrics(places: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Sums of plane plane' (V, 4, 4) over the faces of each vertex, by area; borders too."""
    normal = face_normals(places, faces)
    area = np.linalg.norm(normal, axis=1) / 2
    total = np.zeros((len(places), 4, 4))
    _add(total, faces, unit(normal), places[faces[:, 0]], area)
    ends = borders(faces)
    low, high = np.sort(ends, axis=1).T
    _, index, count = np.unique(low * len(places) + high, return_inverse=True,
                                return_counts=True)
    lone = np.flatnonzero(count[index.ravel()] != 2)
    along = places[ends[lone, 1]] - places[ends[lone, 0]]
    across = np.cross(along, unit(normal)[lone % len(faces)])
    _add(total, ends[lone], unit(across), places[ends[lone, 0]],
         _BORDER * (along**2).sum(axis=1))
    return total


def _add(total: np.ndarray, corners: np.ndarray, normal: np.ndarray, point: np.ndarray,
         weight: np.ndarray) -> None:
    plane = np.column_stack([normal, -(normal * point).sum(axis=1)])
    outer = weight[:, None, None] * plane[:, :, None] * plane[:, None]
    for k in range(corners.shape[1]):
        np.add.at(total, corners[:, k], outer)


def _shrunk(places: np.ndarray, faces: np.ndarray, quadrics: np.ndarray, surplus: int,
            share: float, most_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shrink some edges: for each vertex the one it goes onto; new places; new quadrics."""
    ends, size = edges_of(faces)
    a, b = ends.T
    both = quadrics[a] + quadrics[b]
    point, cost = _best(both, places[a], places[b])
    flat = cost <= most_m**2 * np.trace(both[:, :3, :3], axis1=1, axis2=2)
    length = ((places[a] - places[b])**2).sum(axis=1)
    cost = cost + _BY_LENGTH * length * np.trace(both[:, :3, :3], axis1=1, axis2=2)
    # of the cheapest edges those that come first at both of their ends, in an order that is mixed:
    # by cost or by number few neighbours would be chosen at a time
    many = int(share * len(ends))
    cheap = np.argpartition(cost, many - 1)[:many]
    cheap = cheap[flat[cheap]]
    cheap = cheap[_keeps_surface(ends, size, cheap, len(places))]
    cheap = cheap[np.argsort(cheap * _MIXED % 2**32, kind='stable')]
    lowest = np.full(len(places), len(cheap))
    lowest[a[cheap[::-1]]] = np.arange(len(cheap))[::-1]
    later = np.full(len(places), len(cheap))
    later[b[cheap[::-1]]] = np.arange(len(cheap))[::-1]
    lowest = np.minimum(lowest, later)
    turn = np.arange(len(cheap))
    chosen = cheap[(turn == lowest[a[cheap]]) & (turn == lowest[b[cheap]])]
    chosen = chosen[np.argsort(cost[chosen])][:surplus // 2 + 1]
    while True:
        onto, moved = np.arange(len(places)), places.copy()
        onto[b[chosen]] = a[chosen]
        moved[a[chosen]] = moved[b[chosen]] = point[chosen]
        old, new = face_normals(places, faces), face_normals(moved, faces)
        gone = (onto[faces] == np.roll(onto[faces], 1, axis=1)).any(axis=1)
        product = (old * new).sum(axis=1)
        size = np.linalg.norm(old, axis=1) * np.linalg.norm(new, axis=1)
        flat = _flatness(moved, faces, new)
        bad = ~gone & ((product <= _TURNED * size)
                       | (flat < _FLAT) & (flat < _flatness(places, faces, old)))
        if not bad.any():
            break
        spoilt = np.zeros(len(places), bool)
        spoilt[faces[bad]] = True
        keep = ~(spoilt[a[chosen]] | spoilt[b[chosen]])
        if keep.all():
            break                         # faces that had no area before
        chosen = chosen[keep]
    summed = quadrics.copy()
    summed[a[chosen]] = both[chosen]
    return onto, moved, summed


def _best(quadrics: np.ndarray, one: np.ndarray, other: np.ndarray,
          ) -> tuple[np.ndarray, np.ndarray]:
    """Points (E, 3) where the quadrics are least, near the edges, and what they are there."""
    middle = 0.5 * (one + other)
    H = quadrics[:, :3, :3]
    slope = np.einsum('eij,ej->ei', H, middle) + quadrics[:, :3, 3]
    # a direction that the planes leave open stays at the middle
    floor = 1e-3 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-300 * np.eye(3)
    step = -np.linalg.solve(H + floor, slope[..., None])[..., 0]
    # planes that nearly agree meet far off
    step[(step**2).sum(axis=1) > ((one - other)**2).sum(axis=1)] = 0
    ways = np.stack([one - middle, other - middle, 0 * step, step], axis=1)
    # differences from the middle: what is common to all is mostly rounding
    more = 2 * (ways @ slope[..., None])[..., 0] + np.einsum('epi,eij,epj->ep', ways, H, ways)
    scale = np.trace(H, axis1=1, axis2=2) * ((one - other)**2).sum(axis=1)
    # an end that is as good as any keeps creases and corners exactly where they are
    pick = (more + np.array([0, 0, 1, 1]) * _ENDS * scale[:, None]).argmin(axis=1)
    line = np.arange(len(ways))
    wide = np.column_stack([middle, np.ones(len(middle))])
    value = np.einsum('ei,eij,ej->e', wide, quadrics, wide) + more[line, pick]
    return middle + ways[line, pick], np.maximum(value, 0)


def _keeps_surface(ends: np.ndarray, size: np.ndarray, chosen: np.ndarray, count: int,
                   ) -> np.ndarray:
    """Which edges leave a surface: their ends have only corners of their faces in common."""
    rows = np.concatenate([ends[:, 0], ends[:, 1]])
    columns = np.concatenate([ends[:, 1], ends[:, 0]])
    near = coo_matrix((np.ones(len(rows), np.int32), (rows, columns)),
                      shape=(count, count)).tocsr()
    pairs = ends[chosen]
    common = np.asarray(near[pairs[:, 0]].multiply(near[pairs[:, 1]]).sum(axis=1)).ravel()
    on_border = np.zeros(count, bool)
    on_border[ends[size != 2]] = True
    inner = size[chosen] == 2
    across = inner & on_border[pairs].all(axis=1)
    kept: np.ndarray = (common == size[chosen]) & ~across & (size[chosen] <= 2)
    return kept


def _deviation(vertices: np.ndarray, places: np.ndarray, faces: np.ndarray, stands: np.ndarray,
               ) -> float:
    """Largest distance of vertices (V, 3) from the planes of faces at those they went onto."""
    normal = unit(face_normals(places, faces))
    least = np.full(len(vertices), np.inf)
    order = np.argsort(faces.ravel(), kind='stable')
    count = np.bincount(faces.ravel(), minlength=len(places))
    first = np.cumsum(count) - count
    for k in range(int(count.max(initial=0))):
        some = np.flatnonzero(count[stands] > k)
        face = order[first[stands[some]] + k] // 3
        away = np.abs(((vertices[some] - places[stands[some]]) * normal[face]).sum(axis=1))
        least[some] = np.minimum(least[some], away)
    return float(least[np.isfinite(least)].max(initial=0.0))
