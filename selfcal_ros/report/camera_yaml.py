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
Camera files as camera_calibration_parsers writes and reads them.

The keys, their order and their shapes are those of its YAML writer; a reader that misses one of
them reports only 'file not found'. Evidence goes into comments, which every reader skips.
"""

from __future__ import annotations

from collections.abc import Iterable
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.yaml_text import (decoded, load_yaml, matrix, number_text,
                                          positive_integer, read_bytes)
from selfcal_ros.values.output_files import atomic_write
from selfcal_ros.values.ros_lenses import ROS_COEFFICIENTS, ros_distortion
import yaml

#: Lens models that image_geometry knows.
ROS_MODELS = tuple(ROS_COEFFICIENTS)
_NAME = re.compile(r'[A-Za-z0-9_]+\Z')
#: Keys that a camera file must have.
REQUIRED = ('image_width', 'image_height', 'camera_matrix', 'distortion_coefficients',
            'rectification_matrix', 'projection_matrix')


def camera_yaml(camera: Camera, name: str, comments: Iterable[str] = ()) -> str:
    """
    Return the text of a camera file.

    Parameters
    ----------
    camera : Camera
        With its image size; its lens model must be one of `ROS_MODELS`.
    name : str
        Camera name: letters, digits and underscores.
    comments : iterable of str
        Lines to put at the top after '# '.

    Raises
    ------
    ArgumentError
        If the name is impossible or the image size is not known.

    """
    if camera.width <= 0 or camera.height <= 0:
        raise ArgumentError('A camera file needs the image size; give the camera its width and '
                            'height.')
    if camera.model not in ROS_MODELS:
        raise ArgumentError(f'A camera file of ROS cannot hold the lens model {camera.model}.')
    return ros_yaml((camera.width, camera.height), name, camera.K, camera.model,
                    camera.distortion, np.eye(3), np.column_stack([camera.K, np.zeros(3)]),
                    comments)


def ros_yaml(size: tuple[int, int], name: str, K: np.ndarray, model: str, d: np.ndarray,
             R: np.ndarray, P: np.ndarray, comments: Iterable[str] = ()) -> str:
    """
    Return the text of a camera file, given what it holds.

    Parameters
    ----------
    size : (int, int)
        Width and height.
    name : str
        Camera name: letters, digits and underscores.
    K, R : ndarray, shape (3, 3)
    model : str
        Of the lens.
    d : ndarray, shape (N,)
        Its coefficients.
    P : ndarray, shape (3, 4)
    comments : iterable of str
        Lines to put at the top after '# '.

    Raises
    ------
    ArgumentError
        If the name is impossible.

    """
    check_camera_name(name)
    lines = ['# ' + ''.join(c if c.isprintable() else ' ' for c in line)
             for comment in comments for line in str(comment).splitlines()]
    lines += [f'image_width: {size[0]}', f'image_height: {size[1]}',
              f'camera_name: {_string(name)}']
    lines += _matrix('camera_matrix', K)
    lines += [f'distortion_model: {_string(model)}']
    lines += _matrix('distortion_coefficients', d[None])
    lines += _matrix('rectification_matrix', R)
    lines += _matrix('projection_matrix', P)
    lines += ['binning_x: 0', 'binning_y: 0', 'roi:', '  x_offset: 0', '  y_offset: 0',
              '  height: 0', '  width: 0', '  do_rectify: false']
    return '\n'.join(lines) + '\n'


def check_camera_name(name: str) -> None:
    """Refuse a name that no camera file can hold; ArgumentError."""
    if not _NAME.match(name):
        raise ArgumentError(f'The camera name {name!r:.60} is impossible; use letters, digits and '
                            'underscores.')


def _string(text: str) -> str:
    """Quote what YAML would not take for a string: 00123, 1e5, yes, null."""
    plain = _NAME.match(text) and isinstance(yaml.safe_load(text), str) and not text[0].isdigit()
    return text if plain else json.dumps(text)


def write_camera_yaml(path: str | Path, camera: Camera, name: str,
                      comments: Iterable[str] = (), replace: bool = True) -> Path:
    """
    Write a camera file; it appears whole or not at all.

    See `camera_yaml` for the parameters, and `atomic_write` for `replace`.

    Raises
    ------
    ArgumentError
        If the name is impossible or the image size is not known.
    InputError
        If the file cannot be written.

    """
    return atomic_write(path, camera_yaml(camera, name, comments), replace)


def _matrix(key: str, matrix: np.ndarray) -> list[str]:
    data = ', '.join(number_text(value) for value in matrix.ravel())
    return [f'{key}:', f'  rows: {matrix.shape[0]}', f'  cols: {matrix.shape[1]}',
            f'  data: [{data}]']


def read_camera_yaml(path: str | Path) -> tuple[Camera, str]:
    """
    Read a camera file of ROS.

    Returns
    -------
    camera : Camera
    name : str
        'unknown' where the file does not name the camera.

    Raises
    ------
    InputError
        If the file is missing, of another kind (the sentence names it), or incomplete.

    """
    return parse_camera_yaml(decoded(read_bytes(path), path), str(path))


def parse_camera_yaml(text: str, source: str = 'the text') -> tuple[Camera, str]:
    """Parse the text of a camera file; `source` names it in errors. See `read_camera_yaml`."""
    return camera_from_document(ros_document(text, source), source)


def ros_document(text: str, source: str) -> dict[str, Any]:
    """
    Return the keys of a camera file of ROS, which are all there.

    Raises
    ------
    InputError
        If it is of another kind, or incomplete.

    """
    convert = 'convert it with `selfcal convert`'
    if text.lstrip().startswith('%YAML') or '!!opencv-matrix' in text:
        raise InputError(f'{source} is an OpenCV FileStorage file, not a ROS camera file; '
                         f'{convert}.')
    document = load_yaml(text, source)
    if is_kalibr(document):
        raise InputError(f'{source} is a Kalibr file, not a ROS camera file; {convert}.')
    _check_keys(document, source)
    return document


def _check_keys(document: dict[str, Any], source: str) -> None:
    missing = [key for key in REQUIRED if key not in document]
    if missing:
        raise InputError(f'{source} lacks {", ".join(missing)}; a ROS camera file has them all.')


def is_kalibr(document: dict[str, Any]) -> bool:
    """Tell a camera chain of Kalibr by its key 'intrinsics'."""
    return 'intrinsics' in document or any(
        isinstance(value, dict) and 'intrinsics' in value for value in document.values())


def camera_from_document(document: dict[str, Any], source: str) -> tuple[Camera, str]:
    """
    Return camera and name from the keys of a ROS camera file.

    Raises
    ------
    InputError
        If the file is incomplete, or its lens model is unknown.

    """
    _check_keys(document, source)
    sizes = [positive_integer(document[key], f'{source}: {key}') for key in REQUIRED[:2]]
    K = matrix(document, 'camera_matrix', (3, 3), source)
    matrix(document, 'rectification_matrix', (3, 3), source)
    matrix(document, 'projection_matrix', (3, 4), source)
    distortion = matrix(document, 'distortion_coefficients', (1, None), source).ravel()
    model = str(document.get('distortion_model', 'plumb_bob'))
    if K[0, 0] == 0:
        raise InputError(f'{source} is of a camera that is not calibrated (its focal length is '
                         'zero).')
    try:
        distortion = ros_distortion(model, distortion)
        camera = Camera(K, distortion, sizes[0], sizes[1], model)
    except ArgumentError as error:
        raise InputError(f'{source}: {error}') from None
    return camera, str(document.get('camera_name') or 'unknown')
