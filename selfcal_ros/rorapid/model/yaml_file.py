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
Our own model files: YAML with the content of a `.cao` file, ellipses as well.

::

    model: house            # the name
    points:                 # metres, object frame; counted from 0
    - [0, 0, 0]
    - [0.1, 0, 0]
    - [0.1, 0.1, 0]
    faces:                  # opaque; their borders are tracked
    - [0, 1, 2]
    - {points: [0, 1, 2], name: roof, min_area_px2: 100}
    lines:                  # further lines: markings
    - [0, 2]
    - {points: [0, 2], name: seam, min_length_px: 20}
    conics:                 # centre + cos t axis_u + sin t axis_v
    - {centre: [0, 0, 0], axis_u: [0.02, 0, 0], axis_v: [0, 0.01, 0], name: ring}
    circles:
    - {centre: [0, 0, 0], normal: [0, 0, 1], radius: 0.02}
    cylinders:
    - {start: [0, 0, 0], end: [0, 0, 0.1], radius: 0.03, name: post}
    face_borders: true      # false: only what `lines` names is tracked
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.rotation import align_z
from selfcal_ros.rorapid.model.text_file import read_text
from selfcal_ros.values.foreign_files import load_foreign_yaml
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.wireframe import Conic, Cylinder, LIMIT, Polygon, WireframeModel
import yaml

#: A YAML file takes long to parse; no sensible model is longer.
LARGEST_YAML = 2_000_000
_LISTS = ('points', 'lines', 'faces', 'conics', 'circles', 'cylinders')
_KEYS = {'model', 'face_borders', *_LISTS}
#: Keys of a part of the model, and what they hold.
_Entry: TypeAlias = dict[str, Any]


def read_model_yaml(path: str | Path) -> WireframeModel:
    """
    Read a YAML model.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    WireframeModel

    Raises
    ------
    InputError
        If the file is no such model; the sentence says which entry is wrong.

    """
    path = Path(path)
    text = read_text(path)
    if len(text) > LARGEST_YAML:
        raise InputError(f'The model {path} is longer than {LARGEST_YAML} characters.')
    data = load_foreign_yaml(text, str(path))
    try:
        return _model(data, path.stem)
    except ArgumentError as error:
        raise InputError(f'{path} is no model that can be used: {error}') from None


def write_model_yaml(model: WireframeModel, path: str | Path, replace: bool = True) -> Path:
    """
    Write a model as YAML, to a temporary file that is then renamed.

    Reading it back gives the same vertices, lines, faces, conics and cylinders in the same
    order. See `atomic_write` for `replace`.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    path = Path(path)
    lengths = model.line_min_length_px
    data = {
        'model': model.name,
        'points': [_floats(v) for v in model.vertices],
        'lines': [_entry([int(a), int(b)], name, 'min_length_px', float(least))
                  for (a, b), name, least in zip(model.lines, model.line_names, lengths)],
        'faces': [_entry(list(f.indices), f.name, 'min_area_px2', float(f.min_area_px2))
                  for f in model.faces],
        'conics': [_named({'centre': _floats(c.centre), 'axis_u': _floats(c.axis_u),
                           'axis_v': _floats(c.axis_v)}, c.name) for c in model.conics],
        'cylinders': [_named({'start': _floats(c.start), 'end': _floats(c.end),
                              'radius': float(c.radius_m)}, c.name, 'min_length_px',
                             float(c.min_length_px)) for c in model.cylinders],
        # all lines are written down: the borders among them are not to be added again
        'face_borders': False,
    }
    data = {key: value for key, value in data.items() if value not in ([], '')}
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=99)
    return atomic_write(path, text, replace)


def _floats(vector: np.ndarray) -> list[float]:
    return [float(value) for value in vector]


def _entry(points: list[int], name: str, key: str, value: float) -> _Entry | list[int]:
    """Plain list of points, or a mapping where there is more to say."""
    entry = _named({'points': points}, name, key, value)
    return entry if len(entry) > 1 else points


def _named(entry: _Entry, name: str, key: str = '', value: float = 0.0) -> _Entry:
    if name:
        entry['name'] = name
    if value:
        entry[key] = value
    return entry


def _model(data: Any, name: str) -> WireframeModel:
    """Check what YAML gave and make the model."""
    if not isinstance(data, dict) or not any(key in data for key in _LISTS):
        raise ArgumentError('it must hold lists named points, lines and faces.')
    if unknown := [key for key in data if key not in _KEYS]:
        raise ArgumentError(f'there is no key {str(unknown[0])[:40]!r}; there are '
                            f'{", ".join(sorted(_KEYS))}.')
    lists = {key: _list(data, key) for key in _LISTS}
    points = [_numbers(p, 3, f'point {k}') for k, p in enumerate(lists['points'])]
    lines, names, lengths = [], [], []
    for k, entry in enumerate(lists['lines']):
        where = f'line {k}'
        indices, entry = _indices(entry, where, {'points', 'name', 'min_length_px'})
        if len(indices) != 2:
            raise ArgumentError(f'{where} must name two points.')
        if max(indices) >= len(points):
            raise ArgumentError(f'{where} names a point that does not exist; there are '
                                f'{len(points)}, counted from 0.')
        lines.append(indices)
        names.append(_name(entry, where))
        lengths.append(_number(entry.get('min_length_px', 0.0), where, least=0.0))
    faces = []
    for k, entry in enumerate(lists['faces']):
        where = f'face {k}'
        indices, entry = _indices(entry, where, {'points', 'name', 'min_area_px2'})
        faces.append(Polygon(tuple(indices), _name(entry, where),
                             _number(entry.get('min_area_px2', 0.0), where, least=0.0)))
    borders = data.get('face_borders', True)
    if not isinstance(borders, bool):
        raise ArgumentError('face_borders must be true or false.')
    make = WireframeModel.build if borders else WireframeModel
    return make(np.array(points), np.array(lines, int).reshape(-1, 2), tuple(faces),
                line_names=tuple(names), line_min_length_px=np.array(lengths, float),
                conics=tuple(_conics(lists)), cylinders=tuple(_cylinders(lists)),
                name=_name({'name': data.get('model', name)}, 'model'))


def _conics(lists: dict[str, list[Any]]) -> list[Conic]:
    conics = []
    for k, entry in enumerate(lists['conics']):
        where = f'conic {k}'
        entry = _mapping(entry, where, {'centre', 'axis_u', 'axis_v'}, {'name'})
        centre, axis_u, axis_v = (np.array(_numbers(entry[key], 3, where))
                                  for key in ('centre', 'axis_u', 'axis_v'))
        conics.append(Conic(centre, axis_u, axis_v, _name(entry, where)))
    for k, entry in enumerate(lists['circles']):
        where = f'circle {k}'
        entry = _mapping(entry, where, {'centre', 'normal', 'radius'}, {'name'})
        normal = np.array(_numbers(entry['normal'], 3, where))
        if not np.linalg.norm(normal) > 0:
            raise ArgumentError(f'{where} has no normal.')
        axes = _number(entry['radius'], where, least=0.0) * align_z(normal)
        conics.append(Conic(np.array(_numbers(entry['centre'], 3, where)), axes[:, 0], axes[:, 1],
                            _name(entry, where)))
    return conics


def _cylinders(lists: dict[str, list[Any]]) -> list[Cylinder]:
    cylinders = []
    for k, entry in enumerate(lists['cylinders']):
        where = f'cylinder {k}'
        entry = _mapping(entry, where, {'start', 'end', 'radius'}, {'name', 'min_length_px'})
        start, end = (np.array(_numbers(entry[key], 3, where)) for key in ('start', 'end'))
        cylinders.append(Cylinder(
            start, end, _number(entry['radius'], where), _name(entry, where),
            _number(entry.get('min_length_px', 0.0), where, least=0.0)))
    return cylinders


def _list(data: dict[str, Any], key: str) -> list[Any]:
    value = data.get(key)
    value = [] if value is None else value
    if not isinstance(value, list) or len(value) > LIMIT:
        raise ArgumentError(f'{key} must be a list of at most {LIMIT} entries.')
    return value


def _indices(entry: Any, where: str, keys: set[str]) -> tuple[list[int], _Entry]:
    """Points of a line or face, and the mapping that they may come in."""
    if isinstance(entry, list):
        entry = {'points': entry}
    entry = _mapping(entry, where, {'points'}, keys)
    indices = entry['points']
    if not isinstance(indices, list) or not indices or not all(
            isinstance(i, int) and not isinstance(i, bool) and 0 <= i < LIMIT for i in indices):
        raise ArgumentError(f'{where} must be a list of points, numbered from 0.')
    return indices, entry


def _mapping(entry: object, where: str, needed: set[str], allowed: set[str]) -> _Entry:
    if not isinstance(entry, dict) or not needed <= set(entry) <= needed | allowed:
        raise ArgumentError(f'{where} must have the keys {", ".join(sorted(needed))}, and may '
                            f'have {", ".join(sorted(allowed - needed))}.')
    return entry


def _numbers(value: object, count: int, where: str) -> list[float]:
    if not isinstance(value, list) or len(value) != count:
        raise ArgumentError(f'{where} must have {count} numbers where it has coordinates.')
    return [_number(v, where) for v in value]


def _number(value: Any, where: str, least: float = -1e6) -> float:
    """Return a finite number; YAML 1.1 takes 1e-3 for a word."""
    try:
        number = math.nan if isinstance(value, (bool, list, dict)) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not least <= number < 1e6:
        raise ArgumentError(f'{where} has {str(value)[:40]!r} where a number should be.')
    return number


def _name(entry: _Entry, where: str) -> str:
    name = entry.get('name', '')
    if not isinstance(name, (str, int, float)) or len(str(name)) > 200:
        raise ArgumentError(f'{where} must have a short word for its name.')
    return str(name)
