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
Vertices picked by hand in two images: a YAML file.

::

    vertices:               # name: u, v in the first image, u, v in the second
      a: [377, 181, 349, 126]
      b: [448, 211, 401, 152]
      c: [386, 265, 350, 186]
    faces:                  # opaque; their borders are lines of the model
    - [a, b, c]
    lines:                  # further lines: markings
    - [a, c]
    ellipses:               # a face, counted from 0, and five or more points in the first image
    - {face: 0, points: [[400, 200], [410, 205], [415, 214], [405, 220], [396, 210]]}
    frame: [a, b, c]        # origin, a point on the x axis, one in the x-y plane
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np
from selfcal_ros.errors import InputError
from selfcal_ros.rorapid.acquisition.image_lines import refine_vertices
from selfcal_ros.rorapid.model.text_file import read_text
from selfcal_ros.values.foreign_files import load_foreign_yaml

_KEYS = ('vertices', 'faces', 'lines', 'ellipses', 'frame')
#: Nobody picks more; a YAML file takes long to parse.
_MAX_VERTICES, _LARGEST_YAML = 1000, 500_000


@dataclass(frozen=True)
class PickedVertices:
    """
    Attributes of vertices that were picked by hand, and of what they bound.

    Attributes
    ----------
    names : tuple of str, length N
    first_px, second_px : ndarray, shape (N, 2)
        In the two images.
    lines : tuple of (int, int)
        Lines that are no borders of faces.
    faces : tuple of tuple of int
    ellipses : tuple of (int, ndarray (M, 2))
        Face, and points in the first image.
    frame : (int, int, int) or None
        Vertices that lay out the frame of the model.

    """

    names: tuple[str, ...]
    first_px: np.ndarray
    second_px: np.ndarray
    lines: tuple[tuple[int, int], ...]
    faces: tuple[tuple[int, ...], ...]
    ellipses: tuple[tuple[int, np.ndarray], ...]
    frame: tuple[int, int, int] | None

    @property
    def edges(self) -> list[tuple[int, int]]:
        """All pairs of vertices between which an edge is seen, borders of faces included."""
        borders = {(face[k - 1], face[k]) for face in self.faces for k in range(len(face))}
        return sorted({(min(pair), max(pair)) for pair in borders.union(self.lines)})

    def refined(self, first: np.ndarray, second: np.ndarray,
                reach_px: int = 5) -> tuple[np.ndarray, np.ndarray]:
        """
        Move the vertices to where the edges between them intersect.

        Parameters
        ----------
        first, second : ndarray, shape (H, W), uint8
        reach_px : int
            How far the edges may lie from where they were picked.

        Returns
        -------
        first_px, second_px : ndarray, shape (N, 2)

        """
        return (refine_vertices(first, self.first_px, self.edges, reach_px),
                refine_vertices(second, self.second_px, self.edges, reach_px))


def read_picked(path: str | Path) -> PickedVertices:
    """
    Read a file of picked vertices.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    PickedVertices

    Raises
    ------
    InputError
        If the file cannot be used; the sentence says where and why.

    """
    path = Path(path)
    text = read_text(path)
    if len(text) > _LARGEST_YAML:
        raise InputError(f'{path} is too long for vertices that were picked by hand.')
    data = load_foreign_yaml(text, str(path))
    try:
        return _picked(data)
    except InputError as error:
        raise InputError(f'{path}: {error}') from None


def _picked(data: Any) -> PickedVertices:
    if not isinstance(data, dict) or not isinstance(data.get('vertices'), dict):
        raise InputError('a file of picked vertices has "vertices:", and under it a line '
                         '"name: [u, v, u, v]" for each.')
    unknown = [str(key) for key in data if key not in _KEYS]
    if unknown:
        raise InputError(f'it may hold {", ".join(_KEYS)}, but not {unknown[0][:40]!r}.')
    rows = data['vertices']
    if len(rows) > _MAX_VERTICES:
        raise InputError(f'{len(rows)} vertices are too many; {_MAX_VERTICES} may be.')
    names = tuple(str(name) for name in rows)
    if len(set(names)) != len(names):
        raise InputError('two vertices have the same name.')
    places = np.array([_numbers(row, 4, f'vertex {name}') for name, row in zip(
        names, rows.values())]).reshape(-1, 4)
    index = {name: k for k, name in enumerate(names)}
    faces = [_vertices(row, index, f'face {k}', 3) for k, row in enumerate(_list(data, 'faces'))]
    lines = []
    for k, row in enumerate(_list(data, 'lines')):
        start, end = _vertices(row, index, f'line {k}', 2, 2)
        lines.append((start, end))
    if not faces and not lines:
        raise InputError('name lines or faces between the vertices.')
    ellipses = [_ellipse(row, k, len(faces)) for k, row in enumerate(_list(data, 'ellipses'))]
    frame = None
    if data.get('frame') is not None:
        origin, on_x, on_plane = _vertices(data['frame'], index, 'the frame', 3, 3)
        frame = origin, on_x, on_plane
    return PickedVertices(names, places[:, :2], places[:, 2:], tuple(lines), tuple(faces),
                          tuple(ellipses), frame)


def _list(data: Any, key: str) -> list[Any]:
    rows = data.get(key) or []
    if not isinstance(rows, list):
        raise InputError(f'"{key}:" must be a list.')
    return rows


def _numbers(row: Any, count: int, what: str) -> list[float]:
    if not isinstance(row, list) or len(row) != count or not all(
            isinstance(value, (int, float)) and not isinstance(value, bool)
            and math.isfinite(value) and abs(value) < 1e6 for value in row):
        raise InputError(f'{what} must be {count} numbers of pixels.')
    return [float(value) for value in row]


def _vertices(row: Any, index: dict[str, int], what: str, least: int, most: int | None = None,
              ) -> tuple[int, ...]:
    if not isinstance(row, list) or len(row) < least or (most and len(row) > most):
        wanted = f'{least}' if most else f'{least} or more'
        raise InputError(f'{what} must be a list of {wanted} vertices.')
    for name in row:
        if str(name) not in index:
            raise InputError(f'{what} names the vertex {str(name)[:40]!r}, which is not there.')
    found = tuple(index[str(name)] for name in row)
    if len(set(found)) != len(found):
        raise InputError(f'{what} names a vertex twice.')
    return found


def _ellipse(row: Any, k: int, faces: int) -> tuple[int, np.ndarray]:
    what = f'ellipse {k}'
    if not isinstance(row, dict) or set(row) != {'face', 'points'}:
        raise InputError(f'{what} must have "face:" and "points:".')
    face = row['face']
    if not isinstance(face, int) or isinstance(face, bool) or not 0 <= face < faces:
        raise InputError(f'{what} must name a face from 0 to {faces - 1}.')
    points = row['points']
    if not isinstance(points, list) or len(points) < 5:
        raise InputError(f'{what} needs five points or more.')
    return face, np.array([_numbers(point, 2, f'a point of {what}') for point in points])
