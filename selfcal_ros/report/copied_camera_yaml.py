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
"""Camera files as they are: of ROS without a look at their lens model, and those of OpenCV."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import takewhile
from pathlib import Path

from msg_adapters.copied_camera import CopiedCamera
import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.report.camera_files.known_camera import read_known_camera
from selfcal_ros.report.camera_files.opencv_storage import is_opencv
from selfcal_ros.report.camera_yaml import REQUIRED, ros_document, ros_yaml
from selfcal_ros.report.yaml_text import decoded, matrix, positive_integer, read_bytes
from selfcal_ros.values.output_files import atomic_write


def read_copied_camera(path: str | Path) -> tuple[CopiedCamera, str]:
    """
    Read a camera file of ROS, of whatever lens model, or one of OpenCV: YAML, XML or JSON.

    Returns
    -------
    camera : CopiedCamera
    name : str
        'unknown' where the file does not name the camera; empty where its kind has no names.

    Raises
    ------
    InputError
        If the file is missing, of another kind, incomplete, or holds no calibration.

    """
    source = str(path)
    text = decoded(read_bytes(path), path)
    if is_opencv(text):
        known = read_known_camera(path)
        return CopiedCamera(known.width, known.height, known.model, known.distortion, known.K,
                            np.eye(3), np.column_stack([known.K, np.zeros(3)])), ''
    document = ros_document(text, source)
    width, height = (positive_integer(document[key], f'{source}: {key}') for key in REQUIRED[:2])
    K, R, P = (matrix(document, key, shape, source) for key, shape in (
        ('camera_matrix', (3, 3)), ('rectification_matrix', (3, 3)),
        ('projection_matrix', (3, 4))))
    d = np.ravel(matrix(document, 'distortion_coefficients', (1, None), source))
    try:
        camera = CopiedCamera(width, height, str(document.get('distortion_model', 'plumb_bob')),
                              d, K, R, P)
    except InputError as error:
        raise InputError(f'{source}: {error}') from None
    return camera, str(document.get('camera_name') or 'unknown')


def comments_of(path: str | Path) -> list[str]:
    """Return the lines of comment that a camera file of ROS begins with, without their mark."""
    lines = takewhile(lambda line: line.startswith('#'),
                      decoded(read_bytes(path), path).splitlines())
    return [line.lstrip('#').strip() for line in lines]


def write_copied_camera(path: str | Path, camera: CopiedCamera, name: str,
                        comments: Iterable[str] = (), replace: bool = True) -> Path:
    """
    Write a camera file of ROS; it appears whole or not at all.

    Raises
    ------
    ArgumentError
        If the name is impossible.
    InputError
        If the file cannot be written, or its name says that it is one of OpenCV.

    """
    if Path(path).suffix.lower() == '.xml':
        raise InputError(f'{path} is named as a file of OpenCV, and would be one of ROS; let its '
                         'name end in .yaml.')
    return atomic_write(path, ros_yaml((camera.width, camera.height), name, camera.K, camera.model,
                                       camera.d, camera.R, camera.P, comments), replace)
