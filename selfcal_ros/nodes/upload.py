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
"""Gives a calibration to a camera driver, where that is wished; nothing depends on it."""

from __future__ import annotations

from msg_adapters.camera_info import camera_info_message
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import header_message
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.nodes.ros_names import name_problem
from sensor_msgs.srv import SetCameraInfo

SERVICE_TYPE = 'sensor_msgs/srv/SetCameraInfo'


def check_service(node: Node, service: str) -> None:
    """
    Refuse what cannot be the name of a service of a node; none is fine.

    Raises
    ------
    ArgumentError
        It says what is wrong with the name.

    """
    why = name_problem(node, service, is_service=True) if service else ''
    if why:
        raise ArgumentError(f'The parameter set_camera_info_service cannot be {service!r}: {why}.')


class CameraInfoUpload:
    """
    Calls `set_camera_info` of a driver, without ever waiting for it.

    Parameters
    ----------
    node : rclpy.node.Node
    service : str
        Name of the service, as ROS resolves it; empty: nothing is uploaded.

    Raises
    ------
    ArgumentError
        If there cannot be a service of this name.

    """

    def __init__(self, node: Node, service: str) -> None:
        check_service(node, service)
        self._node = node
        self._client = node.create_client(
            SetCameraInfo, service,
            callback_group=ReentrantCallbackGroup()) if service else None
        self._name = node.resolve_service_name(service) if service else ''
        self._missed = False

    def close(self) -> None:
        """Upload nothing any more."""
        if self._client is not None:
            self._node.destroy_client(self._client)
            self._client = None

    def send(self, camera: Camera) -> str:
        """
        Send the camera of the full sensor.

        Returns
        -------
        str
            What has been done, for a person; empty where nothing is to be uploaded. What the
            driver answers is logged.

        """
        if self._client is None:
            return ''
        if not self._client.service_is_ready():
            text = f'{self._name} is not there, hence not uploaded; {self._others()}'
            # once: the calibration does not depend on it
            if not self._missed:
                self._node.get_logger().warning(text)
            self._missed = True
            return text
        self._missed = False
        types = rclpy_types()
        header = header_message(self._node.get_clock().now().nanoseconds, '', types)
        request = SetCameraInfo.Request(camera_info=camera_info_message(camera, header, types))
        self._client.call_async(request).add_done_callback(self._answered)
        return f'sent to {self._name}'

    def _others(self) -> str:
        """Name the services that could have been meant."""
        there = [name for name, kinds in self._node.get_service_names_and_types()
                 if SERVICE_TYPE in kinds and name != self._name]
        return (f'services of this type: {", ".join(there)}' if there
                else 'there is no other service of this type')

    def _answered(self, future: Future) -> None:
        try:
            answer = future.result()
        except Exception as error:  # a driver that goes down in between
            self._node.get_logger().warning(f'{self._name} did not answer: {error}')
            return
        if answer.success:
            self._node.get_logger().info(f'{self._name} has taken the calibration')
        else:
            self._node.get_logger().warning(
                f'{self._name} refused the calibration: {answer.status_message}')
