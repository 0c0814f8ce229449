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
"""feature_tracker: images in, tracks out, one message an image."""

from __future__ import annotations


from msg_adapters.image import ImageDecoder
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import stamp_ns
from msg_adapters.tracks import tracks_message
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

from selfcal_ros.errors import InputError
from selfcal_ros.features.klt import KltTracker
from selfcal_ros.nodes.parameters import declare, FeatureTrackerParameters
from selfcal_ros.nodes.quality_of_service import IMAGES_IN, PER_IMAGE, STEADY
from selfcal_ros.nodes.silence import SilenceWatch
from selfcal_ros.pipeline.calibration_session import BACKWARD_JUMP_NS

#: Topic and message of each image transport.
TRANSPORTS = {'raw': ('image', Image), 'compressed': ('image/compressed', CompressedImage)}
#: Smaller images than this hold no features worth following.
MINIMUM_SIDE_PX = 64


class FeatureTracker(Node):
    """Follows corners through `image` or `image/compressed` and publishes `tracks`."""

    def __init__(self):
        super().__init__('feature_tracker')
        self.parameters = declare(self, FeatureTrackerParameters)
        self._types = rclpy_types()
        self._decoder = ImageDecoder()
        self._tracker = KltTracker(most=self.parameters.max_features)
        self._newest_ns = None
        self._transport = self.parameters.image_transport
        self._inputs = {}
        self._tracks = self.create_publisher(PointCloud2, 'tracks', PER_IMAGE)
        self._silence = SilenceWatch(self, 'images', lambda: [s.topic_name for s in
                                                              self._inputs.values()],
                                     self.parameters.silence_s)
        self._connect()
        self._timer = self.create_timer(0.1, self._connect, clock=STEADY)

    def _connect(self):
        """Subscribe to what is wanted now; lazily, as image_transport does."""
        wanted = set()
        if not self.parameters.lazy or self._tracks.get_subscription_count():
            wanted = set(TRANSPORTS) if self._transport == 'auto' else {self._transport}
        for name in set(self._inputs) - wanted:
            self.destroy_subscription(self._inputs.pop(name))
        for name in wanted - set(self._inputs):
            topic, message = TRANSPORTS[name]
            self._inputs[name] = self.create_subscription(
                message, topic, lambda msg, name=name: self._on_image(msg, name), IMAGES_IN,
                qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def _on_image(self, msg, transport: str):
        if self._transport == 'auto':
            self.get_logger().info(f'images arrive on {self._inputs[transport].topic_name}')
            self._transport = transport
        if transport != self._transport:
            return
        self._silence.heard()
        try:
            gray = self._decoder.grey(msg)
        except InputError as error:
            self.get_logger().warning(f'image dropped: {error}', throttle_duration_sec=5.0)
            return
        if min(gray.shape) < MINIMUM_SIDE_PX:
            self.get_logger().warning(
                f'image dropped: {gray.shape[1]}x{gray.shape[0]} pixels are too few; '
                f'{MINIMUM_SIDE_PX} a side are needed', throttle_duration_sec=5.0)
            return
        stamp = stamp_ns(msg.header.stamp)
        if self._newest_ns is not None and stamp < self._newest_ns:
            if self._newest_ns - stamp < BACKWARD_JUMP_NS:
                return
            self.get_logger().info('time jumped back; tracking starts anew')
            self._tracker.reset()
        self._newest_ns = stamp
        ids, xy = self._tracker.add(gray)
        self._tracks.publish(tracks_message(ids, xy, (gray.shape[1], gray.shape[0]), msg.header,
                                            self._types))
