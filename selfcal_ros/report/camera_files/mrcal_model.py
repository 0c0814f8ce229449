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
Camera models of mrcal (.cameramodel): a Python literal of one dictionary.

Only its plain entries are used: lensmodel, intrinsics and imagersize. mrcal puts (0, 0) at the
centre of the top-left pixel, and its OPENCV models are OpenCV's, coefficients in the same order.
"""

from __future__ import annotations

import ast
import re
from typing import Any

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_files.stored import lens_camera, StoredCamera, without_skew
from selfcal_ros.report.yaml_text import number_text, numbers, positive_integer

#: mrcal's models that have exact counterparts, and their numbers of coefficients.
_MODELS = {'LENSMODEL_PINHOLE': 0, 'LENSMODEL_OPENCV4': 4, 'LENSMODEL_OPENCV5': 5,
           'LENSMODEL_OPENCV8': 8}
#: A file that carries the measurements it comes from may be so large.
MAX_BYTES = 100_000_000
#: Numbers and brackets become objects, a hundred times as large as they are written.
_MAX_BARE = 1_000_000
#: What may hold any characters: comments, strings and byte strings. One that does not end takes
#: the rest of its line, so that the time does not grow with the square of it.
_QUOTED = re.compile(r"""#[^\n]*|b?'(?:[^'\\\n]|\\.)*+'?|b?"(?:[^"\\\n]|\\.)*+\"?""")
#: What a dictionary of numbers and texts has none of besides: names, sums, and signs of signs.
_FOREIGN = re.compile(r'[^\s\d.eE+\-,:(){}\[\]]|[\d.)\]}]\s*[-+]|[-+]\s*[-+]')


def is_mrcal(text: str) -> bool:
    """Tell a file of mrcal by its key of the lens model."""
    return re.search(r"^[ \t]*['\"]lens_?model['\"]\s*:\s*['\"]", text, re.M) is not None


def parse_mrcal(text: str, source: str) -> list[StoredCamera]:
    """
    Parse the text of a .cameramodel.

    Raises
    ------
    InputError
        If it is no literal of one dictionary, or its lens model has no exact counterpart.

    """
    document = _document(text, source)
    model = document.get('lensmodel', document.get('lens_model'))
    if not isinstance(model, str) or not {'intrinsics', 'imagersize'} <= document.keys():
        raise InputError(f'{source} lacks its lensmodel, intrinsics or imagersize; a .cameramodel '
                         'of mrcal has them all.')
    if model not in _MODELS:
        raise InputError(f'{source}: the lens model {model:.40} of mrcal has no exact '
                         f'counterpart; fit one of {", ".join(_MODELS)} with '
                         'mrcal-convert-lensmodel.')
    values = numbers(_listed(document['intrinsics']), source, 'intrinsics')
    size = _listed(document['imagersize'])
    if values.size != 4 + _MODELS[model] or len(size) != 2:
        raise InputError(f'{source}: {model} has {4 + _MODELS[model]} intrinsics and two numbers '
                         f'of imagersize, not {values.size} and {len(size)}.')
    width, height = (positive_integer(value, f'{source}: imagersize') for value in size)
    fx, fy, cx, cy, *d = values
    ours = 'rational_polynomial' if any(d[5:]) else 'plumb_bob'
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    camera = lens_camera(source, K, ours, d if any(d[5:]) else d[:5], (width, height))
    return [StoredCamera(camera, 'camera')]


def holds(camera: Camera) -> bool:
    """Tell whether mrcal has the lens model of a camera."""
    return camera.model in ('plumb_bob', 'rational_polynomial')


def mrcal_text(camera: Camera) -> str:
    """
    Write a camera as a .cameramodel, at the origin.

    Raises
    ------
    ArgumentError
        If the camera has skew.

    """
    without_skew(camera, 'mrcal')
    plumb, K = camera.distortion_as('plumb_bob'), camera.K
    d = camera.distortion if plumb is None else plumb if plumb[4] else plumb[:4]
    d = d if d.any() else d[:0]
    model = next(model for model, count in _MODELS.items() if count == len(d))
    intrinsics = ', '.join(map(number_text, (K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d)))
    return ('{\n'
            f"    'lensmodel':  '{model}',\n\n"
            '    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....\n'
            f"    'intrinsics': [ {intrinsics},],\n\n"
            '    # extrinsics are rt_fromref\n'
            "    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n"
            f"    'imagersize': [ {camera.width}, {camera.height},],\n"
            '}\n')


def _listed(values: object) -> list[Any]:
    """Return a list or tuple as a list; anything else as nothing, which no count fits."""
    return list(values) if isinstance(values, (list, tuple)) else []


def _document(text: str, source: str) -> dict[str, Any]:
    """Read the dictionary; expressions, which could nest without end, are none."""
    problem = InputError(f'{source} is no .cameramodel of mrcal: it is not one dictionary of '
                         'numbers and texts.')
    # beside quoted texts there is nothing but numbers and brackets
    bare = _QUOTED.sub('', text)
    if len(bare) > _MAX_BARE or _FOREIGN.search(re.sub(r'\b(None|True|False)\b', '', bare)):
        raise problem
    try:
        document = ast.literal_eval(text.strip())
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        raise problem from None
    if not isinstance(document, dict):
        raise problem
    return document
