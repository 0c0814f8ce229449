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
"""Reading and writing models of objects, by the ending of the file name."""

from __future__ import annotations

from pathlib import Path

from selfcal_ros.errors import InputError
from selfcal_ros.rorapid.model.cao_file import read_cao
from selfcal_ros.rorapid.model.cao_writer import write_cao
from selfcal_ros.rorapid.model.mesh_file import read_mesh
from selfcal_ros.rorapid.model.obj_writer import write_obj
from selfcal_ros.rorapid.model.yaml_file import read_model_yaml, write_model_yaml
from selfcal_ros.values.wireframe import WireframeModel

_WRITERS = {'.cao': write_cao, '.obj': write_obj, '.yaml': write_model_yaml,
            '.yml': write_model_yaml}


def read_model(path: str | Path, scale: float = 1.0) -> WireframeModel:
    """
    Read a model: ViSP's ``.cao``, our own ``.yaml``, or a mesh (``.obj``, ``.ply``, ``.stl``).

    Parameters
    ----------
    path : str or Path
    scale : float
        Metres per unit of a mesh; a wireframe is in metres.

    Returns
    -------
    WireframeModel

    Raises
    ------
    InputError
        If the file cannot be used; the sentence says where and why.

    """
    path = Path(path)
    if not 0 < scale < 1e9:
        raise InputError(f'The scale of a model must be positive, not {scale!r}.')
    if path.suffix.lower() in ('.obj', '.ply', '.stl'):
        return read_mesh(path, scale)
    if scale != 1:
        raise InputError(f'The model {path} is in metres; only meshes can be scaled.')
    if path.suffix.lower() == '.cao':
        return read_cao(path)
    if path.suffix.lower() in ('.yaml', '.yml'):
        return read_model_yaml(path)
    raise InputError(f'The model {path} must be a .cao, .yaml, .obj, .ply or .stl file.')


def write_model(model: WireframeModel, path: str | Path, replace: bool = True) -> Path:
    """
    Write a model: ``.cao``, ``.yaml``, or ``.obj`` for programs that draw it.

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
        If the name has another ending, the file cannot be written, or its format cannot hold
        the model (a .cao file holds circles, but no ellipses).

    """
    path = Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise InputError(f'The model {path} must be named .cao, .yaml or .obj to be written.')
    return writer(model, path, replace)
