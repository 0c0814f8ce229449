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
"""Writing Wavefront .obj files, for programs that draw models."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.wireframe import WireframeModel

#: Corners of the polygon that stands for an ellipse.
_CORNERS = 64


def write_obj(model: WireframeModel, path: str | Path, replace: bool = True) -> Path:
    """
    Write a model as ``.obj``, to a temporary file that is then renamed.

    Faces are `f`, lines `l`; ellipses are closed lines of 64 corners. Cylinders have no such
    element and are written as their axes.

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
        If the file cannot be written.

    """
    points = [np.asarray(model.vertices, float).reshape(-1, 3)]
    count = len(points[0])
    elements = [f'f {_numbers(face.indices)}' for face in model.faces]
    elements += [f'l {_numbers(pair)}' for pair in model.lines]
    angles = np.arange(_CORNERS) * 2 * np.pi / _CORNERS
    for conic in model.conics:
        points.append(conic.points(angles))
        elements.append(f'l {_numbers([*range(count, count + _CORNERS), count])}')
        count += _CORNERS
    for cylinder in model.cylinders:
        points.append(np.array([cylinder.start, cylinder.end], float))
        elements.append(f'l {_numbers((count, count + 1))}')
        count += 2
    rows = [f'v {x:.9g} {y:.9g} {z:.9g}' for x, y, z in np.concatenate(points)]
    return atomic_write(Path(path), '\n'.join(['# metres', *rows, *elements]) + '\n',
                        replace)


def _numbers(indices: Iterable[int]) -> str:
    """Write indices as they are counted in the file, from 1."""
    return ' '.join(str(int(index) + 1) for index in indices)
