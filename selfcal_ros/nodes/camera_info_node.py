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
A CameraInfo from a calibration file for every image of a driver that has no calibration.

It takes the place of camera_info_manager: the file is looked for where drivers look, followed
when it changes, and replaced by `~/set_camera_info`.
"""

from __future__ import annotations

from msg_adapters.camera_info import camera_info_message, ImageWindow, window_of
from msg_adapters.copied_camera import copied_camera, copied_message, CopiedCamera
from msg_adapters.message_types import Message, rclpy_types
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions
from selfcal_ros.errors import InputError
from selfcal_ros.nodes.calibration_file import CalibrationFile
from selfcal_ros.nodes.construction import whole_or_none
from selfcal_ros.nodes.image_topics import ImageInputs
from selfcal_ros.nodes.input_watchdog import InputWatchdog
from selfcal_ros.nodes.parameter_declaration import declare, follow
from selfcal_ros.nodes.parameters import CameraInfoPublisherParameters
from selfcal_ros.nodes.quality_of_service import IMAGES_IN, PER_IMAGE, STEADY
from selfcal_ros.nodes.rival_publishers import RivalPublishers
from selfcal_ros.nodes.sensor_roi import DRIVER_TOPIC
from selfcal_ros.report.copied_camera_yaml import read_copied_camera, write_copied_camera
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo


class CameraInfoPublisher(Node):
    """Publishes `camera_info`, with the stamp and frame of the driver's own or of the images."""

    @whole_or_none
    def __init__(self) -> None:
        super().__init__('camera_info_publisher')
        self.parameters = declare(self, CameraInfoPublisherParameters)
        self._file = CalibrationFile(self.parameters.camera_name, self.parameters.camera_info_url)
        self._types = rclpy_types()
        self._camera: CopiedCamera | None = None
        self._modified_ns: int | None = None
        self._publisher = self.create_publisher(CameraInfo, 'camera_info', PER_IMAGE)
        source = self.parameters.source
        if source == 'driver':
            driver = self.create_subscription(
                CameraInfo, DRIVER_TOPIC, self._on_driver, IMAGES_IN,
                qos_overriding_options=QoSOverridingOptions.with_default_policies())
            self._topics = lambda: [driver.topic_name]
        else:
            images = ImageInputs(self, self._on_image, reliability='auto',
                                 transport='raw' if source == 'image' else source)
            self._topics = lambda: images.topics
        self._watchdog = InputWatchdog(self, 'messages', self._topics, self.parameters.silence_s)
        self._rivals = RivalPublishers(
            self, lambda: [self._publisher.topic_name],
            'whoever listens gets both; remap camera_info of this node, or end the other')
        self.create_service(SetCameraInfo, '~/set_camera_info', self._on_set)
        self._look()
        self.create_timer(1.0, self._look, clock=STEADY)
        follow(self, self._check_change, self._change)

    def _check_change(self, new: CameraInfoPublisherParameters) -> None:
        """Refuse a file that cannot be read: the calibration in force is better than none."""
        if new.camera_info_url != self.parameters.camera_info_url:
            read_copied_camera(CalibrationFile(new.camera_name, new.camera_info_url).path)

    def _change(self, new: CameraInfoPublisherParameters,
                old: CameraInfoPublisherParameters) -> None:
        """Do what changed parameters say."""
        self._watchdog.limit_s = new.silence_s
        if new.camera_info_url != old.camera_info_url:
            self._file = CalibrationFile(new.camera_name, new.camera_info_url)
            # the calibration in force was that of another file
            self._camera = self._modified_ns = None
            self._look()

    def _look(self) -> None:
        """Read the file where it is new."""
        try:
            modified_ns = self._file.path.stat().st_mtime_ns
        except OSError:
            modified_ns = 0
        if modified_ns == self._modified_ns:
            return
        self._modified_ns = modified_ns
        if not modified_ns:
            self.get_logger().warning(
                f'{self._file.path} does not exist: ' +
                ('K is zero until it does' if self._camera is None else
                 'the last calibration stays in force until it does'))
            return
        try:
            self._camera, name = read_copied_camera(self._file.path)
        except InputError as error:
            self.get_logger().error(f'{error} K is zero until it can be read.' if
                                    self._camera is None else
                                    f'{error} The last calibration stays in force.')
            return
        if name not in ('', self._file.camera_name):
            self.get_logger().warning(f'{self._file.path} is of the camera {name!r}, not of '
                                      f'{self._file.camera_name!r}; used all the same')
        self.get_logger().info(f'calibration from {self._file.path}')

    def _on_driver(self, msg: CameraInfo) -> None:
        self._watchdog.heard()
        try:
            window = window_of(msg)
        except InputError as error:
            self.get_logger().warning(f'{DRIVER_TOPIC} dropped: {error}',
                                      throttle_duration_sec=5.0)
            return
        size = int(msg.width), int(msg.height)
        self._publish(msg.header, size, window)

    def _on_image(self, msg: Image | CompressedImage) -> None:
        self._watchdog.heard()
        # a compressed image does not tell its size before it is decoded
        size = (int(msg.width), int(msg.height)) if isinstance(msg, Image) else (0, 0)
        self._publish(msg.header, size, ImageWindow())

    def _publish(self, header: Message, size: tuple[int, int], window: ImageWindow) -> None:
        camera = self._fitting(size)
        self._publisher.publish(
            camera_info_message(None, header, self._types, size, window) if camera is None
            else copied_message(camera, header, self._types, window))

    def _fitting(self, size: tuple[int, int]) -> CopiedCamera | None:
        """Return the camera if it is one of this size; (0, 0): the size is not known."""
        camera = self._camera
        if camera is None or size in ((0, 0), (camera.width, camera.height)):
            return camera
        self.get_logger().warning(
            f'the calibration is for {camera.width}x{camera.height} pixels and the camera has '
            f'{size[0]}x{size[1]}: K is zero; calibrate at this size, or let the driver tell its '
            'binning and region of interest', throttle_duration_sec=30.0)
        return None

    def _on_set(self, request: SetCameraInfo.Request,
                response: SetCameraInfo.Response) -> SetCameraInfo.Response:
        """Take a calibration at once, and keep it in the file as camera_info_manager does."""
        try:
            camera = copied_camera(request.camera_info)
        except InputError as error:
            response.success, response.status_message = False, str(error)
            return response
        self._camera = camera
        try:
            self._file.path.parent.mkdir(parents=True, exist_ok=True)
            write_copied_camera(self._file.path, camera, self._file.camera_name,
                                ['received by set_camera_info'])
        except (InputError, OSError) as error:
            response.success = False
            response.status_message = f'in force, but not written: {error}'
            return response
        self._modified_ns = self._file.path.stat().st_mtime_ns
        response.success = True
        response.status_message = f'in force, and written to {self._file.path}'
        return response
