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
"""A camera as a file holds it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.values.parameter_status import Status


@dataclass(frozen=True)
class StoredCamera:
    """
    One camera of a file.

    Attributes
    ----------
    camera : Camera
        Pixel (0, 0) is the centre of the top-left pixel, whatever the convention of the file.
    name : str
        As the file calls it.
    topic : str
        Image topic, where the file names it.
    covariance : ndarray, shape (k, k), or None
        Of the camera's parameters, where the file has it.
    status : dict
        Per parameter 'estimated', 'held' or 'unobservable', where the file has it.
    line_delay_s : float or None
        Seconds from one line of the image to the next, where the file tells a rolling shutter.
    lines : {'rows', 'columns'}
        What is read one after the other.

    """

    camera: Camera
    name: str
    topic: str = ''
    covariance: np.ndarray | None = None
    status: dict[str, Status] = field(default_factory=dict)
    line_delay_s: float | None = None
    lines: str = 'rows'


def lens_camera(source: str, K: ArrayLike, model: str, coefficients: ArrayLike,
                size: tuple[int, int] = (0, 0)) -> Camera:
    """Build a camera; what is impossible is an InputError that starts with the source."""
    try:
        return Camera(K, coefficients, size[0], size[1], model)
    except ArgumentError as error:
        raise InputError(f'{source}: {error}') from None


def without_skew(camera: Camera, program: str) -> Camera:
    """
    Return a camera for a program that knows no skew.

    Raises
    ------
    ArgumentError
        If the camera has one.

    """
    if camera.K[0, 1]:
        raise ArgumentError(f'{program} knows no skew, and this camera has {camera.K[0, 1]:.4g} '
                            'px of it; calibrate with --skew 0.')
    return camera
