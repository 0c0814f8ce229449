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
"""A node that hears nothing says so, and says who is there to be heard."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import time

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from selfcal_ros.nodes.quality_of_service import STEADY

#: What our nodes draw is nobody's input.
DRAWN = '/overlay'
#: Topics that a warning names at most, as those that might be meant.
MAX_SUGGESTIONS = 5


class InputWatchdog:
    """
    Warns once a silence lasts, and again when it comes back or its reason changes.

    The sentence names the topics as they resolve and looks at the publishers at that moment:
    'no images on /cam/image_raw for 5 s; 1 publisher, best effort (driver)'. Where nobody
    publishes, it names the topics of the same type that there are; where the type is another,
    it says so.

    Parameters
    ----------
    node : rclpy.node.Node
    what : str
        Plural of what should arrive, for the warning.
    topics : callable
        Returns the resolved names of the topics that are subscribed now. While there are none,
        the silence is our own, and nothing is said.
    limit_s : float

    """

    def __init__(self, node: Node, what: str, topics: Callable[[], Iterable[str]],
                 limit_s: float) -> None:
        self._node, self._what, self._topics = node, what, topics
        self._last = time.monotonic()
        self._warned = ''
        self._timer = node.create_timer(1.0, self._check, clock=STEADY)
        self.limit_s = limit_s

    @property
    def limit_s(self) -> float:
        """How long a silence may last; may be set at any time."""
        return self._limit_s

    @limit_s.setter
    def limit_s(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._timer.timer_period_ns = int(min(1.0, limit_s / 4) * 1e9)
        # or the old period would pass first
        self._timer.reset()

    def heard(self) -> None:
        """Note that something has arrived."""
        self._last = time.monotonic()
        if self._warned:
            self._node.get_logger().info(f'{self._what} arrive again')
            self._warned = ''

    @property
    def too_long_s(self) -> float:
        """Seconds of a silence that is beyond the limit, 0 otherwise."""
        silent_s = self.silent_s
        return silent_s if silent_s > self.limit_s else 0.0

    @property
    def silent_s(self) -> float:
        """Seconds since something arrived, or since the start."""
        return time.monotonic() - self._last

    def _check(self) -> None:
        if self.silent_s < self.limit_s:
            return
        topics = sorted(self._topics())
        if not topics:
            self._last = time.monotonic()
            return
        # again only when there is something new to say: a publisher has come, or gone
        text = f'no {self._what} on {" or ".join(topics)}'
        publishers = self._publishers(topics)
        if text + publishers != self._warned:
            self._warned = text + publishers
            self._node.get_logger().warning(
                f'{text} for {max(self.limit_s, int(self.silent_s)):g} s; {publishers}')

    def _publishers(self, topics: list[str]) -> str:
        """Describe who publishes what we listen to."""
        # rclpy says that the class of a message is a message
        wanted = {one.topic_name: type_name(one.msg_type)  # type: ignore[arg-type]
                  for one in self._node.subscriptions}
        found = {topic: self._node.get_publishers_info_by_topic(topic) for topic in topics}
        found = {topic: infos for topic, infos in found.items() if infos}
        if not found:
            types = {wanted[topic] for topic in topics if topic in wanted}
            return 'no publisher' + self._suggestion(types)
        return '; '.join(self._described(infos, wanted.get(topic),
                                         f' on {topic}' if len(topics) > 1 else '')
                         for topic, infos in found.items())

    @staticmethod
    def _described(infos: Sequence[TopicEndpointInfo], wanted: str | None, where: str) -> str:
        """Say how many they are, how they send, and whether they send what we read."""
        kinds = sorted({'best effort' if info.qos_profile.reliability
                        == ReliabilityPolicy.BEST_EFFORT else 'reliable' for info in infos})
        names = ', '.join(sorted({info.node_name for info in infos}))
        text = (f'{len(infos)} publisher{"s" if len(infos) > 1 else ""}{where}, '
                f'{" and ".join(kinds)} ({names})')
        others = sorted({info.topic_type for info in infos} - {wanted})
        if wanted and others:
            text += f', of type {" and ".join(others)} where {wanted} is read'
        return text

    def _suggestion(self, types: set[str]) -> str:
        """Name the topics that somebody may have meant, or what else to do."""
        ours = {one.topic_name for one in self._node.publishers}
        there = [name for name, kinds in self._node.get_topic_names_and_types()
                 if types & set(kinds) and name not in ours and not name.endswith(DRAWN)
                 and self._node.count_publishers(name)]
        if not there:
            return ': start what publishes them, or remap the input'
        more = ', ...' if len(there) > MAX_SUGGESTIONS else ''
        return (f'; {self._what} may be meant on {", ".join(there[:MAX_SUGGESTIONS])}{more}: '
                'remap the input')


def type_name(message: type) -> str:
    """Return the name of a message as the graph has it: package/msg/Name."""
    package, kind = message.__module__.split('.')[:2]
    return f'{package}/{kind}/{message.__name__}'
