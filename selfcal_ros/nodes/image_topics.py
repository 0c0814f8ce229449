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

from rclpy.qos import QoSProfile, ReliabilityPolicy

from selfcal_ros.nodes.quality_of_service import IMAGES_IN, IMAGES_IN_RELIABLE

#: As image_transport names them.
COMPRESSED = 'compressed'


def compressed_topic(node) -> str:
    """
    Return the name of the compressed sibling of `image`.

    Who remaps `image` to /camera/image_raw means /camera/image_raw/compressed as well; a remap of
    `image/compressed` of its own wins.
    """
    plain, beside = (node.resolve_topic_name(name, only_expand=True)
                     for name in ('image', f'image/{COMPRESSED}'))
    resolved = node.resolve_topic_name(f'image/{COMPRESSED}')
    image = node.resolve_topic_name('image')
    if resolved != beside or image == plain:
        return f'image/{COMPRESSED}'
    return f'{image}/{COMPRESSED}'


def image_profile(node, topic: str, reliability: str) -> QoSProfile:
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
