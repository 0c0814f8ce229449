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
"""The feature tracker: images in, positions of points with lasting ids out."""

from __future__ import annotations

from typing import Protocol

from msg_adapters.image import image_message, ImageDecoder
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import stamp_ns
from msg_adapters.tracks import tracks_message
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind
from rclpy.qos_overriding_options import QoSOverridingOptions
from selfcal_ros.errors import InputError
from selfcal_ros.features.klt import KltTracker
from selfcal_ros.nodes.image_topics import compressed_topic, image_profile
from selfcal_ros.nodes.parameters import declare, FeatureTrackerParameters
from selfcal_ros.nodes.quality_of_service import IMAGES_OUT, PER_IMAGE, STEADY
from selfcal_ros.nodes.silence import SilenceWatch
from selfcal_ros.pipeline.calibration_session import BACKWARD_JUMP_NS
from selfcal_ros.report.tracks_overlay import TracksOverlay
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

#: Message of each image transport.
TRANSPORTS = {'raw': Image, 'compressed': CompressedImage}
#: Smaller images than this hold no features worth following.
MINIMUM_SIDE_PX = 64


class TracksListener(Protocol):
    """Somebody in this process who takes the tracks without a message in between."""

    def announce(self, header, image_size: tuple[int, int]) -> None:
        """An image has come; its tracks will follow in some milliseconds."""

    def take(self, header, image_size: tuple[int, int], ids, xy) -> None:
        """Take the tracks of the image that was announced."""


class FeatureTracker(Node):
    """
    Follows corners through `image` or `image/compressed` and publishes `tracks`.

    Attributes
    ----------
    listeners : list of TracksListener
        They are told before anybody else; see `selfcal_ros.nodes.all`.

    """

    def __init__(self):
        super().__init__('feature_tracker')
        self.parameters = declare(self, FeatureTrackerParameters)
        self.listeners: list[TracksListener] = []
        self._types = rclpy_types()
        self._decoder = ImageDecoder()
        self._tracker = KltTracker(most=self.parameters.max_features)
        self._drawing = TracksOverlay()
        self._newest_ns = None
        self._size = None
        self._transport = self.parameters.image_transport
        self._topics = {'raw': 'image', 'compressed': compressed_topic(self)}
        self._inputs = {}
        self._profiles = {}
        self.tracks = self.create_publisher(PointCloud2, 'tracks', PER_IMAGE)
        self._overlay = self.create_publisher(Image, '~/overlay', IMAGES_OUT)
        self._silence = SilenceWatch(self, 'images', lambda: [s.topic_name for s in
                                                              self._inputs.values()],
                                     self.parameters.silence_s)
        self._connect()
        self._timer = self.create_timer(0.1, self._connect, clock=STEADY)
        self._idle = self.create_timer(1.0, self._say_idle, clock=STEADY)

    def _connect(self):
        """Subscribe to what is wanted now; lazily, as image_transport does."""
        wanted = set()
        if not self.parameters.lazy or self.listeners or self.tracks.get_subscription_count() \
                or self._overlay.get_subscription_count():
            wanted = set(TRANSPORTS) if self._transport == 'auto' else {self._transport}
        profiles = {name: image_profile(self, self._topics[name], self.parameters.reliability)
                    for name in wanted}
        for name in set(self._inputs):
            # a publisher that sends in another way may have come
            if self._profiles[name] is not profiles.get(name):
                self.destroy_subscription(self._inputs.pop(name))
        self._profiles = profiles
        for name in wanted - set(self._inputs):
            self._inputs[name] = self.create_subscription(
                TRANSPORTS[name], self._topics[name],
                lambda msg, name=name: self._on_image(msg, name), profiles[name],
                qos_overriding_options=QoSOverridingOptions([QoSPolicyKind.HISTORY,
                                                             QoSPolicyKind.DEPTH]))

    def _say_idle(self):
        """Tell, once, why nothing happens while nobody listens."""
        self._idle.cancel()
        if not self._inputs:
            self.get_logger().info(f'images are subscribed to once somebody subscribes to '
                                   f'{self.tracks.topic_name} (parameter lazy)')

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
        size = (gray.shape[1], gray.shape[0])
        if min(size) < MINIMUM_SIDE_PX:
            self.get_logger().warning(
                f'image dropped: {size[0]}x{size[1]} pixels are too few; '
                f'{MINIMUM_SIDE_PX} a side are needed', throttle_duration_sec=5.0)
            return
        if not self._is_in_order(stamp_ns(msg.header.stamp), size):
            return
        for listener in self.listeners:
            listener.announce(msg.header, size)
        ids, xy = self._tracker.add(gray)
        for listener in self.listeners:
            listener.take(msg.header, size, ids, xy)
        if not self.listeners or self.tracks.get_subscription_count():
            self.tracks.publish(tracks_message(ids, xy, size, msg.header, self._types))
        if self._overlay.get_subscription_count():
            self._overlay.publish(image_message(self._drawing.draw(gray, ids, xy), msg.header,
                                                self._types))

    def _is_in_order(self, stamp: int, size: tuple[int, int]) -> bool:
        """Tell whether an image is newer than the last; begin anew where another stream begins."""
        if self._newest_ns is not None and stamp < self._newest_ns:
            if self._newest_ns - stamp < BACKWARD_JUMP_NS:
                return False
            self.get_logger().info('time jumped back; tracking starts anew')
            self._tracker.reset()
        if self._size not in (None, size):
            self.get_logger().info(f'images changed size from {self._size[0]}x{self._size[1]} to '
                                   f'{size[0]}x{size[1]}; tracking starts anew')
            self._tracker.reset()
        self._newest_ns, self._size = stamp, size
        return True
