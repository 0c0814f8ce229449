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
"""The camera that a program takes as known: from any camera file, and whole over its image."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_files.formats import read_cameras
from selfcal_ros.report.camera_files.stored import StoredCamera

#: Beyond this angle from the axis a fisheye may end within its image: its rim is black there.
RIM_RAD = np.radians(80)
#: Points a side of the border that are looked at.
_BORDER = 33


def read_known_camera(path: str | Path) -> Camera:
    """Read the one camera of a file as `read_known` does; return the camera alone."""
    return read_known(path).camera


def read_known(path: str | Path) -> StoredCamera:
    """
    Read the one camera of a file, of whatever program, to be used as it is.

    Raises
    ------
    InputError
        If there is no camera, there are several, its image size is missing, or its distortion
        folds inside the image.

    """
    cameras = read_cameras(path)[1]
    if len(cameras) > 1:
        names = ', '.join(camera.name for camera in cameras[:12])
        raise InputError(f'{path} holds {len(cameras)} cameras; write the one that is meant to a '
                         f'file of its own, with `selfcal convert --camera`: {names}.')
    camera = cameras[0].camera
    if min(camera.width, camera.height) <= 0:
        raise InputError(f'{path} does not tell the image size; add it with `selfcal convert '
                         '--image-size W H`.')
    check_unfolded(camera, str(path))
    return cameras[0]


def check_unfolded(camera: Camera, source: str) -> None:
    """
    Refuse a camera some of whose pixels see no ray, because its distortion folds before them.

    Parameters
    ----------
    camera : Camera
        With its image size.
    source : str
        Starts the sentence of the error.

    Raises
    ------
    InputError

    """
    widest = camera.lens.widest_angle(camera.distortion)
    if not camera.lens.is_perspective and widest > RIM_RAD:
        return
    u = np.linspace(0, camera.width - 1, _BORDER)
    v = np.linspace(0, camera.height - 1, _BORDER)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = camera.rays(pixels)
    # a root of the polynomial beyond its fold is no ray of the lens
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    lost = ~(angle <= widest * (1 + 1e-3))
    if lost.any():
        raise InputError(f'{source}: the distortion folds {np.degrees(widest):.0f} degrees from '
                         f'the axis, inside the image, and {100 * lost.mean():.0f} % of its '
                         'pixels see no ray; calibrate with another lens model, or with points '
                         'near the border.')
