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
"""Faces of a wireframe: the closed loops of its lines that lie in one plane."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from selfcal_ros.geometry.polygon import newell_normal
from selfcal_ros.geometry.rotation import align_z

#: Vertices of a face lie in its plane within this share of the object's extent.
_FLAT = 0.03


def plane_loops(vertices: np.ndarray, pairs: Iterable[tuple[int, int]]) -> list[tuple[int, ...]]:
    """
    Find the smallest closed loops of lines that lie in one plane, up to markings on faces.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
    pairs : sequence of (int, int)
        Lines.

    Returns
    -------
    list of tuple of int
        Vertices in order around each loop.

    """
    around: dict[int, set[int]] = {}
    for i, j in pairs:
        around.setdefault(i, set()).add(j)
        around.setdefault(j, set()).add(i)
    tolerance = _FLAT * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    loops: dict[frozenset[int], tuple[int, ...]] = {}
    for corner, neighbours in around.items():
        for start in neighbours:
            for end in neighbours - {start}:
                loop = _walk(vertices, around, (start, corner, end), tolerance)
                if loop is not None:
                    loops.setdefault(frozenset(loop), loop)
    return _without_markings(vertices, list(loops.values()), tolerance)


def facing(vertices: np.ndarray, loop: tuple[int, ...]) -> tuple[int, ...]:
    """
    Turn a loop so that its face looks at the camera.

    Programs that draw a model, and ViSP's tracker, take a face for seen from the side where its
    vertices go round counter-clockwise.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        In the frame of the camera.
    loop : tuple of int

    Returns
    -------
    tuple of int

    """
    corners = vertices[list(loop)]
    return loop if newell_normal(corners) @ corners.mean(axis=0) < 0 else loop[::-1]


def _without_markings(vertices: np.ndarray, loops: list[tuple[int, ...]], tolerance: float,
                      ) -> list[tuple[int, ...]]:
    """Leave out what is drawn on a face: a loop inside of another one in the same plane."""
    return [loop for loop in loops
            if not any(_encloses(vertices[list(other)], vertices[list(loop)], tolerance)
                       for other in loops if not set(other) & set(loop))]


def _encloses(outer: np.ndarray, inner: np.ndarray, tolerance: float) -> bool:
    """Whether the polygon `outer` (n, 3) holds all points `inner` (m, 3), in its plane."""
    normal = newell_normal(outer)
    normal = normal / np.linalg.norm(normal)
    if np.abs((inner - outer[0]) @ normal).max() > tolerance:
        return False
    frame = align_z(normal)[:, :2]
    polygon, points = outer @ frame, inner @ frame
    # even-odd rule: how many sides a ray along x crosses
    a, b = polygon, np.roll(polygon, -1, axis=0)
    across = (a[:, 1] > points[:, 1:]) != (b[:, 1] > points[:, 1:])
    rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    x = a[:, 0] + (points[:, 1:] - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
    crossings = (across & (x > points[:, :1])).sum(axis=1)
    return bool((crossings % 2 == 1).all())


def _walk(vertices: np.ndarray, around: dict[int, set[int]], begin: tuple[int, int, int],
          tolerance: float) -> tuple[int, ...] | None:
    """Follow the first three vertices in their plane, always turning inwards; None: no loop."""
    a, b, c = vertices[list(begin)]
    normal = np.cross(b - a, c - b)
    size = np.linalg.norm(normal)
    if size < 0.2 * np.linalg.norm(b - a) * np.linalg.norm(c - b):
        return None
    normal /= size
    loop = list(begin)
    while len(loop) <= len(around):
        previous, here = vertices[loop[-2]], vertices[loop[-1]]
        best, sharpest = None, -np.inf
        for following in around[loop[-1]] - {loop[-2]}:
            way = vertices[following] - here
            if abs((vertices[following] - b) @ normal) > tolerance:
                continue
            turn = np.arctan2(np.cross(here - previous, way) @ normal, (here - previous) @ way)
            if turn > sharpest:
                best, sharpest = following, turn
        if best is None:
            return None
        if best == loop[0]:
            return tuple(loop) if _turns_once(vertices[loop], normal) else None
        if best in loop:
            return None
        loop.append(best)
    return None


def _turns_once(points: np.ndarray, normal: np.ndarray) -> bool:
    """Whether a loop goes around once, to the left of its normal."""
    way = np.roll(points, -1, axis=0) - points
    before = np.roll(way, 1, axis=0)
    turns = np.arctan2(np.cross(before, way) @ normal, (before * way).sum(axis=1))
    return bool(abs(turns.sum() - 2 * np.pi) < 0.5)
