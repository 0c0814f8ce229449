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
"""What rorapid_tracker says of one object: the latched state has the reason that holds now."""

from types import SimpleNamespace

import pytest
from selfcal_ros.nodes import object_topics
from selfcal_ros.nodes.object_topics import ObjectTopics
from selfcal_ros.rorapid.tracked_frame import TrackerState
from selfcal_ros.synthetic.object_shapes import cube
from std_msgs.msg import String


class Clock:
    """A clock that the test moves on."""

    now_s = 100.0

    def monotonic(self):
        return self.now_s


class Node:
    """As much of the node as an object needs; keeps what is published and logged."""

    image_frame = 'camera'
    parameters = SimpleNamespace(object_frame='object', camera_model='perspective')

    def __init__(self):
        self.said, self.logged = [], []

    def create_publisher(self, kind, name, qos):
        def publish(msg):
            if isinstance(msg, String):
                self.said.append(msg.data)
        return SimpleNamespace(publish=publish)

    def create_subscription(self, *_):
        pass

    create_service = create_subscription

    def get_logger(self):
        return SimpleNamespace(info=self.logged.append, warning=self.logged.append)

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0))


@pytest.fixture
def topics(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(object_topics, 'time', clock)
    node = Node()
    made = ObjectTopics(node, cube(0.1).model, '', None, lambda *_, **__: None)
    return made, node, clock


def test_another_reason_of_the_same_state_is_told_but_its_numbers_alone_are_not(topics):
    topics, node, clock = topics
    for k in range(90):
        topics._say(f'degraded: Only {50 - 0.1 * k:.1f} % is found.', TrackerState.DEGRADED)
        clock.now_s += 0.033
    assert node.said == ['degraded: Only 50.0 % is found.']
    for _ in range(3):
        topics._say('degraded: The model seems too long.', TrackerState.DEGRADED)
        clock.now_s += 0.033
    assert node.said[1:] == ['degraded: The model seems too long.']
    # one line of the log for each state
    assert len(node.logged) == 1
    topics._say('lost: Gone.', TrackerState.LOST)
    topics._say('waiting for a start pose')
    assert node.said[2:] == ['lost: Gone.', 'waiting for a start pose']


def test_reasons_that_come_and_go_with_each_image_are_told_once_a_second(topics):
    topics, node, clock = topics
    for k in range(300):
        topics._say(('tracking', 'tracking: Zoom is held.')[k % 2], TrackerState.TRACKING)
        clock.now_s += 1 / 30
    assert 9 <= len(node.said) <= 11
    # what holds in the end is what the latched topic says
    for _ in range(40):
        topics._say('tracking', TrackerState.TRACKING)
        clock.now_s += 1 / 30
    assert node.said[-1] == 'tracking'
