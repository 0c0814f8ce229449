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
"""The calibration that a tracker hears: what is new, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable

from msg_adapters.camera_info import image_camera_from_info
from rclpy.node import Node
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.quality_of_service import IMAGES_IN
from selfcal_ros.report.camera_files.known_camera import check_unfolded
from sensor_msgs.msg import CameraInfo


class CameraInfoInput:
    """
    Listens to a camera_info; drivers send the same calibration with every image.

    Parameters
    ----------
    node : rclpy.node.Node
    topic : str
    take : callable
        Called with each Camera that differs from the one before.

    Attributes
    ----------
    problem : str
        Why the last calibration could not be used.
    frame_id : str
        Of the last message.

    """

    def __init__(self, node: Node, topic: str, take: Callable[[Camera], object]) -> None:
        self._node, self._topic, self._take = node, topic, take
        self._key: tuple[object, ...] | None = None
        self.problem = self.frame_id = ''
        # a publisher of CameraInfo may be of either reliability, too
        node.create_subscription(CameraInfo, topic, self._hear, IMAGES_IN)

    def _hear(self, msg: CameraInfo) -> None:
        self.frame_id = msg.header.frame_id
        key = (msg.width, msg.height, msg.distortion_model, msg.k.tobytes(), bytes(msg.d),
               msg.binning_x, msg.binning_y, msg.roi.x_offset, msg.roi.y_offset, msg.roi.width,
               msg.roi.height)
        if key == self._key:
            return
        self._key = key
        try:
            camera = image_camera_from_info(msg)
            if camera is not None and min(camera.width, camera.height) > 0:
                check_unfolded(camera, 'The CameraInfo is wrong')
        except InputError as error:
            self._refuse(str(error))
            return
        if camera is None:
            self._refuse('The camera_info is of a camera that is not calibrated (its focal '
                         'length is zero).')
            return
        self.problem = ''
        self._node.get_logger().info(
            f'calibration for {camera.width}x{camera.height} pixels: '
            f'fx {camera.K[0, 0]:.1f}, fy {camera.K[1, 1]:.1f} px',
            # a lens that zooms has another at every image
            throttle_duration_sec=1.0)
        self._take(camera)

    def _refuse(self, problem: str) -> None:
        self.problem = problem
        self._node.get_logger().warning(f'{self._topic} dropped: {problem}',
                                        throttle_duration_sec=5.0)
