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
Rolling shutter: how a tracked object moves while the lines of an image are read.

A pose is that at the stamp of its image, when the middle line is read. A line v is read
tau = (v - middle) delay later. By then a point has moved on by tau times its velocity in the
image, which follows from that of the object.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.rorapid.projection.camera_models import Projection

#: How often the line of a point is asked anew: each time leaves a share of the error before, the
#: motion from one line to the next, pixels.
_ROUNDS = 2


class RowMotion:
    """
    How an object moves while an image is read.

    Parameters
    ----------
    camera : Camera
        Its lens tells in which line a point is read.
    line_delay_s : float
        Seconds from one line to the next; negative from the lowest row up.
    lines : {'rows', 'columns'}
        What is read one after the other.

    Raises
    ------
    ArgumentError
        If the camera has no image size: then nobody knows which line is the middle one.

    Attributes
    ----------
    velocity : ndarray, shape (size,)
        Of the object in the image at hand: corrections of the pose in a second.
    covariance : ndarray, shape (size, size)
        Of the velocity.

    """

    def __init__(self, camera: Camera, line_delay_s: float, lines: str) -> None:
        """Begin at rest."""
        self._projection, self._delay_s = Projection(camera), float(line_delay_s)
        self._axis = 1 if lines == 'rows' else 0
        self._count = (camera.width, camera.height)[self._axis]
        if self._count <= 0:
            raise ArgumentError('A line delay needs the image size of the camera.')
        self.velocity, self.covariance = np.zeros(0), np.zeros((0, 0))

    def now(self, velocity: np.ndarray, covariance: np.ndarray) -> None:
        """Take the velocity (size,) and its covariance (size, size) for the image at hand."""
        self.velocity, self.covariance = velocity, covariance

    @property
    def is_moving(self) -> bool:
        """Whether anything is known to move."""
        return bool(self.velocity.any())

    def seconds(self, pixels: np.ndarray) -> np.ndarray:
        """When pixels (C, 2) are read, seconds after the stamp of the image, (C,)."""
        late = pixels[:, self._axis] - 0.5 * (self._count - 1)
        # what lies outside of the image is not read at all
        return self._delay_s * np.clip(late, -self._count, self._count)

    def displaced(self, xy: np.ndarray, speed: np.ndarray, zoom: float) -> np.ndarray:
        """
        Move points to where they are by the time when their line is read.

        Parameters
        ----------
        xy : ndarray, shape (C, 2)
            Normalised coordinates at the stamp of the image.
        speed : ndarray, shape (C, 2)
            Their change in a second.
        zoom : float
            Focal length over that of the camera.

        Returns
        -------
        ndarray, shape (C, 2)
            A point is read in the line that it is in by then.

        """
        moved = xy
        for _ in range(_ROUNDS):
            moved = xy + self.seconds(self._projection.pixels(moved, zoom))[:, None] * speed
        return moved
