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

Its projections are a pinhole and three that look at a sphere: omni, eucm and ds. Kalibr finds
corners with OpenCV and shares its pixel convention.
"""

from __future__ import annotations

from collections.abc import Iterable
import re
from typing import Any

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_files.stored import lens_camera, StoredCamera, without_skew
from selfcal_ros.report.yaml_text import number_text, numbers, positive_integer

#: Kalibr's projections with their distortion models: ours, the names among its intrinsics before
#: the focal lengths, and the number of distortion coefficients that follow.
_MODELS: dict[tuple[str, str], tuple[str, tuple[str, ...], int]] = {
    ('pinhole', 'none'): ('plumb_bob', (), 0),
    ('pinhole', 'radtan'): ('plumb_bob', (), 4),
    ('pinhole', 'equidistant'): ('equidistant', (), 4),
    ('pinhole', 'equi'): ('equidistant', (), 4),
    ('pinhole', 'fov'): ('fov', (), 1),
    ('omni', 'none'): ('ucm', ('xi',), 0),
    ('omni', 'radtan'): ('ucm', ('xi',), 4),
    ('eucm', 'none'): ('eucm', ('alpha', 'beta'), 0),
    ('ds', 'none'): ('double_sphere', ('xi', 'alpha'), 0)}
#: The projection that a lens model of ours is written as; all others are a pinhole.
_PROJECTIONS = {'ucm': 'omni', 'eucm': 'eucm', 'double_sphere': 'ds'}


def parse_kalibr(document: dict[str, Any], source: str) -> list[StoredCamera]:
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
    # YAML that was sorted has cam10 before cam2, and each is placed beside the one before
    names = sorted(chain, key=lambda name: [int(number) for number in re.findall(r'\d+', name)])
    return [_camera(chain[name], name, f'{source}, {name}') for name in names]


def _camera(entry: dict[str, Any], name: str, source: str) -> StoredCamera:
    """Read one camera of a chain."""
    projection = str(entry.get('camera_model', 'pinhole'))
    model = str(entry.get('distortion_model', 'none'))
    if (projection, model) not in _MODELS:
        known = ', '.join('-'.join(pair) for pair in _MODELS)
        raise InputError(f'{source}: the projection {projection!r:.40} with the distortion model '
                         f'{model!r:.40} has no exact counterpart; {known} have.')
    ours, first, count = _MODELS[projection, model]
    if 'resolution' not in entry:
        raise InputError(f'{source} lacks its resolution.')
    intrinsics = numbers(entry['intrinsics'], source, 'intrinsics')
    size = entry['resolution']
    names = (*first, 'fu', 'fv', 'pu', 'pv')
    if intrinsics.size != len(names) or not isinstance(size, list) or len(size) != 2:
        raise InputError(f'{source}: the intrinsics of the projection {projection} are '
                         f'{" ".join(names)}, and the resolution has two numbers.')
    width, height = (positive_integer(value, f'{source}: resolution') for value in size)
    d = numbers(entry.get('distortion_coeffs', []), source, 'distortion_coeffs')
    if d.size != count and not (model == 'none' and not d.any()):
        raise InputError(f'{source}: the distortion model {model} has {count} coefficients, not '
                         f'{d.size}.')
    fu, fv, pu, pv = intrinsics[len(first):]
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]])
    coefficients = [*intrinsics[:len(first)], *d[:count]]
    return StoredCamera(lens_camera(source, K, ours, coefficients, (width, height)), name,
                        str(entry.get('rostopic', '')))


def holds(camera: Camera) -> bool:
    """Tell whether Kalibr has the lens model: its polynomial has no k3."""
    plumb = camera.distortion_as('plumb_bob')
    known = ('equidistant', 'fov', *_PROJECTIONS)
    return camera.model in known or plumb is not None and plumb[4] == 0


def kalibr_text(camera: Camera, topic: str = '') -> str:
    """
    Write a camera as a chain of one.

    Raises
    ------
    ArgumentError
        If the camera has skew.

    """
    without_skew(camera, 'Kalibr')
    plumb, K = camera.distortion_as('plumb_bob'), camera.K
    model = camera.model if plumb is None else 'radtan'
    d = camera.distortion if plumb is None else plumb[:4]
    projection, first = _PROJECTIONS.get(camera.model, 'pinhole'), d[:0]
    if projection != 'pinhole':
        # what bends the rays is among the intrinsics; what follows may be nothing
        places = 1 if camera.model == 'ucm' else 2
        first, d = d[:places], d[places:]
        model, d = ('radtan', d) if d.any() else ('none', d[:0])

    def listed(values: Iterable[float]) -> str:
        return f'[{", ".join(map(number_text, values))}]'

    lines = ['cam0:', '  cam_overlaps: []', f'  camera_model: {projection}',
             f'  distortion_coeffs: {listed(d)}', f'  distortion_model: {model}',
             f'  intrinsics: {listed([*first, K[0, 0], K[1, 1], K[0, 2], K[1, 2]])}',
             f'  resolution: [{camera.width}, {camera.height}]',
             f'  rostopic: {topic or "/camera/image_raw"}']
    return '\n'.join(lines) + '\n'
