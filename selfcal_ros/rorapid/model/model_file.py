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
from selfcal_ros.rorapid.model.obj_writer import write_obj
from selfcal_ros.rorapid.model.yaml_file import read_model_yaml, write_model_yaml
from selfcal_ros.values.wireframe import WireframeModel

_WRITERS = {'.cao': write_cao, '.obj': write_obj, '.yaml': write_model_yaml,
            '.yml': write_model_yaml}


def read_model(path: str | Path) -> WireframeModel:
    """
    Read a model: ViSP's ``.cao``, or our own ``.yaml``.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    WireframeModel

    Raises
    ------
    InputError
        If the file cannot be used; the sentence says where and why.

    """
    path = Path(path)
    if path.suffix.lower() == '.cao':
        return read_cao(path)
    if path.suffix.lower() in ('.yaml', '.yml'):
        return read_model_yaml(path)
    raise InputError(f'The model {path} must be a .cao or a .yaml file.')


def write_model(model: WireframeModel, path: str | Path) -> Path:
    """
    Write a model: ``.cao``, ``.yaml``, or ``.obj`` for programs that draw it.

    Parameters
    ----------
    model : WireframeModel
    path : str or Path

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
    return writer(model, path)
