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
from pathlib import Path
import re

import numpy as np
import yaml

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.files import atomic_write

#: A camera file is far smaller; whatever is larger is something else.
MAX_BYTES = 1_000_000
_NAME = re.compile(r'^[A-Za-z0-9_]+$')
_REQUIRED = ('image_width', 'image_height', 'camera_matrix', 'distortion_coefficients',
             'rectification_matrix', 'projection_matrix')


def camera_yaml(camera: Camera, name: str, comments: Iterable[str] = ()) -> str:
    """
    Return the text of a camera file.

    Parameters
    ----------
    camera : Camera
        With its image size.
    name : str
        Camera name: letters, digits and underscores.
    comments : iterable of str
        Lines to put at the top after '# '.

    Raises
    ------
    ArgumentError
        If the name is impossible or the image size is not known.

    """
    if not _NAME.match(name):
        raise ArgumentError(f'The camera name {name!r:.60} is impossible; use letters, digits and '
                            'underscores.')
    if camera.width <= 0 or camera.height <= 0:
        raise ArgumentError('A camera file needs the image size; give the camera its width and '
                            'height.')
    # a name such as 00123, 1e5, yes or null is no string unless it is quoted
    plain = isinstance(yaml.safe_load(name), str) and not name[0].isdigit()
    lines = ['# ' + ''.join(c if c.isprintable() else ' ' for c in line)
             for comment in comments for line in str(comment).splitlines()]
    lines += [f'image_width: {camera.width}', f'image_height: {camera.height}',
              f'camera_name: {name}' if plain else f'camera_name: "{name}"']
    lines += _matrix('camera_matrix', camera.K)
    lines += ['distortion_model: plumb_bob']
    lines += _matrix('distortion_coefficients', camera.distortion[None])
    lines += _matrix('rectification_matrix', np.eye(3))
    lines += _matrix('projection_matrix', np.column_stack([camera.K, np.zeros(3)]))
    lines += ['binning_x: 0', 'binning_y: 0', 'roi:', '  x_offset: 0', '  y_offset: 0',
              '  height: 0', '  width: 0', '  do_rectify: false']
    return '\n'.join(lines) + '\n'


def write_camera_yaml(path, camera: Camera, name: str, comments: Iterable[str] = ()) -> Path:
    """
    Write a camera file; it appears whole or not at all.

    See `camera_yaml` for the parameters.

    Raises
    ------
    ArgumentError
        If the name is impossible or the image size is not known.
    InputError
        If the file cannot be written.

    """
    return atomic_write(path, camera_yaml(camera, name, comments))


def _matrix(key: str, matrix: np.ndarray) -> list[str]:
    data = ', '.join(_number(value) for value in matrix.ravel())
    return [f'{key}:', f'  rows: {matrix.shape[0]}', f'  cols: {matrix.shape[1]}',
            f'  data: [{data}]']


def _number(value: float) -> str:
    """Write a float that comes back bit-exact, from PyYAML, too."""
    text = repr(float(value))
    mantissa, mark, exponent = text.partition('e')
    # YAML 1.1 takes 1e-05 for a string
    return f'{mantissa}.0e{exponent}' if mark and '.' not in mantissa else text


def read_camera_yaml(path) -> tuple[Camera, str]:
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
    path = Path(path)
    try:
        with path.open('rb') as stream:
            raw = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise InputError(f'{path} cannot be read: {getattr(error, "strerror", error)}.') from None
    if len(raw) > MAX_BYTES:
        raise InputError(f'{path} is too large for a camera file.')
    try:
        text = raw.decode('utf-8-sig')
    except UnicodeDecodeError:
        raise InputError(f'{path} is no camera file: it is not text.') from None
    return parse_camera_yaml(text, str(path))


def parse_camera_yaml(text: str, source: str = 'the text') -> tuple[Camera, str]:
    """Parse the text of a camera file; `source` names it in errors. See `read_camera_yaml`."""
    convert = 'convert it with `selfcal convert`'
    if text.lstrip().startswith('%YAML:') or '!!opencv-matrix' in text:
        raise InputError(f'{source} is an OpenCV FileStorage file, not a ROS camera file; '
                         f'{convert}.')
    try:
        # a plain scan without Python objects; camera_name is taken as written, so that 00123
        # stays what it is
        document = yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, RecursionError, ValueError, AttributeError, LookupError,
            TypeError) as error:
        # explicit tags on values that do not fit them raise the latter four
        where = getattr(error, 'problem_mark', None)
        line = f' (line {where.line + 1})' if where else ''
        raise InputError(f'{source} is not valid YAML{line}.') from None
    if not isinstance(document, dict):
        raise InputError(f'{source} is no camera file: it holds no keys.')
    if 'intrinsics' in document or any(
            isinstance(v, dict) and 'intrinsics' in v for v in document.values()):
        raise InputError(f'{source} is a Kalibr file, not a ROS camera file; {convert}.')
    missing = [key for key in _REQUIRED if key not in document]
    if missing:
        raise InputError(f'{source} lacks {", ".join(missing)}; a ROS camera file has them all.')
    sizes = [_integer(document[key], f'{source}: {key}') for key in _REQUIRED[:2]]
    K = _read_matrix(document, 'camera_matrix', (3, 3), source)
    _read_matrix(document, 'rectification_matrix', (3, 3), source)
    _read_matrix(document, 'projection_matrix', (3, 4), source)
    distortion = _read_matrix(document, 'distortion_coefficients', (1, None), source).ravel()
    model = str(document.get('distortion_model', 'plumb_bob'))
    if K[0, 0] == 0:
        raise InputError(f'{source} is of a camera that is not calibrated (its focal length is '
                         'zero).')
    if model not in ('plumb_bob', 'rational_polynomial') or distortion[5:].any():
        raise InputError(f'{source}: the distortion model {model!r:.40} with {distortion.size} '
                         'coefficients is not supported; plumb_bob with up to five is.')
    if distortion.size < 4:
        distortion = np.pad(distortion, (0, 4 - distortion.size))
    try:
        camera = Camera(K, distortion[:5], *sizes)
    except ArgumentError as error:
        raise InputError(f'{source}: {error}') from None
    return camera, str(document.get('camera_name') or 'unknown')


class _Loader(yaml.SafeLoader):
    """Safe YAML in which every scalar is the string that was written."""


_Loader.yaml_implicit_resolvers = {}


def _integer(value, where: str) -> int:
    try:
        number = int(value)
    except (TypeError, ValueError):
        number = 0
    if not 0 < number < 2 ** 31:
        raise InputError(f'{where} must be a positive integer.')
    return number


def _read_matrix(document: dict, key: str, shape: tuple, source: str) -> np.ndarray:
    """Return a matrix of the document; None in the shape: any length."""
    entry = document[key]
    if not (isinstance(entry, dict) and {'rows', 'cols', 'data'} <= entry.keys()):
        raise InputError(f'{source}: {key} must have rows, cols and data.')
    data = entry['data']
    if not isinstance(data, list) or (len(data) == 1 and isinstance(data[0], str)
                                      and len(data[0].split()) > 1):
        raise InputError(f'{source}: the data of {key} must be a list with commas, like '
                         '[1.0, 2.0].')
    try:
        rows, cols = int(entry['rows']), int(entry['cols'])
        values = np.array([float(value) for value in data])
    except (TypeError, ValueError):
        raise InputError(f'{source}: {key} holds something that is not a number; check its '
                         'commas.') from None
    if not np.isfinite(values).all():
        raise InputError(f'{source}: {key} holds a number that is not finite.')
    wanted = (shape[0], values.size if shape[1] is None else shape[1])
    if (rows, cols) != wanted or values.size != rows * cols:
        raise InputError(f'{source}: {key} must be {wanted[0]}x{shape[1] or "n"}, but says '
                         f'{rows}x{cols} and has {values.size} values.')
    return values.reshape(wanted)
