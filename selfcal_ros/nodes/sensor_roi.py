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
"""What a camera driver says of its images although it is not calibrated: binning and region."""

from __future__ import annotations

from collections.abc import Callable

from msg_adapters.camera_info import camera_info_message, ImageWindow, window_of
from msg_adapters.message_types import Message, MessageTypes
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from sensor_msgs.msg import CameraInfo

#: Where the CameraInfo of the driver is read: beside ours, never in its place.
DRIVER_TOPIC = 'driver/camera_info'
#: Best effort, as for images: it matches every driver.
DRIVER_INFO_IN = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


class SensorRoi:
    """
    The part of the sensor that the images show, from the driver's own CameraInfo.

    Without one the images are taken for whole.

    Parameters
    ----------
    node : rclpy.node.Node
    on_change : callable
        Called with a sentence when another part is shown from now on: what was found out about
        the images before does not hold for those that follow.

    """

    def __init__(self, node: Node, on_change: Callable[[str], None]) -> None:
        self._node, self._on_change = node, on_change
        self._window, self._full = ImageWindow(), (0, 0)
        self._heard = False
        node.create_subscription(CameraInfo, DRIVER_TOPIC, self._on_info, DRIVER_INFO_IN)

    def _on_info(self, msg: CameraInfo) -> None:
        try:
            window = window_of(msg)
        except InputError as error:
            self._node.get_logger().warning(f'{DRIVER_TOPIC} ignored: {error}',
                                            throttle_duration_sec=5.0)
            return
        changed = self._heard and window != self._window
        self._window, self._full = window, (int(msg.width), int(msg.height))
        self._heard = True
        if changed:
            self._on_change('the driver changed its binning or its region of interest')

    def _fits(self, image_size: tuple[int, int]) -> bool:
        """Tell whether the images are what the driver says."""
        if self._window.is_full or 0 in self._full:
            return False
        expected = self._window.image_size(*self._full)
        # (0, 0): no image has told its size yet, and nothing contradicts the driver
        if 0 in image_size or expected == tuple(image_size):
            return True
        self._node.get_logger().warning(
            f'{DRIVER_TOPIC} tells of images of {expected[0]}x{expected[1]} pixels, but they have '
            f'{image_size[0]}x{image_size[1]}: its binning and region are not used',
            throttle_duration_sec=30.0)
        return False

    def full_camera(self, camera: Camera) -> Camera:
        """Return the camera of the full sensor, given that of the images."""
        if not self._fits((camera.width, camera.height)):
            return camera
        return self._window.full_camera(camera, *self._full)

    def image_camera(self, full: Camera, image_size: tuple[int, int]) -> Camera:
        """Return the camera of the images, given that of the full sensor."""
        return self._window.image_camera(full) if self._fits(image_size) else full

    def message(self, camera: Camera | None, header: Message, image_size: tuple[int, int],
                types: MessageTypes) -> Message:
        """
        Build the CameraInfo of an image: for the full sensor, with the driver's window.

        Parameters
        ----------
        camera : Camera or None
            Of the images as they come; None: not known yet.
        header : std_msgs/Header
            That of the image.
        image_size : (int, int)
            Of the image; (0, 0) if it is not known.
        types : MessageTypes

        """
        if not self._fits(image_size):
            return camera_info_message(camera, header, types, image_size)
        full = None if camera is None else self._window.full_camera(camera, *self._full)
        return camera_info_message(full, header, types, self._full, self._window)
