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
Cameras of COLMAP: cameras.txt and cameras.bin.

COLMAP puts (0, 0) at the corner of the top-left pixel, whose centre is (0.5, 0.5); everybody else
here puts it at the centre. So half a pixel is added to principal points on their way to COLMAP,
and taken away on their way back.
"""

from __future__ import annotations

from collections.abc import Sequence
import struct

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_files.stored import lens_camera, StoredCamera, without_skew

#: From the corner of a pixel to its centre.
HALF_PIXEL = 0.5
#: COLMAP's models that have exact counterparts: number, count of focal lengths, our model, and
#: where COLMAP's coefficients go among ours.
_MODELS = {
    'SIMPLE_PINHOLE': (0, 1, 'plumb_bob', ()),
    'PINHOLE': (1, 2, 'plumb_bob', ()),
    'SIMPLE_RADIAL': (2, 1, 'plumb_bob', (0,)),
    'RADIAL': (3, 1, 'plumb_bob', (0, 1)),
    'OPENCV': (4, 2, 'plumb_bob', (0, 1, 2, 3)),
    'OPENCV_FISHEYE': (5, 2, 'equidistant', (0, 1, 2, 3)),
    'FULL_OPENCV': (6, 2, 'rational_polynomial', (0, 1, 2, 3, 4, 5, 6, 7)),
    'FOV': (7, 2, 'fov', (0,)),
    'SIMPLE_RADIAL_FISHEYE': (8, 1, 'equidistant', (0,)),
    'RADIAL_FISHEYE': (9, 1, 'equidistant', (0, 1)),
    'SIMPLE_FISHEYE': (14, 1, 'equidistant', ()),
    'FISHEYE': (15, 2, 'equidistant', ()),
    'EUCM': (16, 2, 'eucm', (0, 1)),
}
#: Models without a counterpart.
_FOREIGN = {'THIN_PRISM_FISHEYE': 10, 'RAD_TAN_THIN_PRISM_FISHEYE': 11, 'SIMPLE_DIVISION': 12,
            'DIVISION': 13, 'EQUIRECTANGULAR': 17}
_NAMES = {**{entry[0]: name for name, entry in _MODELS.items()},
          **{number: name for name, number in _FOREIGN.items()}}


#: The models that lenses of ours are written as, beside the polynomials.
_WRITTEN = {'equidistant': 'OPENCV_FISHEYE', 'fov': 'FOV', 'eucm': 'EUCM',
            'rational_polynomial': 'FULL_OPENCV'}


def holds(camera: Camera) -> bool:
    """Tell whether COLMAP has the lens model of a camera."""
    return camera.model in ('plumb_bob', *_WRITTEN)


def is_colmap(text: str) -> bool:
    """Tell cameras.txt: the first line that is no comment names a model of COLMAP."""
    for line in text.splitlines():
        words = line.split()
        if words and not line.lstrip().startswith('#'):
            return len(words) > 4 and (words[1] in _MODELS or words[1] in _FOREIGN)
    return '# Camera list with one line of data per camera' in text


def parse_colmap_text(text: str, source: str) -> list[StoredCamera]:
    """
    Parse cameras.txt.

    Raises
    ------
    InputError
        If a line is wrong, or a model has no exact counterpart.

    """
    cameras = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith('#'):
            continue
        where = f'{source}, line {number}'
        words = line.split()
        try:
            identity, model = int(words[0]), words[1]
            size = int(words[2]), int(words[3])
            values = [float(word) for word in words[4:]]
        except (ValueError, IndexError):
            raise InputError(f'{where}: expected CAMERA_ID MODEL WIDTH HEIGHT and the '
                             'parameters.') from None
        cameras.append(_camera(where, identity, model, size, values))
    if not cameras:
        raise InputError(f'{source} is a COLMAP file without cameras.')
    return cameras


def parse_colmap_binary(raw: bytes, source: str) -> list[StoredCamera]:
    """
    Parse cameras.bin.

    Raises
    ------
    InputError
        If it is truncated, or a model has no exact counterpart.

    """
    cameras = []
    try:
        count, place = struct.unpack_from('<Q', raw)[0], 8
        for _ in range(count):
            identity, number, width, height = struct.unpack_from('<IiQQ', raw, place)
            place += 24
            name = _NAMES.get(number)
            if name is None:
                raise InputError(f'{source} is no cameras.bin of COLMAP: it has no camera model '
                                 f'{number}.')
            # a model without counterpart is refused before its values matter
            _, focals, _, places = _MODELS.get(name, (0, 0, '', ()))
            size = focals + 2 + len(places)
            values = struct.unpack_from(f'<{size}d', raw, place)
            place += 8 * size
            cameras.append(_camera(f'{source}, camera {identity}', identity, name,
                                   (width, height), values))
    except struct.error:
        raise InputError(f'{source} is no cameras.bin of COLMAP, or truncated.') from None
    if not cameras or place != len(raw):
        raise InputError(f'{source} is no cameras.bin of COLMAP, or damaged.')
    return cameras


def _camera(source: str, identity: int, model: str, size: tuple[int, int], values: Sequence[float],
            ) -> StoredCamera:
    """Build the camera of one entry."""
    if model not in _MODELS:
        raise InputError(f'{source}: the camera model {model:.40} of COLMAP has no exact '
                         f'counterpart; {", ".join(_MODELS)} have.')
    _, focals, ours, places = _MODELS[model]
    if len(values) != focals + 2 + len(places) or not 0 < min(size) <= max(size) < 2 ** 31:
        raise InputError(f'{source}: {model} has {focals + 2 + len(places)} parameters and a '
                         f'positive image size, not {len(values)} and {size[0]}x{size[1]}.')
    fx, fy = values[0], values[focals - 1]
    cx, cy = np.array(values[focals:focals + 2]) - HALF_PIXEL
    d = np.zeros(max(places, default=-1) + 1)
    d[list(places)] = values[focals + 2:]
    if model == 'FULL_OPENCV' and not d[5:].any():
        # COLMAP has no smaller model with k3
        ours, d = 'plumb_bob', d[:5]
    camera = lens_camera(source, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], ours, d, size)
    return StoredCamera(camera, f'camera_{identity}')


def colmap_model(camera: Camera) -> tuple[str, list[float]]:
    """
    Return COLMAP's model for a camera and its parameters.

    Raises
    ------
    ArgumentError
        If the camera has skew.

    """
    without_skew(camera, 'COLMAP')
    plumb = camera.distortion_as('plumb_bob')
    if plumb is None:
        model = _WRITTEN[camera.model]
        d = camera.distortion
    elif plumb[4]:
        # COLMAP has k3 in its rational model only: k1 k2 p1 p2 k3, and nothing below
        model, d = 'FULL_OPENCV', np.append(plumb, np.zeros(3))
    else:
        model, d = ('OPENCV', plumb[:4]) if plumb.any() else ('PINHOLE', plumb[:0])
    K = camera.K
    centre = K[:2, 2] + HALF_PIXEL
    return model, [float(value) for value in (K[0, 0], K[1, 1], *centre, *d)]


def colmap_line(camera: Camera) -> str:
    """
    Return a line of cameras.txt without the number of the camera.

    Raises
    ------
    ArgumentError
        If the camera has skew.

    """
    model, values = colmap_model(camera)
    return f'{model} {camera.width} {camera.height} {" ".join(map(repr, values))}'


def colmap_text(camera: Camera) -> str:
    """
    Write cameras.txt with one camera, number 1.

    Raises
    ------
    ArgumentError
        If the camera has skew.

    """
    return ('# Camera list with one line of data per camera:\n'
            '#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n# Number of cameras: 1\n'
            f'1 {colmap_line(camera)}\n')


def colmap_binary(camera: Camera) -> bytes:
    """
    Write cameras.bin with one camera, number 1.

    Raises
    ------
    ArgumentError
        If the camera has skew.

    """
    model, values = colmap_model(camera)
    return struct.pack(f'<QIiQQ{len(values)}d', 1, 1, _MODELS[model][0], camera.width,
                       camera.height, *values)
