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
from selfcal_ros.rorapid.model.yaml_file import read_model_yaml, write_model_yaml
from selfcal_ros.values.wireframe import WireframeModel


def read_model(path) -> WireframeModel:
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


def write_model(model: WireframeModel, path) -> Path:
    """
    Write a model as ``.yaml``.

    Raises
    ------
    InputError
        If the name does not end in ``.yaml`` or ``.yml``, or the file cannot be written.

    """
    path = Path(path)
    if path.suffix.lower() not in ('.yaml', '.yml'):
        raise InputError(f'The model {path} must be named .yaml to be written.')
    return write_model_yaml(model, path)
