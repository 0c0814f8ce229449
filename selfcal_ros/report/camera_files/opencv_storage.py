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
Camera files of OpenCV's FileStorage: YAML, XML and JSON.

They are read without OpenCV, whose parser trusts its input. The keys are those of OpenCV's
calibration sample (camera_matrix, distortion_coefficients, image_width, fisheye_model), and the
spellings that its other samples and its users write; files of a stereo pair hold two cameras.
"""

from __future__ import annotations

from collections.abc import Iterable
import json
import re
from typing import Any
from xml.etree import ElementTree

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_files.stored import lens_camera, StoredCamera, without_skew
from selfcal_ros.report.yaml_text import load_yaml, matrix, number_text, positive_integer

#: Lens models that OpenCV has functions for, and that other programs share.
OPENCV_MODELS = ('plumb_bob', 'rational_polynomial', 'equidistant')
#: Numbers of coefficients that OpenCV's functions take.
_COUNTS, _FISHEYE_COUNTS = (4, 5, 8, 12, 14), (4,)
#: Spellings in lower case without separators; a digit may follow in files of a stereo pair.
_MATRIX = ('cameramatrix', 'k', 'm', 'intrinsicmatrix', 'intrinsics', 'cammatrix')
_DISTORTION = ('distortioncoefficients', 'distcoeffs', 'distortion', 'd', 'distcoeff')


def is_opencv(text: str) -> bool:
    """Tell a file of FileStorage by what only OpenCV writes."""
    return (text.startswith('%YAML') or '!!opencv-matrix' in text or '<opencv_storage' in text
            or '"opencv-matrix"' in text)


def parse_opencv(text: str, source: str, fisheye: bool = False,
                 image_size: tuple[int, int] | None = None) -> list[StoredCamera]:
    """
    Parse the text of a FileStorage file.

    Parameters
    ----------
    text : str
    source : str
        Starts the sentence of an error.
    fisheye : bool
        The four coefficients are those of cv2.fisheye, which not all files say.
    image_size : (int, int), optional
        For files without it.

    Raises
    ------
    InputError
        If there is no camera in the file, or it is impossible.

    """
    document = _document(text, source)
    keys = {re.sub(r'[^a-z0-9]', '', str(key).lower()): key for key in document}
    fisheye = fisheye or _flag(document, keys)
    size = _image_size(document, keys, source) or image_size or (0, 0)
    cameras = []
    for number in ('', '1', '2'):
        key = _spelling(document, keys, _MATRIX, number)
        if key is None:
            continue
        other = _spelling(document, keys, _DISTORTION, number)
        if other is None:
            raise InputError(f'{source} has {key} but no distortion_coefficients to it.')
        K = matrix(document, key, (3, 3), source)
        d = matrix(document, other, (None, None), source).ravel()
        cameras.append(StoredCamera(_camera(source, K, d, size, fisheye), number or 'camera'))
    if not cameras:
        raise InputError(f'{source} is an OpenCV file without a camera: it has no camera_matrix.')
    return cameras


def opencv_text(camera: Camera, xml: bool = False) -> str:
    """
    Write a camera as FileStorage does.

    Raises
    ------
    ArgumentError
        If the camera has skew, which OpenCV ignores.

    """
    without_skew(camera, 'OpenCV')
    fisheye = camera.model == 'equidistant'
    matrices = {'camera_matrix': camera.K, 'distortion_coefficients': camera.distortion[None]}
    values = {'image_width': camera.width, 'image_height': camera.height,
              'fisheye_model': int(fisheye)}
    if xml:
        lines = ['<?xml version="1.0"?>', '<opencv_storage>']
        lines += [f'<{key}>{value}</{key}>' for key, value in values.items()]
        for key, value in matrices.items():
            lines += [f'<{key} type_id="opencv-matrix">', f'  <rows>{value.shape[0]}</rows>',
                      f'  <cols>{value.shape[1]}</cols>', '  <dt>d</dt>', '  <data>',
                      '    ' + ' '.join(map(number_text, value.ravel())) + f'</data></{key}>']
        return '\n'.join([*lines, '</opencv_storage>']) + '\n'
    lines = ['%YAML:1.0', '---'] + [f'{key}: {value}' for key, value in values.items()]
    for key, value in matrices.items():
        lines += [f'{key}: !!opencv-matrix', f'   rows: {value.shape[0]}',
                  f'   cols: {value.shape[1]}', '   dt: d',
                  f'   data: [ {", ".join(map(number_text, value.ravel()))} ]']
    return '\n'.join(lines) + '\n'


def _camera(source: str, K: np.ndarray, d: np.ndarray, size: tuple[int, int], fisheye: bool,
            ) -> Camera:
    """Name the lens model, which OpenCV tells by the function that is called."""
    if K[0, 1]:
        raise InputError(f'{source} has a skew of {K[0, 1]:.4g} px in its camera matrix, which '
                         'OpenCV ignores; set it to zero.')
    counts = _FISHEYE_COUNTS if fisheye else _COUNTS
    if d.any() and d.size not in counts:
        whose = 'The fisheye model of OpenCV' if fisheye else 'OpenCV'
        raise InputError(f'{source} has {d.size} distortion coefficients. {whose} takes '
                         f'{", ".join(map(str, counts))}.')
    if fisheye:
        return lens_camera(source, K, 'equidistant', d, size)
    if d[8:].any():
        raise InputError(f'{source} has {d.size} distortion coefficients; thin prisms and tilted '
                         'sensors are not supported, up to eight coefficients are.')
    model = 'rational_polynomial' if d[5:].any() else 'plumb_bob'
    return lens_camera(source, K, model, d[:8] if d[5:].any() else d[:5], size)


def _spelling(document: dict[str, Any], keys: dict[str, str], spellings: Iterable[str],
              number: str) -> str | None:
    """Return the key of a matrix in one of its spellings."""
    for spelling in spellings:
        key = keys.get(spelling + number)
        if key is not None and isinstance(document[key], dict) and 'data' in document[key]:
            return key
    return None


def _flag(document: dict[str, Any], keys: dict[str, str]) -> bool:
    """Tell whether the file says that the lens is a fisheye."""
    value = document.get(keys.get('fisheyemodel', keys.get('fisheye', '')), 0)
    return str(value).strip().lower() in ('1', 'true')


def _image_size(document: dict[str, Any], keys: dict[str, str], source: str,
                ) -> tuple[int, int] | None:
    """Return width and height, from two keys or from a list."""
    pair: Any = [document.get(keys.get(f'image{side}', keys.get(side, ''))) for side in
                 ('width', 'height')]
    if None in pair:
        pair = document.get(keys.get('imagesize', keys.get('size', '')))
        pair = pair.split() if isinstance(pair, str) else pair
        if not isinstance(pair, list) or len(pair) != 2:
            return None
    width, height = (positive_integer(value, f'{source}: the image size') for value in pair)
    return width, height


def _document(text: str, source: str) -> dict[str, Any]:
    """Return the keys of the file; a matrix is a dict with rows, cols and data."""
    if text.lstrip().startswith('<'):
        return _from_xml(text, source)
    if text.lstrip().startswith('{'):
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            raise InputError(f'{source} is not valid JSON.') from None
        return found if isinstance(found, dict) else {}
    # OpenCV's '%YAML:1.0' is no directive of YAML
    lines = text.splitlines()
    if lines and lines[0].startswith('%YAML'):
        lines[0] = ''
    return load_yaml('\n'.join(lines), source)


def _without_comments(text: str) -> str:
    """Leave comments out, in one pass; one that does not end is left, and is no XML."""
    kept, at = [], 0
    while (begin := text.find('<!--', at)) >= 0 and (end := text.find('-->', begin + 4)) >= 0:
        kept.append(text[at:begin])
        at = end + 3
    return ''.join(kept) + text[at:]


def _from_xml(text: str, source: str) -> dict[str, Any]:
    """Read XML; documents that define entities are refused, because these can be bombs."""
    if '<!' in _without_comments(text):
        raise InputError(f'{source} defines entities or a document type, which no OpenCV file '
                         'does; it is not read.')
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError):
        raise InputError(f'{source} is not valid XML.') from None
    document: dict[str, Any] = {}
    for element in root:
        parts = {part.tag: (part.text or '').strip() for part in element}
        if 'data' in parts:
            document[element.tag] = {**parts, 'data': parts['data'].split()}
        else:
            document[element.tag] = (element.text or '').strip().strip('"')
    return document
