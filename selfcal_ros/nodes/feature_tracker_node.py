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

from collections import deque
import secrets
import time
from typing import Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from msg_adapters.camera_info import camera_info_message
from msg_adapters.diagnostics import diagnostics_message, OK, STALE, status_message, WARN
from msg_adapters.image import image_message, ImageDecoder
from msg_adapters.message_types import Message, rclpy_types
from msg_adapters.stamps import header_message, stamp_ns
from msg_adapters.tracks import LARGEST_SIDE_PX, tracks_message
import numpy as np
from rclpy.node import Node
from selfcal_ros.errors import InputError
from selfcal_ros.features.image_circle import CircleWatch
from selfcal_ros.features.interlaced import is_interlaced, of_even_rows
from selfcal_ros.features.klt import KltTracker
from selfcal_ros.features.mask import ImageMask, read_mask
from selfcal_ros.features.two_views import TwoViewsWatch
from selfcal_ros.nodes.construction import whole_or_none
from selfcal_ros.nodes.diagnostic_name import diagnostic_name
from selfcal_ros.nodes.given_paths import given_path
from selfcal_ros.nodes.image_topics import ImageInputs
from selfcal_ros.nodes.input_watchdog import InputWatchdog
from selfcal_ros.nodes.once_per_image import announcements_of
from selfcal_ros.nodes.parameter_declaration import declare, follow
from selfcal_ros.nodes.parameters import FeatureTrackerParameters
from selfcal_ros.nodes.quality_of_service import IMAGES_OUT, PER_IMAGE, STEADY
from selfcal_ros.nodes.rival_publishers import RivalPublishers
from selfcal_ros.pipeline.size_guard import SizeGuard
from selfcal_ros.pipeline.stamp_order import stamp_order, StampOrder
from selfcal_ros.report.tracks_overlay import TracksOverlay
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

#: So many images wait at most while another is followed; a short hindrance costs none.
MOST_WAITING = 5
#: Ids begin anywhere below this: a tracker that is started again must not give those that
#: listeners know from the one before it. A message has room for three billion more.
FIRST_IDS = 2 ** 30
#: Smaller images than this hold no features worth following.
MINIMUM_SIDE_PX = 64


class TracksListener(Protocol):
    """Somebody in this process who takes the tracks without a message in between."""

    def announce(self, header: Message, image_size: tuple[int, int]) -> None:
        """An image has come; its tracks will follow in some milliseconds."""

    def take(self, header: Message, image_size: tuple[int, int], ids: np.ndarray,
             xy: np.ndarray) -> None:
        """Take the tracks of the image that was announced."""


class FeatureTrackerNode(Node):
    """
    Follows corners through `image` or `image/compressed` and publishes `tracks`.

    Attributes
    ----------
    listeners : list of TracksListener
        They are told before anybody else; see `selfcal_ros.nodes.composition`.

    """

    @whole_or_none
    def __init__(self) -> None:
        super().__init__('feature_tracker')
        self.parameters = declare(self, FeatureTrackerParameters)
        self.listeners: list[TracksListener] = []
        self._types = rclpy_types()
        self._decoder = ImageDecoder()
        self._tracker = KltTracker(most=self.parameters.max_features,
                                   first_id=secrets.randbelow(FIRST_IDS))
        self._mask = _mask_of(self.parameters)
        self._circle = CircleWatch(every=5)
        self._views = TwoViewsWatch()
        self._drawing = TracksOverlay()
        self._newest_ns: int | None = None
        self._size: tuple[int, int] | None = None
        self._sizes = SizeGuard()
        self._waiting: deque[Any] = deque()
        self._next = self.create_guard_condition(self._follow_next)
        self.tracks = self.create_publisher(PointCloud2, 'tracks', PER_IMAGE)
        self._announced = self.create_publisher(
            CameraInfo, announcements_of(self.tracks.topic_name), PER_IMAGE)
        self._overlay = self.create_publisher(Image, '~/overlay', IMAGES_OUT)
        self._inputs = ImageInputs(self, self._on_image, self._is_heard,
                                   transport=self.parameters.image_transport,
                                   reliability=self.parameters.reliability)
        self._watchdog = InputWatchdog(self, 'images', lambda: self._inputs.topics,
                                       self.parameters.silence_s)
        self._rivals = RivalPublishers(self, lambda: self._inputs.topics,
                                       'end all but one, or remap the input')
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._idle = self.create_timer(1.0, self._say_idle, clock=STEADY)
        self.create_timer(1.0, self._diagnose, clock=STEADY)
        follow(self, _mask_of, self._change)

    def _is_heard(self) -> bool:
        """Tell whether images are wanted now; lazily, as image_transport does."""
        return bool(not self.parameters.lazy or self.listeners
                    or self.tracks.get_subscription_count()
                    or self._overlay.get_subscription_count())

    def _change(self, new: FeatureTrackerParameters, old: FeatureTrackerParameters) -> None:
        """Do what changed parameters say, from the next image on."""
        self._tracker.most = new.max_features
        if new.mask != old.mask:
            self._mask = _mask_of(new)
        self._watchdog.limit_s = new.silence_s
        self._inputs.choose(new.image_transport, new.reliability)

    def _say_idle(self) -> None:
        """Tell, once, why nothing happens while nobody listens."""
        self._idle.cancel()
        if not self._inputs.topics:
            self.get_logger().info(f'images are subscribed to once somebody subscribes to '
                                   f'{self.tracks.topic_name} (parameter lazy)')

    def _on_image(self, msg: Message) -> None:
        self._watchdog.heard()
        self._waiting.append(msg)
        self._next.trigger()

    def _follow_next(self) -> None:
        """Follow the oldest image that waits, and tell of those that there is no time for."""
        self._inputs.fetch()
        while len(self._waiting) > MOST_WAITING:
            self._inputs.count.skip()
            self._leave_out(self._waiting.popleft())
        if not self._waiting:
            return
        began = time.perf_counter()
        self._follow(self._waiting.popleft())
        self._inputs.count.worked(time.perf_counter() - began)
        if self._waiting:
            self._next.trigger()

    def _leave_out(self, msg: Message) -> None:
        """Tell of an image without its points: it is to have its CameraInfo all the same."""
        size = (msg.width, msg.height) if isinstance(msg, Image) else self._size
        if self._size is None or size != self._size:
            return
        self._announce(msg.header, self._size)
        if not self.listeners or self.tracks.get_subscription_count():
            self.tracks.publish(tracks_message([], [], self._size, msg.header, self._types))

    def _follow(self, msg: Message) -> None:
        """Find the points of an image, and publish them."""
        try:
            grey = self._decoder.grey(msg)
        except InputError as error:
            self.get_logger().warning(f'image dropped: {error}', throttle_duration_sec=5.0)
            return
        size = (grey.shape[1], grey.shape[0])
        if min(size) < MINIMUM_SIDE_PX:
            self.get_logger().warning(
                f'image dropped: {size[0]}x{size[1]} pixels are too few; '
                f'{MINIMUM_SIDE_PX} a side are needed', throttle_duration_sec=5.0)
            return
        if max(size) > LARGEST_SIDE_PX:
            self.get_logger().warning(
                f'image dropped: {size[0]}x{size[1]} pixels are too many; tracks can tell of '
                f'{LARGEST_SIDE_PX} a side', throttle_duration_sec=5.0)
            return
        if not self._sizes.takes(size, time.monotonic()):
            return
        if not self._is_in_order(stamp_ns(msg.header.stamp), size):
            self._leave_out(msg)
            return
        try:
            self._look_where(grey)
        except InputError as error:
            self.get_logger().warning(f'image dropped: {error}', throttle_duration_sec=5.0)
            return
        self._announce(msg.header, size)
        if is_interlaced(grey):
            grey = of_even_rows(grey)
            self.get_logger().warning('images are interlaced: their even rows alone are followed',
                                      once=True)
        ids, xy = self._tracker.add(grey)
        for listener in self.listeners:
            listener.take(msg.header, size, ids, xy)
        if not self.listeners or self.tracks.get_subscription_count():
            self.tracks.publish(tracks_message(ids, xy, size, msg.header, self._types))
        if self._overlay.get_subscription_count():
            self._overlay.publish(image_message(self._drawing.draw(grey, ids, xy), msg.header,
                                                self._types))

    def _announce(self, header: Message, size: tuple[int, int]) -> None:
        """Tell of an image before its points are followed: its CameraInfo need not wait."""
        for listener in self.listeners:
            listener.announce(header, size)
        if self._announced.get_subscription_count():
            self._announced.publish(camera_info_message(None, header, self._types, size))

    def _diagnose(self) -> None:
        """Say what became of the images, and warn once where they are being lost."""
        count = self._inputs.count
        count.look()
        news = self._inputs.complaint(news=True)
        if news:
            self.get_logger().warning(news)
        level, text = OK, 'images are followed'
        complaint = self._mixed() or self._rivals.complaint or self._inputs.complaint()
        if not self._inputs.topics:
            text = 'nobody subscribes to the tracks'
        elif self._watchdog.too_long_s:
            level, text = STALE, f'no images for {self._watchdog.too_long_s:.0f} s'
        elif complaint:
            level, text = WARN, complaint
        status = status_message(f'{diagnostic_name(self)}: images', level, text, self._types,
                                count.values)
        header = header_message(self.get_clock().now().nanoseconds, '', self._types)
        self._diagnostics.publish(diagnostics_message([status], header, self._types))

    def _mixed(self) -> str:
        """Say that images of several sizes come, where they do."""
        other, size = self._sizes.mixed_with(time.monotonic()), self._sizes.size
        if other is None or size is None:
            return ''
        text = (f'images of {other[0]}x{other[1]} pixels come between those of '
                f'{size[0]}x{size[1]}, which alone are followed: one topic is for one camera')
        self.get_logger().warning(text, throttle_duration_sec=30.0)
        return text

    def _look_where(self, grey: np.ndarray) -> None:
        """Follow points within the mask and the circle of the image; InputError if they differ."""
        if self._mask is not None:
            self._mask.check(grey.shape)
        halves = self._views.see(grey)
        if halves:
            self.get_logger().warning(
                f'each image holds two views of one scene, {halves}, as of a stereo camera: crop '
                'one of them, with the node crop_decimate of image_proc')
        finding = self._circle.see(grey)
        if finding is not None:
            self.get_logger().info(finding.sentence)
        self._tracker.mask = self._circle.narrowed(self._mask)

    def _is_in_order(self, stamp: int, size: tuple[int, int]) -> bool:
        """Tell whether an image is newer than the last; begin anew where another stream begins."""
        order = stamp_order(stamp, self._newest_ns)
        if order is StampOrder.OVERTAKEN:
            return False
        if order is StampOrder.JUMPED_BACK:
            self.get_logger().info('time jumped back; tracking starts anew',
                                   throttle_duration_sec=5.0)
            self._tracker.reset()
        if self._size not in (None, size):
            self.get_logger().info(f'images changed size from {self._size[0]}x{self._size[1]} to '
                                   f'{size[0]}x{size[1]}; tracking starts anew')
            self._tracker.reset()
        self._newest_ns, self._size = stamp, size
        return True


def _mask_of(parameters: FeatureTrackerParameters) -> ImageMask | None:
    """Read the mask that parameters name; InputError where it cannot be read."""
    return read_mask(given_path(parameters.mask)) if parameters.mask else None
