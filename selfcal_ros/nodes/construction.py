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
"""Nodes that are made whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

from rclpy.node import Node

Made = TypeVar('Made', bound=Node)
Given = ParamSpec('Given')


def whole_or_none(init: Callable[Concatenate[Made, Given], None]
                  ) -> Callable[Concatenate[Made, Given], None]:
    """
    Let the `__init__` of a node destroy the node where it raises an error.

    What the node has begun, a thread or a DDS participant, would live as long as the process else.

    Parameters
    ----------
    init : callable
        The `__init__`. The node's `destroy_node` must bear what it has not come to.

    Returns
    -------
    callable
        The same, but for that.

    """
    @wraps(init)
    def made(node: Made, /, *args: Given.args, **kwargs: Given.kwargs) -> None:
        try:
            init(node, *args, **kwargs)
        except BaseException:
            # what rclpy makes last: without it there is no node to destroy
            if hasattr(node, '_type_description_service'):
                node.destroy_node()  # type: ignore[no-untyped-call]
            raise

    return made
