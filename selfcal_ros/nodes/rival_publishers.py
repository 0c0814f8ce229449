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
"""Notices that several nodes publish what one should."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from selfcal_ros.nodes.quality_of_service import STEADY


class RivalPublishers:
    """
    Warns where a topic has more than one publisher, and again when these are others.

    Parameters
    ----------
    node : rclpy.node.Node
    topics : callable
        Returns the resolved names of the topics that should have one publisher.
    consequence : str
        What happens, and what to do: the second half of the sentence.

    """

    def __init__(self, node: Node, topics: Callable[[], list[str]], consequence: str) -> None:
        self._node, self._topics, self._consequence = node, topics, consequence
        self._said = ''
        self.complaint = ''
        node.create_timer(1.0, self._look, clock=STEADY)

    def _look(self) -> None:
        self.complaint = '; '.join(filter(None, map(self._described, sorted(self._topics()))))
        # silence in between: who has gone and comes back is told of again
        if self.complaint and self.complaint != self._said:
            self._node.get_logger().warning(self.complaint)
        self._said = self.complaint

    def _described(self, topic: str) -> str:
        """Name the publishers of a topic, if there are several."""
        infos = self._node.get_publishers_info_by_topic(topic)
        if len(infos) < 2:
            return ''
        names = ', '.join(sorted(f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                                 for info in infos))
        return f'{topic} has {len(infos)} publishers ({names}): {self._consequence}'
