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
"""Says why nothing arrives: the commonest trouble of a ROS user is a wrong topic or QoS."""

from __future__ import annotations

import time

from rclpy.qos import ReliabilityPolicy

from selfcal_ros.nodes.quality_of_service import STEADY


class SilenceWatch:
    """
    Warns once a silence lasts, and again when it comes back.

    Parameters
    ----------
    node : rclpy.node.Node
    what : str
        Plural of what should arrive, for the warning.
    topics : callable
        Returns the resolved names of the topics that are subscribed now.
    limit_s : float

    """

    def __init__(self, node, what: str, topics, limit_s: float):
        self._node, self._what, self._topics, self._limit_s = node, what, topics, limit_s
        self._last = time.monotonic()
        self._warned = False
        self._timer = node.create_timer(min(1.0, limit_s / 4), self._check, clock=STEADY)

    def heard(self) -> None:
        """Note that something has arrived."""
        self._last = time.monotonic()
        if self._warned:
            self._node.get_logger().info(f'{self._what} arrive again')
            self._warned = False

    @property
    def silent_s(self) -> float:
        """Seconds since something arrived, or since the start."""
        return time.monotonic() - self._last

    def _check(self):
        if self._warned or self.silent_s < self._limit_s:
            return
        topics = self._topics()
        if not topics:
            self._last = time.monotonic()
            return
        self._warned = True
        self._node.get_logger().warning(
            f'no {self._what} on {" or ".join(topics)} for {self._limit_s:g} s; '
            f'publishers: {"; ".join(self._publishers(topic) for topic in topics)}')

    def _publishers(self, topic: str) -> str:
        """Describe who publishes a topic."""
        found = self._node.get_publishers_info_by_topic(topic)
        if not found:
            return f'none on {topic} (remap the input, or start the publisher)'
        return f'{len(found)} on {topic} (' + ', '.join(
            f'{info.node_name}: {info.topic_type}, '
            + ('best effort' if info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
               else 'reliable') for info in found) + ')'
