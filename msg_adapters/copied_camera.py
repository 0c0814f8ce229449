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
"""A CameraInfo as it is: copied from a message or a file and served, whatever its lens model."""

from __future__ import annotations

from dataclasses import dataclass

from msg_adapters.camera_info import ImageWindow
from msg_adapters.message_types import Message, MessageTypes
from msg_adapters.stamps import copy_header
import numpy as np

from selfcal_ros.errors import InputError

#: Lens models of ROS, and how many coefficients OpenCV takes for each; others are copied blindly.
COEFFICIENTS = {'plumb_bob': (0, 1, 2, 3, 4, 5), 'equidistant': (0, 4),
                'rational_polynomial': (0, 1, 2, 3, 4, 5, 8, 12, 14)}


@dataclass(frozen=True)
class CopiedCamera:
    """
    What a CameraInfo says of a camera, for the full sensor.

    `R` and `P` are those of a stereo pair or of rectified images; nothing here computes with them.

    Attributes
    ----------
    width, height : int
        Pixels.
    model : str
        Lens model, as the message names it.
    d : ndarray, shape (N,)
    K, R : ndarray, shape (3, 3)
    P : ndarray, shape (3, 4)

    """

    width: int
    height: int
    model: str
    d: np.ndarray
    K: np.ndarray
    R: np.ndarray
    P: np.ndarray

    def __post_init__(self) -> None:
        """Refuse what is no calibration."""
        if not all(np.isfinite(values).all() for values in (self.d, self.K, self.R, self.P)):
            raise InputError('The CameraInfo holds numbers that are not finite.')
        if not self.K[0, 0] or not (self.width and self.height):
            raise InputError('The CameraInfo holds no calibration (K[0], width or height is '
                             'zero).')
        if not (self.K[0, 0] > 0 and self.K[1, 1] > 0 and (self.K[2] == (0, 0, 1)).all()):
            raise InputError('The K of the CameraInfo is no calibration matrix: its focal lengths '
                             'must be positive, and its last row 0, 0, 1.')
        counts = COEFFICIENTS.get(self.model)
        if counts is not None and len(self.d) not in counts:
            raise InputError(f'The distortion model {self.model} has {counts[-1]} coefficients, '
                             f'not {len(self.d)}.')


def copied_camera(msg: Message) -> CopiedCamera:
    """
    Copy what a message says.

    Raises
    ------
    InputError
        If it holds no calibration.

    """
    values = [np.array(field, float).ravel() for field in (msg.d, msg.k, msg.r, msg.p)]
    return CopiedCamera(int(msg.width), int(msg.height), str(msg.distortion_model), values[0],
                        values[1].reshape(3, 3), values[2].reshape(3, 3),
                        values[3].reshape(3, 4))


def copied_message(camera: CopiedCamera, header: Message, types: MessageTypes,
                   window: ImageWindow = ImageWindow()) -> Message:
    """
    Build the CameraInfo again.

    Parameters
    ----------
    camera : CopiedCamera
    header : std_msgs/Header
        That of the image.
    types : MessageTypes
    window : ImageWindow
        What the image shows of the sensor.

    Returns
    -------
    sensor_msgs/CameraInfo

    """
    roi = types.RegionOfInterest(x_offset=window.x_offset, y_offset=window.y_offset,
                                 height=window.height, width=window.width,
                                 do_rectify=window.do_rectify)
    return types.CameraInfo(
        header=copy_header(header, types), height=camera.height, width=camera.width,
        distortion_model=camera.model, d=camera.d, k=camera.K, r=camera.R, p=camera.P,
        binning_x=window.binning_x, binning_y=window.binning_y, roi=roi)
