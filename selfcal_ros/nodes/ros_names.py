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
"""Names of topics and services, looked at before ROS does: it answers with an exception."""

from __future__ import annotations

from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_topic_name import validate_topic_name


def name_problem(node: Node, name: str, is_service: bool = False) -> str:
    """
    Say why a node can have no topic of a name; '' if it can.

    Parameters
    ----------
    node : rclpy.node.Node
    name : str
        Relative, ~/private or absolute.
    is_service : bool
        It is to be that of a service.

    """
    try:
        validate_topic_name(name, is_service=is_service)
        validate_full_topic_name(expand_topic_name(name, node.get_name(), node.get_namespace()),
                                 is_service=is_service)
    except (NameValidationException, ValueError) as error:
        return str(error).partition('\n')[0].rstrip(':')
    return ''
