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
Triangle meshes as files: Wavefront ``.obj``, ``.ply`` (text and binary), ``.stl`` (both).

Only the shape is read; materials and texture files are not opened, so that a missing one does no
harm. Coordinates are metres once they are scaled.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
from typing import Any

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.polygon import cut_into_triangles
from selfcal_ros.values.foreign_files import read_limited
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.polyhedron import polyhedron
from selfcal_ros.values.wireframe import WireframeModel

#: Rows of a binary file that are read together at first.
_TOGETHER = 64
#: Longer files are refused, bytes.
_LARGEST = 400_000_000
#: Objects smaller or larger than this are in another unit, metres.
_SMALLEST_M, _LARGEST_M = 0.002, 50.0
_TYPES = {'char': 'i1', 'int8': 'i1', 'uchar': 'u1', 'uint8': 'u1', 'short': 'i2', 'int16': 'i2',
          'ushort': 'u2', 'uint16': 'u2', 'int': 'i4', 'int32': 'i4', 'uint': 'u4',
          'uint32': 'u4', 'float': 'f4', 'float32': 'f4', 'double': 'f8', 'float64': 'f8'}
_ORDERS = {'ascii': '', 'binary_little_endian': '<', 'binary_big_endian': '>'}


def read_mesh(path: Path, scale: float = 1.0) -> WireframeModel:
    """
    Read a mesh; one of few plane faces becomes a model of these.

    Parameters
    ----------
    path : Path
        Its ending tells the format.
    scale : float
        Metres per unit of the file.

    Returns
    -------
    WireframeModel
        A MeshModel, unless all faces are plane.

    Raises
    ------
    InputError
        If the file cannot be read, holds no mesh, or one of an absurd size.

    """
    data = read_limited(path, _LARGEST)
    if not data:
        raise InputError(f'{path} is empty; give another file.')
    try:
        vertices, triangles = _READERS[path.suffix.lower()](data)
    except (ValueError, IndexError, KeyError, TypeError, OverflowError) as error:
        raise InputError(f'{path} cannot be read as {path.suffix[1:]}: {error}.') from None
    if not len(vertices):
        raise InputError(f'{path} holds no points.')
    if not len(triangles):
        raise InputError(f'{path} holds no faces; points alone cannot be tracked.')
    size = float(np.linalg.norm(np.ptp(vertices, axis=0))) * scale
    if np.isfinite(vertices).all() and not _SMALLEST_M <= size <= _LARGEST_M:
        raise InputError(f'{path} would be {size:.3g} m large' + (
            '; say its unit with --model-scale (0.001 where it is in millimetres).' if scale == 1
            else f' with --model-scale {scale:g}; choose another (1 where it is in metres).'))
    try:
        mesh = MeshModel.build(vertices * scale, triangles, path.stem)
    except ArgumentError as error:
        raise InputError(f'{path} cannot be used: {error}') from None
    plane = polyhedron(mesh)
    return mesh if plane is None else plane


def _cut(vertices: np.ndarray, loops: list[list[int]]) -> np.ndarray:
    """Cut polygons, convex or not, into triangles (T, 3)."""
    found = [np.zeros((0, 3), int)]
    sizes = np.array([len(loop) for loop in loops], int)
    for size in np.unique(sizes[sizes >= 3]):
        polygons = np.array([loops[k] for k in np.flatnonzero(sizes == size)], int)
        bent = np.zeros(0, int)
        # an index of no vertex is told later on, with a sentence
        if size > 3 and 0 <= polygons.min() and polygons.max() < len(vertices):
            corners = vertices[polygons]
            span = np.roll(corners, -1, axis=1) - corners
            turn = np.cross(np.roll(span, 1, axis=1), span)
            normal = np.cross(corners - corners[:, :1], span).sum(axis=1)
            ahead = (turn * normal[:, None]).sum(axis=2)
            bent = np.flatnonzero(ahead.min(axis=1) < -1e-9 * (normal**2).sum(axis=1))
        for polygon in polygons[bent]:
            cut = cut_into_triangles(vertices[polygon])
            found.append(_fans(polygon[None]) if cut is None else polygon[cut])
        found.append(_fans(np.delete(polygons, bent, axis=0)))
    return np.concatenate(found)


def _fans(polygons: np.ndarray) -> np.ndarray:
    """Cut convex polygons (P, k) into triangles (T, 3)."""
    k = np.arange(1, polygons.shape[1] - 1)
    return np.stack([np.broadcast_to(polygons[:, :1], (len(polygons), len(k))), polygons[:, k],
                     polygons[:, k + 1]], axis=2).reshape(-1, 3)


def _read_obj(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    vertices, loops = [], []
    text = data.decode('utf-8', errors='replace')
    for line in re.sub(r'\\\r?\n', ' ', text).splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == 'v':
            vertices.append([float(word) for word in words[1:4]])
        elif words[0] == 'f':
            loop = [int(word.split('/')[0]) for word in words[1:]]
            # counted from 1, or backwards from the end
            loops.append([k - 1 if k > 0 else len(vertices) + k for k in loop])
    places = np.array(vertices, float).reshape(-1, 3)
    return places, _cut(places, loops)


def _read_stl(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    count = int.from_bytes(data[80:84], 'little') if len(data) >= 84 else -1
    size = 84 + 50 * count
    # some programs write more behind the triangles
    if len(data) == size or 0 < count and size < len(data):
        record = np.dtype([('normal', '<f4', 3), ('corners', '<f4', (3, 3)), ('rest', '<u2')])
        corners = np.frombuffer(data, record, count, 84)['corners'].reshape(-1, 3).astype(float)
    else:
        text = data.decode('ascii', errors='replace')
        found = re.findall(r'vertex\s+(\S+)\s+(\S+)\s+(\S+)', text, re.IGNORECASE)
        if not found and not text.lstrip().lower().startswith('solid'):
            raise ValueError('it does not begin with "solid", as text would, and is not as long '
                             'as its number of triangles says')
        corners = np.array(found, float).reshape(-1, 3)
        if len(corners) % 3:
            raise ValueError('a facet has not three corners')
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _read_ply(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    end = data.index(b'end_header')
    head = data[:end].decode('ascii', errors='replace').split('\n')
    body = data[data.index(b'\n', end) + 1:]
    kind = next((line.split()[1] for line in head if line.startswith('format ')), '')
    if kind not in _ORDERS:
        raise ValueError('its header names no format that is known')
    elements: list[tuple[str, int, list[list[str]]]] = []
    for line in head:
        words = line.split()
        if words[:1] == ['element']:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ['property']:
            elements[-1][2].append(words[1:])
    lines = [line.split() for line in body.decode('ascii', errors='replace').splitlines()
             ] if kind == 'ascii' else []
    lines = [line for line in lines if line]
    vertices, loops, at = np.zeros((0, 3)), [], 0
    for name, count, properties in elements:
        names = [p[-1] for p in properties]
        lists = [k for k, p in enumerate(properties) if p[0] == 'list']
        if kind != 'ascii' and not lists:
            record = _record(properties, [], _ORDERS[kind])
            block = np.frombuffer(body, record, count, at)
            at += count * record.itemsize
            if name == 'vertex':
                vertices = np.column_stack([block[f'v{names.index(axis)}'] for axis in 'xyz']
                                           ).astype(float)
            continue
        if kind == 'ascii':
            rows = [tuple(_row(line, properties)) for line in lines[at:at + count]]
            at += count
        else:
            rows, at = _rows(body, at, count, properties, _ORDERS[kind])
        if name == 'vertex':
            column = [names.index(axis) for axis in 'xyz']
            vertices = np.array([[row[k] for k in column] for row in rows], float).reshape(-1, 3)
        elif name == 'face':
            corners = min(lists, key=lambda k: not names[k].startswith('vertex'))
            loops = [[int(word) for word in row[corners]] for row in rows]
    return vertices, _cut(vertices, loops)


def _row(words: list[str], properties: list[list[str]]) -> list[Any]:
    """Values of one line of text: a word for each property, and a list of words for a list."""
    row: list[Any] = []
    at = 0
    for kind, *_ in properties:
        if kind == 'list':
            count = int(words[at])
            row.append(words[at + 1:at + 1 + count])
            at += count
        else:
            row.append(words[at])
        at += 1
    return row


def _rows(body: bytes, at: int, count: int, properties: list[list[str]], order: str,
          ) -> tuple[list[tuple[Any, ...]], int]:
    """Values of binary rows from a place on, as `_row` has them, and the place behind."""
    rows: list[tuple[Any, ...]] = []
    most = _TOGETHER
    while properties and len(rows) < count:
        lengths, place = [], at
        for kind, *rest in properties:
            size = np.dtype(order + _TYPES[rest[0] if kind == 'list' else kind])
            if kind == 'list':
                lengths.append(int(np.frombuffer(body, size, 1, place)[0]))
                place += lengths[-1] * np.dtype(_TYPES[rest[1]]).itemsize
            place += size.itemsize
        record = _record(properties, lengths, order)
        there = min(count - len(rows), (len(body) - at) // record.itemsize)
        if there < 1:
            raise ValueError('it ends too early')
        # as long as rows have lists of one length they are read together
        block = np.frombuffer(body, record, min(there, most), at)
        alike = np.ones(len(block), bool)
        for k, p in enumerate(properties):
            if p[0] == 'list':
                alike &= block[f'n{k}'] == block[f'n{k}'][0]
        most = most * 4 if alike.all() else _TOGETHER
        block = block if alike.all() else block[:int(np.argmin(alike))]
        rows += zip(*(block[f'v{k}'].tolist() for k in range(len(properties))))
        at += len(block) * record.itemsize
    return rows, at


def _record(properties: list[list[str]], lengths: list[int], order: str) -> np.dtype[np.void]:
    """Layout of a binary row whose lists have these lengths: values v0, v1, ...; lengths n..."""
    fields: list[tuple[Any, ...]] = []
    length = iter(lengths)
    for k, (kind, *rest) in enumerate(properties):
        if kind == 'list':
            fields += [(f'n{k}', order + _TYPES[rest[0]]),
                       (f'v{k}', order + _TYPES[rest[1]], (next(length),))]
        else:
            fields.append((f'v{k}', order + _TYPES[kind]))
    return np.dtype(fields)


_READERS: dict[str, Callable[[bytes], tuple[np.ndarray, np.ndarray]]] = {
    '.obj': _read_obj, '.ply': _read_ply, '.stl': _read_stl}
