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
"""bag_player: publishes the images of a bag, byte for byte, at the pace of their recording."""

from __future__ import annotations

from collections.abc import Iterator
import time

from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import time_message
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from rosgraph_msgs.msg import Clock as ClockMessage
from selfcal_ros.errors import InputError
from selfcal_ros.nodes.construction import whole_or_none
from selfcal_ros.nodes.given_paths import given_path
from selfcal_ros.nodes.image_topics import compressed_topic
from selfcal_ros.nodes.parameter_declaration import declare, follow
from selfcal_ros.nodes.parameters import BagPlayerParameters
from selfcal_ros.nodes.quality_of_service import IMAGES_REPLAYED, STEADY
from selfcal_ros.pipeline.replay import ImageRecording
from sensor_msgs.msg import CompressedImage, Image

#: Between images, /clock ticks at least this often.
CLOCK_PERIOD_S = 0.02
#: A longer gap between images is a clock that was set, or a pause; so much of it is played.
LONGEST_GAP_S, PLAYED_GAP_S = 60.0, 1.0


class BagPlayer(Node):
    """Publishes `image` or `image/compressed`, and /clock; done at the end of the bag."""

    @whole_or_none
    def __init__(self) -> None:
        super().__init__('bag_player')
        self.parameters = declare(self, BagPlayerParameters)
        if not self.parameters.bag:
            raise InputError('bag_player needs a bag: --ros-args -p bag:=/path/to/bag')
        self.finished = Future()
        self._recording = ImageRecording(given_path(self.parameters.bag),
                                         self.parameters.topic or None)
        name, message = (('image', Image) if self._recording.message_type.endswith('/Image')
                         else (compressed_topic(self), CompressedImage))
        self._publisher = self.create_publisher(
            message, name, IMAGES_REPLAYED,
            qos_overriding_options=QoSOverridingOptions.with_default_policies())
        # not self._clock, which is the node's own
        self._time = (self.create_publisher(ClockMessage, '/clock', 10)
                      if self.parameters.publish_clock else None)
        self._types = rclpy_types()
        self._waiting_since = time.monotonic()
        self._messages: Iterator[tuple[int, bytes]] | None = None
        self._began = 0.0
        self._next: tuple[int, bytes] | None = None
        self._published = 0
        self._timer = self.create_timer(0.05, self._tick, clock=STEADY)
        self.get_logger().info(f'{self._recording.count} images of {self._recording.topic} in '
                               f'{self.parameters.bag}, on {self._publisher.topic_name}')
        if self.parameters.wait_for_subscribers_s:
            self.get_logger().info(f'waiting for a subscriber on {self._publisher.topic_name} '
                                   f'({self.parameters.wait_for_subscribers_s:g} s)')
        follow(self, self._check_change, self._change)

    def _check_change(self, new: BagPlayerParameters) -> None:
        """Refuse what would have no effect any more."""
        if self.finished.done():
            raise InputError('The bag has been played to its end; start another bag_player.')

    def _change(self, new: BagPlayerParameters, old: BagPlayerParameters) -> None:
        """Go on at another speed, from the time of the bag that it is now."""
        if self._messages is not None and new.rate != old.rate:
            now = time.monotonic()
            self._begin_ns += int((now - self._began) * old.rate * 1e9)
            self._began = now
            # the image that was waited for is due at another time
            self._timer.timer_period_ns = 100_000
            self._timer.reset()

    def _tick(self) -> None:
        if self._messages is None:
            if not self._may_start():
                return
            self._rewind()
        now = time.monotonic()
        while self._next is not None and self._due(self._next[0]) <= now:
            stamp_ns, content = self._next
            self._tell_time(stamp_ns)
            self._publisher.publish(content)
            self._published += 1
            # `_rewind` has set it
            self._next = next(self._messages, None)  # type: ignore[arg-type]
            self._shorten_gap(stamp_ns)
        if self._next is None:
            self._at_end()
            return
        self._tell_time(self._begin_ns + int(
            (now - self._began) * self.parameters.rate * 1e9))
        wait = min(max(self._due(self._next[0]) - time.monotonic(), 1e-4), CLOCK_PERIOD_S)
        self._timer.timer_period_ns = int(wait * 1e9)

    def _may_start(self) -> bool:
        """Tell whether somebody listens, or whether we have waited long enough."""
        limit = self.parameters.wait_for_subscribers_s
        if self._publisher.get_subscription_count() > 0 or limit == 0:
            return True
        if time.monotonic() - self._waiting_since < limit:
            return False
        self.get_logger().warning(f'nobody subscribes to {self._publisher.topic_name} after '
                                  f'{limit:g} s; playing all the same')
        return True

    def _rewind(self) -> None:
        self._messages = self._recording.messages(self.parameters.start_offset)
        self._next = next(self._messages, None)
        if self._next is None:
            raise InputError(f'{self.parameters.bag} has no image after '
                             f'{self.parameters.start_offset:g} s; choose a smaller start_offset.')
        self._begin_ns = self._next[0]
        self._began = time.monotonic()

    def _shorten_gap(self, last_ns: int) -> None:
        """Let the time of the bag jump where hours or years lie between two images."""
        if self._next is None:
            return
        gap_s = (self._next[0] - last_ns) / 1e9
        if gap_s > LONGEST_GAP_S:
            self._begin_ns += self._next[0] - last_ns - int(PLAYED_GAP_S * 1e9)
            self.get_logger().warning(
                f'the next image is {gap_s:.0f} s later, as after a clock is set: of such gaps '
                f'{PLAYED_GAP_S:g} s is played', once=True)

    def _due(self, stamp_ns: int) -> float:
        """Return the monotonic time at which a message is due."""
        return self._began + (stamp_ns - self._begin_ns) * 1e-9 / self.parameters.rate

    def _tell_time(self, stamp_ns: int) -> None:
        if self._time is not None:
            self._time.publish(ClockMessage(clock=time_message(stamp_ns, self._types)))

    def _at_end(self) -> None:
        if self.parameters.loop:
            self._rewind()
            return
        self._timer.cancel()
        self._recording.close()
        # reliable subscribers may still be fetching the last images
        self._publisher.wait_for_all_acked(Duration(seconds=2))
        self.get_logger().info(f'played {self._published} images')
        self.finished.set_result(True)
