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
"""The image topics of a node: `image` and what lies beside it, and how to subscribe to them."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from msg_adapters.message_types import Message
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from selfcal_ros.nodes.loss_count import LossCount
from selfcal_ros.nodes.quality_of_service import IMAGES_IN, IMAGES_IN_RELIABLE, STEADY
from sensor_msgs.msg import CompressedImage, Image

#: Message of each image transport.
TRANSPORTS = {'raw': Image, 'compressed': CompressedImage}
#: How often publishers and listeners are looked at.
LOOK_PERIOD_S = 0.1
#: With transport auto: after so long a silence whoever speaks is followed.
SILENT_S = 2.0
#: As image_transport names them.
COMPRESSED = 'compressed'


def compressed_topic(node: Node, base: str = 'image') -> str:
    """
    Return the name of the compressed sibling of `image`, or of another base.

    Who remaps `image` to /camera/image_raw means /camera/image_raw/compressed as well; a remap of
    `image/compressed` of its own wins.
    """
    plain, beside = (node.resolve_topic_name(name, only_expand=True)
                     for name in (base, f'{base}/{COMPRESSED}'))
    resolved = node.resolve_topic_name(f'{base}/{COMPRESSED}')
    image = node.resolve_topic_name(base)
    if resolved != beside or image == plain:
        return f'{base}/{COMPRESSED}'
    return f'{image}/{COMPRESSED}'


def image_profile(node: Node, topic: str, reliability: str) -> QoSProfile:
    """
    Return how to subscribe to an image topic now; publishers come and go.

    A best-effort subscription hears everybody, but with the default buffers of Fast DDS it loses
    most images that are larger than half a megabyte. A reliable one gets them all, but only from
    publishers that are reliable, too.

    Parameters
    ----------
    node : rclpy.node.Node
    topic : str
    reliability : {'auto', 'best_effort', 'reliable'}

    """
    if reliability == 'auto':
        found = [info.qos_profile.reliability for info in node.get_publishers_info_by_topic(topic)]
        reliable = bool(found) and set(found) == {ReliabilityPolicy.RELIABLE}
    else:
        reliable = reliability == 'reliable'
    return IMAGES_IN_RELIABLE if reliable else IMAGES_IN


class ImageInputs:
    """
    The subscriptions of a node to `image` and `image/compressed`.

    They follow what was chosen, also when that changes, and the publishers that come and go.

    Parameters
    ----------
    node : rclpy.node.Node
    take : callable
        Called with every message of the transport that is followed.
    wanted : callable, optional
        Tells whether images are wanted now; always by default.
    transport : {'auto', 'raw', 'compressed'}
        With 'auto' the one that speaks first, until it is silent for `SILENT_S`.
    reliability : {'auto', 'best_effort', 'reliable'}
    base : str
        The topic, if it is another.

    Attributes
    ----------
    count : LossCount
        What came of the images of the topic that is followed.

    """

    def __init__(self, node: Node, take: Callable[[Message], object],
                 wanted: Callable[[], bool] = lambda: True, *,
                 transport: str, reliability: str, base: str = 'image') -> None:
        self._node, self._take, self._wanted = node, take, wanted
        self._topics = {'raw': base, 'compressed': compressed_topic(node, base)}
        self._subscriptions: dict[str, Any] = {}
        self._profiles: dict[str, Any] = {}
        self._chosen = self._followed = ''
        self._heard = time.monotonic()
        self._publishers = 0
        self.count = LossCount()
        self.choose(transport, reliability)
        self._timer = node.create_timer(LOOK_PERIOD_S, self.connect, clock=STEADY)

    @property
    def topics(self) -> list[str]:
        """Resolved names of the topics that are subscribed now."""
        return [one.topic_name for one in self._subscriptions.values()]

    def look(self) -> None:
        """Count what was lost so far."""
        self.count.look()

    @property
    def values(self) -> dict[str, int]:
        """Counts for the diagnostics."""
        return self.count.values

    def choose(self, transport: str, reliability: str) -> None:
        """Follow another transport, or subscribe in another way, from now on."""
        if transport != self._chosen:
            self._chosen = self._transport = transport
        self._reliability = reliability
        self.connect()

    def connect(self) -> None:
        """Subscribe to what is wanted now, as its publishers send."""
        if self._chosen == 'auto' and time.monotonic() - self._heard > SILENT_S:
            self._transport = 'auto'
        wanted = set()
        if self._wanted():
            wanted = set(TRANSPORTS) if self._transport == 'auto' else {self._transport}
        publishers = sum(self._node.count_publishers(self._topics[name]) for name in wanted)
        if publishers != self._publishers:
            self._publishers = publishers
            self.count.begin()
        profiles = {name: image_profile(self._node, self._topics[name],
                                        self._reliability) for name in wanted}
        for name in set(self._subscriptions):
            # a publisher that sends in another way may have come
            if self._profiles[name] is not profiles.get(name):
                self._node.destroy_subscription(self._subscriptions.pop(name))
        self._profiles = profiles
        for name in sorted(wanted - set(self._subscriptions), reverse=True):
            self.count.begin()
            # rclpy hands what it knows of a message to who takes it; its types do not say so
            self._subscriptions[name] = self._node.create_subscription(
                TRANSPORTS[name], self._topics[name],
                lambda msg, about, name=name: self._on_image(  # type: ignore[arg-type,misc]
                    msg, about, name), profiles[name],
                qos_overriding_options=QoSOverridingOptions([QoSPolicyKind.HISTORY,
                                                             QoSPolicyKind.DEPTH]))

    def fetch(self) -> None:
        """Take what waits in the queue of the transport that is followed."""
        if self._transport in self._subscriptions:
            self._receive(self._transport)

    def _on_image(self, msg: Message, about: dict[str, Any], transport: str) -> None:
        if self._transport == 'auto':
            if transport != self._followed:
                self._node.get_logger().info(
                    f'images arrive on {self._subscriptions[transport].topic_name}')
                self.count.begin()
            self._transport = self._followed = transport
        if transport == self._transport:
            self._receive(transport, (msg, about))

    def _receive(self, transport: str, *taken: tuple[Message, dict[str, Any]]) -> None:
        """Count and hand over what was taken from a queue, and all that it still holds."""
        subscription = self._subscriptions[transport]
        batch = [*taken, *_waiting(subscription)]
        if not batch:
            return
        self._heard = time.monotonic()
        overrun = len(batch) >= self._profiles[transport].depth
        for number, (msg, about) in enumerate(batch):
            # a full queue has dropped what came before the oldest that it holds
            self.count.arrive(about.get('publication_sequence_number'), len(msg.data),
                              alone=self._publishers <= 1, overrun=overrun and not number)
            self._take(msg)

    def complaint(self, news: bool = False) -> str:
        """Say what is being lost and why; with `news` only where that was not said before."""
        name = self._followed or self._transport
        if name not in self._subscriptions:
            return ''
        say = self.count.news if news else self.count.complaint
        return say('images', self._subscriptions[name].topic_name,
                   self._profiles[name].reliability == ReliabilityPolicy.BEST_EFFORT)


def _waiting(subscription: Subscription) -> list[tuple[Message, dict[str, Any]]]:
    """Take what a queue holds; the executor would take one at a time."""
    found = []
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type,
                                                         subscription.raw)) is not None:
            found.append(taken)
    return found
