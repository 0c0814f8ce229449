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
Camera chains of Kalibr (camchain.yaml).

Of its projections only 'pinhole' has a counterpart elsewhere. Kalibr finds corners with OpenCV and
shares its pixel convention.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_files.stored import lens_camera, StoredCamera, without_skew
from selfcal_ros.report.yaml_text import number_text, numbers, positive_integer

#: Kalibr's names of distortion models, and ours with the number of coefficients it writes.
_MODELS = {'none': ('plumb_bob', 0), 'radtan': ('plumb_bob', 4), 'equidistant': ('equidistant', 4),
           'equi': ('equidistant', 4), 'fov': ('fov', 1)}


def parse_kalibr(document: dict, source: str) -> list[StoredCamera]:
    """
    Return the cameras of a chain, or that of a file with a single one.

    Raises
    ------
    InputError
        If a camera is incomplete, or of a projection that no other program knows.

    """
    chain = {'cam0': document} if 'intrinsics' in document else {
        str(name): entry for name, entry in document.items()
        if isinstance(entry, dict) and 'intrinsics' in entry}
    return [_camera(entry, name, f'{source}, {name}') for name, entry in chain.items()]


def _camera(entry: dict, name: str, source: str) -> StoredCamera:
    """Read one camera of a chain."""
    projection = str(entry.get('camera_model', 'pinhole'))
    model = str(entry.get('distortion_model', 'none'))
    if projection != 'pinhole':
        raise InputError(f'{source}: the projection {projection!r:.40} has no exact counterpart '
                         'in other programs; calibrate with a pinhole model of Kalibr.')
    if model not in _MODELS:
        raise InputError(f'{source}: the distortion model {model!r:.40} is unknown; '
                         f'{", ".join(_MODELS)} are known.')
    if 'resolution' not in entry:
        raise InputError(f'{source} lacks its resolution.')
    intrinsics = numbers(entry['intrinsics'], source, 'intrinsics')
    size = entry['resolution']
    if intrinsics.size != 4 or not isinstance(size, list) or len(size) != 2:
        raise InputError(f'{source}: a pinhole camera has four intrinsics and two numbers of '
                         'resolution.')
    size = [positive_integer(value, f'{source}: resolution') for value in size]
    ours, count = _MODELS[model]
    d = numbers(entry.get('distortion_coeffs', []), source, 'distortion_coeffs')
    if d.size != count and not (model == 'none' and not d.any()):
        raise InputError(f'{source}: the distortion model {model} has {count} coefficients, not '
                         f'{d.size}.')
    fu, fv, pu, pv = intrinsics
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]])
    return StoredCamera(lens_camera(source, K, ours, d[:count], size), name,
                        str(entry.get('rostopic', '')))


def holds(camera: Camera) -> bool:
    """Tell whether Kalibr has the lens model: its polynomial has no k3."""
    plumb = camera.distortion_as('plumb_bob')
    return camera.model in ('equidistant', 'fov') or plumb is not None and plumb[4] == 0


def kalibr_text(camera: Camera, name: str = '', topic: str = '') -> str:
    """
    Write a camera as a chain of one.

    Raises
    ------
    ArgumentError
        If the camera has skew.

    """
    without_skew(camera, 'Kalibr')
    plumb = camera.distortion_as('plumb_bob')
    model = camera.model if plumb is None else 'radtan'
    d = camera.distortion if plumb is None else plumb[:4]
    K = camera.K

    def listed(values):
        return f'[{", ".join(map(number_text, values))}]'

    lines = ['cam0:', '  cam_overlaps: []', '  camera_model: pinhole',
             f'  distortion_coeffs: {listed(d)}', f'  distortion_model: {model}',
             f'  intrinsics: {listed([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])}',
             f'  resolution: [{camera.width}, {camera.height}]',
             f'  rostopic: {topic or "/camera/image_raw"}']
    return '\n'.join(lines) + '\n'
