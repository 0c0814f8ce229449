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

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.values.foreign_files import read_limited
from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.polyhedron import polyhedron
from selfcal_ros.values.wireframe import WireframeModel

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
        raise InputError(f'{path} would be {size:.3g} m large; say its unit with --model-scale '
                         '(0.001 where it is in millimetres).')
    try:
        mesh = MeshModel.build(vertices * scale, triangles, path.stem)
    except ArgumentError as error:
        raise InputError(f'{path} cannot be used: {error}') from None
    plane = polyhedron(mesh)
    return mesh if plane is None else plane


def _fan(loop: list[int]) -> list[tuple[int, int, int]]:
    """Cut a polygon into triangles."""
    return [(loop[0], loop[k], loop[k + 1]) for k in range(1, len(loop) - 1)]


def _read_obj(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    vertices, triangles = [], []
    for line in data.decode('utf-8', errors='replace').splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == 'v':
            vertices.append([float(word) for word in words[1:4]])
        elif words[0] == 'f':
            loop = [int(word.split('/')[0]) for word in words[1:]]
            # counted from 1, or backwards from the end
            triangles += _fan([k - 1 if k > 0 else len(vertices) + k for k in loop])
    return np.array(vertices, float).reshape(-1, 3), np.array(triangles, int).reshape(-1, 3)


def _read_stl(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    count = int.from_bytes(data[80:84], 'little') if len(data) >= 84 else -1
    if len(data) == 84 + 50 * count:
        record = np.dtype([('normal', '<f4', 3), ('corners', '<f4', (3, 3)), ('rest', '<u2')])
        corners = np.frombuffer(data, record, count, 84)['corners'].reshape(-1, 3).astype(float)
    else:
        text = data.decode('ascii', errors='replace')
        found = re.findall(r'vertex\s+(\S+)\s+(\S+)\s+(\S+)', text)
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
    if kind == 'ascii':
        return _ply_text(body, elements)
    order = _ORDERS[kind]
    vertices, triangles, at = np.zeros((0, 3)), [], 0
    for name, count, properties in elements:
        if name != 'face' or properties[0][0] != 'list':
            record = np.dtype([(p[-1], order + _TYPES[p[0]]) for p in properties])
            rows = np.frombuffer(body, record, count, at)
            at += count * record.itemsize
            if name == 'vertex':
                vertices = np.column_stack([rows[axis] for axis in 'xyz']).astype(float)
            continue
        size, index = (np.dtype(order + _TYPES[word]) for word in properties[0][1:3])
        rest = sum(np.dtype(_TYPES[p[0]]).itemsize for p in properties[1:])
        for _ in range(count):
            corners = int(np.frombuffer(body, size, 1, at)[0])
            at += size.itemsize
            loop = np.frombuffer(body, index, corners, at).tolist()
            at += corners * index.itemsize + rest
            triangles += _fan(loop)
    return vertices, np.array(triangles, int).reshape(-1, 3)


def _ply_text(body: bytes, elements) -> tuple[np.ndarray, np.ndarray]:
    lines = [line.split() for line in body.decode('ascii', errors='replace').splitlines()]
    lines = [line for line in lines if line]
    vertices, triangles, at = np.zeros((0, 3)), [], 0
    for name, count, properties in elements:
        part = lines[at:at + count]
        at += count
        if name == 'vertex':
            names = [p[-1] for p in properties]
            vertices = np.array([[float(row[names.index(axis)]) for axis in 'xyz']
                                 for row in part]).reshape(-1, 3)
        elif name == 'face':
            for row in part:
                triangles += _fan([int(word) for word in row[1:1 + int(row[0])]])
    return vertices, np.array(triangles, int).reshape(-1, 3)


_READERS: dict[str, Callable[[bytes], tuple[np.ndarray, np.ndarray]]] = {
    '.obj': _read_obj, '.ply': _read_ply, '.stl': _read_stl}
