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
"""Writing ViSP's .cao files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import InputError
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.wireframe import Conic, WireframeModel

#: Axes of a circle differ by this share at the most, and are square up to this cosine.
_ROUND = 0.02
#: What ViSP calls the least size in the image.
_LENGTH, _AREA = 'minLineLengthThreshold', 'minPolygonAreaThreshold'


def write_cao(model: WireframeModel, path: str | Path, replace: bool = True) -> Path:
    """
    Write a model as ViSP's ``.cao``, to a temporary file that is then renamed.

    Borders of faces are not written as lines: who reads the file draws them anyway. Those with a
    least length are, for only a line can have one.

    Parameters
    ----------
    model : WireframeModel
    path : str or Path
    replace : bool
        Whether a file with content may be replaced.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the model has an ellipse that is no circle, or the file cannot be written.

    """
    path = Path(path)
    points = [np.asarray(vertex, float) for vertex in model.vertices]

    def point(xyz: ArrayLike) -> int:
        points.append(np.asarray(xyz, float))
        return len(points) - 1

    borders = {frozenset(pair) for face in model.faces for pair in face.borders()}
    lines = [f'{a} {b}{_name(name)}{_least(_LENGTH, least)}' for (a, b), name, least in zip(
        model.lines, model.line_names, model.line_min_length_px)
        if least > 0 or frozenset((int(a), int(b))) not in borders]
    cylinders = [f'{point(c.start)} {point(c.end)} {c.radius_m:.9g}{_name(c.name)}'
                 f'{_least(_LENGTH, c.min_length_px)}' for c in model.cylinders]
    circles = [_circle(conic, point, path) for conic in model.conics]
    parts = [
        'V1',
        *_list('points', [' '.join(f'{value:.9g}' for value in xyz) for xyz in points]),
        *_list('lines', lines),
        *_list('faces from lines', []),
        *_list('faces from points', [
            f'{len(face.indices)} {" ".join(map(str, face.indices))}{_name(face.name)}'
            f'{_least(_AREA, face.min_area_px2)}' for face in model.faces]),
        *_list('cylinders', cylinders), *_list('circles', circles)]
    return atomic_write(path, '\n'.join(parts) + '\n', replace)


def _list(title: str, rows: Sequence[str]) -> list[str]:
    return [f'# {title}', str(len(rows)), *rows]


def _name(name: str) -> str:
    """Write a name as a parameter; quotes and line ends cannot be in it."""
    plain = ''.join(letter for letter in name if letter.isprintable() and letter not in '"#')
    return f' name="{plain}"' if plain else ''


def _least(key: str, pixels: float) -> str:
    """Write the least size in the image as parameters; nothing where there is none."""
    return f' useLod=true {key}={pixels:.9g}' if pixels > 0 else ''


def _circle(conic: Conic, point: Callable[[np.ndarray], int], path: Path) -> str:
    u, v = np.linalg.norm(conic.axis_u), np.linalg.norm(conic.axis_v)
    if abs(u - v) > _ROUND * max(u, v) or abs(conic.axis_u @ conic.axis_v) > _ROUND * u * v:
        raise InputError(f'{path} cannot be written: a .cao file holds circles, but the model '
                         'has an ellipse; write a .yaml file.')
    centre = point(conic.centre)
    return (f'{0.5 * (u + v):.9g} {centre} {point(conic.centre + conic.axis_u)} '
            f'{point(conic.centre + conic.axis_v)}{_name(conic.name)}')
