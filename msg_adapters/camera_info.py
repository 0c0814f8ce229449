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
sensor_msgs/CameraInfo to Camera and back.

The matrices of a CameraInfo hold for the full resolution of the sensor. A driver that bins or
crops delivers smaller images; `ImageWindow` says which, and relates the two cameras with the
formula of image_geometry: fx_image = fx / b, cx_image = (cx - x_offset) / b.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from msg_adapters.message_types import Message, MessageTypes
from msg_adapters.stamps import copy_header

import numpy as np

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.values.ros_lenses import ROS_COEFFICIENTS, ros_distortion


@dataclass(frozen=True)
class ImageWindow:
    """
    Which part of the sensor the images show, and how coarsely.

    Attributes
    ----------
    binning_x, binning_y : int
        Sensor pixels to an image pixel; 0 means 1.
    x_offset, y_offset, width, height : int
        Region of interest in sensor pixels; a width or height of 0 is that of the sensor.
    do_rectify : bool
        Whether rectified images show the same window.

    """

    binning_x: int = 0
    binning_y: int = 0
    x_offset: int = 0
    y_offset: int = 0
    width: int = 0
    height: int = 0
    do_rectify: bool = False

    @property
    def is_full(self) -> bool:
        """Whether images show the whole sensor at full resolution."""
        return (self.binning_x <= 1 and self.binning_y <= 1 and
                not (self.x_offset or self.y_offset or self.width or self.height))

    def image_size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of the images of a sensor of the given size."""
        return ((self.width or width) // max(self.binning_x, 1),
                (self.height or height) // max(self.binning_y, 1))

    def image_camera(self, full: Camera) -> Camera:
        """Return the camera of the images, given that of the full sensor."""
        scale = self._scale()
        width, height = self.image_size(full.width, full.height)
        return replace(full, K=np.linalg.inv(scale) @ full.K, width=width, height=height)

    def full_camera(self, image: Camera, width: int = 0, height: int = 0) -> Camera:
        """
        Return the camera of the full sensor, given that of the images.

        The size of a cropped sensor is not in the image: give it as width and height.
        """
        if not width or not height:
            if self.width or self.height or self.x_offset or self.y_offset:
                raise ArgumentError('The full size of a cropped sensor must be given.')
            width = image.width * max(self.binning_x, 1)
            height = image.height * max(self.binning_y, 1)
        return replace(image, K=self._scale() @ image.K, width=width, height=height)

    def _scale(self) -> np.ndarray:
        """Map image pixels to sensor pixels."""
        return np.array([[max(self.binning_x, 1), 0, self.x_offset],
                         [0, max(self.binning_y, 1), self.y_offset], [0, 0, 1]], float)


def camera_info_message(camera: Camera | None, header: Message, types: MessageTypes,
                        size: tuple[int, int] | None = None,
                        window: ImageWindow = ImageWindow()) -> Message:
    """
    Build a CameraInfo.

    Parameters
    ----------
    camera : Camera or None
        Of the full sensor. None: not calibrated yet, which ROS says by zeros in K, R and P.
    header : std_msgs/Header
        That of the image, copied bit by bit: consumers match on exactly this stamp.
    types : MessageTypes
    size : (int, int), optional
        Width and height of the full sensor, for a camera that does not tell.
    window : ImageWindow

    Returns
    -------
    sensor_msgs/CameraInfo
        P = [K 0], R the identity; plumb_bob where the camera is not calibrated.

    Raises
    ------
    ArgumentError
        If the camera has no size and none is given, or ROS does not know its lens model.

    """
    if size is None:
        size = (0, 0) if camera is None else (camera.width, camera.height)
    width, height = size
    if camera is not None and not (width and height):
        raise ArgumentError('A CameraInfo needs the image size; give the camera its width and '
                            'height.')
    if camera is not None and camera.model not in ROS_COEFFICIENTS:
        raise ArgumentError(f'A CameraInfo cannot hold the lens model {camera.model}; '
                            f'{", ".join(ROS_COEFFICIENTS)} are known to ROS.')
    K = np.zeros((3, 3)) if camera is None else camera.K
    rotation = np.zeros((3, 3)) if camera is None else np.eye(3)
    roi = types.RegionOfInterest(x_offset=window.x_offset, y_offset=window.y_offset,
                                 height=window.height, width=window.width,
                                 do_rectify=window.do_rectify)
    return types.CameraInfo(
        header=copy_header(header, types), height=height, width=width,
        distortion_model='plumb_bob' if camera is None else camera.model,
        d=np.zeros(5) if camera is None else camera.distortion,
        k=K, r=rotation, p=np.column_stack([K, np.zeros(3)]),
        binning_x=window.binning_x, binning_y=window.binning_y, roi=roi)


def window_of(msg: Message) -> ImageWindow:
    """
    Return the image window of a CameraInfo.

    Raises
    ------
    InputError
        If the region lies outside the sensor, or the binning leaves no pixels.

    """
    roi = msg.roi
    window = ImageWindow(int(msg.binning_x), int(msg.binning_y), int(roi.x_offset),
                         int(roi.y_offset), int(roi.width), int(roi.height),
                         bool(roi.do_rectify))
    width, height = int(msg.width), int(msg.height)
    if window.is_full or not (width and height):
        return window
    if window.x_offset + (window.width or 1) > width or \
            window.y_offset + (window.height or 1) > height or \
            min(window.image_size(width, height)) < 1:
        raise InputError(f'The CameraInfo has a region of interest ({window}) outside of its '
                         f'{width}x{height} pixels.')
    return window


def camera_from_info(msg: Message) -> Camera | None:
    """
    Return the camera of the full sensor.

    Returns
    -------
    Camera or None
        None if the camera is not calibrated (k[0] is zero).

    Raises
    ------
    InputError
        If ROS has no such distortion model, or K is no calibration matrix.

    """
    # ROS 1 wrote these fields in capitals
    K = np.asarray(msg.k if hasattr(msg, 'k') else msg.K, float).ravel()
    d = np.asarray(msg.d if hasattr(msg, 'd') else msg.D, float).ravel()
    if K.size != 9:
        raise InputError(f'The K of a CameraInfo has 9 values, not {K.size}.')
    if K[0] == 0:
        return None
    model = str(msg.distortion_model)
    if not d.any() and model not in ROS_COEFFICIENTS:
        model, d = 'plumb_bob', d[:0]
    try:
        camera = Camera(K.reshape(3, 3), ros_distortion(model, d), msg.width, msg.height, model)
        # a rational polynomial whose denominator is 1 is a plumb bob
        is_plumb = camera.distortion_as('plumb_bob') is not None
        return camera.as_model('plumb_bob') if is_plumb else camera
    except ArgumentError as error:
        raise InputError(f'The CameraInfo is wrong: {error}') from None


def image_camera_from_info(msg: Message) -> Camera | None:
    """Return the camera of the images as they are delivered, after binning and cropping."""
    camera = camera_from_info(msg)
    return None if camera is None else window_of(msg).image_camera(camera)
