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
nerfstudio's transforms.json, which instant-ngp and others read, too.

A matrix leads from the camera to the world. The camera's axes are OpenGL's (x right, y up, z
back), and z of the world is up. (0, 0) is the corner of the top-left pixel: half a pixel is added
to the principal point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import json
from pathlib import Path
from typing import Any

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_files.colmap_cameras import HALF_PIXEL
from selfcal_ros.report.camera_files.stored import without_skew
from selfcal_ros.report.scene_files.exported_scene import ExportedScene
from selfcal_ros.report.scene_files.world_words import unit_in_words, world_in_words
from selfcal_ros.values.output_files import atomic_write

#: An OpenGL camera's axes in those of an optical frame.
_OPENGL = np.diag([1.0, -1.0, -1.0])
_PROGRAM = 'transforms.json'


def write_transforms(path: Path, scene: ExportedScene, files: Sequence[str],
                     stamps_ns: Mapping[int, int] | None = None, ply: str | None = None,
                     source: str = '') -> Path:
    """
    Write the file, whole or not at all.

    Parameters
    ----------
    path : Path
    scene : ExportedScene
    files : sequence of str
        The image of every view, relative to the folder of `path`.
    stamps_ns : mapping of int to int, optional
        When each frame was taken.
    ply : str, optional
        A file of points, relative to that folder.
    source : str
        What the scene comes from.

    Returns
    -------
    Path

    Raises
    ------
    ArgumentError
        If the format has no model for the camera.
    InputError
        If the file cannot be written.

    """
    lens, cameras = _lens(scene.camera), [_matrix(scene.camera)]
    if scene.cameras:
        cameras = [_matrix(camera) for camera in scene.cameras]
    content: dict[str, Any] = {**lens, 'w': scene.camera.width, 'h': scene.camera.height}
    if not scene.cameras:
        content.update(cameras[0])
    frames = []
    for view, file in enumerate(files):
        pose = np.eye(4)
        pose[:3, :3] = scene.path.rotation[view] @ _OPENGL
        pose[:3, 3] = scene.path.centre[view]
        frame: dict[str, Any] = {'file_path': file, 'transform_matrix': (pose + 0.0).tolist()}
        if scene.cameras:
            frame.update(cameras[view])
        if stamps_ns is not None:
            frame['stamp_ns'] = int(stamps_ns[int(scene.path.frames[view])])
        frames.append(frame)
    if ply is not None:
        content['ply_file_path'] = ply
    content['selfcal'] = {'source': source, 'world': world_in_words(scene.path),
                          'unit': unit_in_words(scene.path)}
    content['frames'] = frames
    return atomic_write(path, json.dumps(content, indent=1) + '\n')


def _matrix(camera: Camera) -> dict[str, float]:
    """Return focal lengths and principal point."""
    K = without_skew(camera, _PROGRAM).K
    cx, cy = (K[:2, 2] + HALF_PIXEL).tolist()
    return {'fl_x': float(K[0, 0]), 'fl_y': float(K[1, 1]), 'cx': cx, 'cy': cy}


def _lens(camera: Camera) -> dict[str, Any]:
    """Return model and distortion."""
    plumb = camera.distortion_as('plumb_bob')
    if plumb is not None:
        k1, k2, p1, p2, k3 = (float(one) for one in plumb)
        return {'camera_model': 'OPENCV', 'k1': k1, 'k2': k2, 'k3': k3, 'p1': p1, 'p2': p2}
    if camera.model != 'equidistant':
        raise ArgumentError(f'{_PROGRAM} has no model for the lens {camera.model}; calibrate with '
                            '--lens plumb_bob or --lens equidistant.')
    return {'camera_model': 'OPENCV_FISHEYE', 'is_fisheye': True,
            **{f'k{k}': float(one) for k, one in enumerate(camera.distortion, start=1)}}
