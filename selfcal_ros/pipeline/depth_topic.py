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
"""The depth images of a bag, each for the stamp of an image."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msg_adapters.image import depth_metres
from msg_adapters.stamps import stamp_ns
import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.bag_source import is_bag, open_bag
from selfcal_ros.pipeline.depth_pairing import SAME_NS

#: Depth images are kept for so long, nanoseconds: the two topics are recorded in any order.
_KEPT_NS = 500_000_000
_IMAGE = 'sensor_msgs/msg/Image'


class DepthTopic:
    """
    Depth images by stamp; made by `open_depths`.

    Attributes
    ----------
    found : int
        Images that had a depth.

    """

    def __init__(self, messages: Iterator[tuple[Any, Any]]) -> None:
        """Read on as stamps are asked for."""
        self._messages = messages
        self._kept: list[tuple[int, object]] = []
        self.found = 0

    def at(self, stamp: int) -> np.ndarray | None:
        """
        Return the depths (H, W) in metres of an instant; stamps must grow.

        Raises
        ------
        InputError
            If the message is no depth image.

        """
        newest = self._kept[-1][0] if self._kept else stamp
        while newest < stamp + SAME_NS:
            following = next(self._messages, None)
            if following is None:
                break
            newest = stamp_ns(following[1].header.stamp)
            # what is too old, as where stamps are zero, is not kept for the loop to end
            if newest > stamp - _KEPT_NS:
                self._kept.append((newest, following[1]))
        self._kept = [one for one in self._kept if one[0] > stamp - _KEPT_NS]
        near = min(self._kept, key=lambda one: abs(one[0] - stamp), default=None)
        if near is None or abs(near[0] - stamp) > SAME_NS:
            return None
        self.found += 1
        return depth_metres(near[1])


@contextmanager
def open_depths(path: str | Path, topic: str) -> Iterator[DepthTopic]:
    """
    Open the depth images of a bag.

    Raises
    ------
    InputError
        If the input is no bag, or has no such topic of images.

    """
    if not is_bag(Path(path)):
        raise InputError(f'{path} is no bag, so it has no topic {topic:.80} of depths; leave '
                         '--depth-topic out, or give a bag.')
    with open_bag(path) as bag:
        connections = [one for one in bag.connections
                       if one.topic in (topic, f'/{topic}') and one.msgtype == _IMAGE]
        if not connections:
            others = sorted({one.topic for one in bag.connections if one.msgtype == _IMAGE})
            raise InputError(f'{path} has no images on {topic!r:.80}; there are '
                             f'{", ".join(others) or "none"}.')
        yield DepthTopic(bag.messages(connections))
