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
"""diagnostic_msgs: what a node says of itself once a second."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msg_adapters.message_types import Message, MessageTypes

#: Levels of diagnostic_msgs/DiagnosticStatus.
OK, WARN, ERROR, STALE = range(4)


def status_message(name: str, level: int, text: str, types: MessageTypes,
                   values: Mapping[str, object] | None = None, hardware_id: str = '') -> Message:
    """
    Build a DiagnosticStatus.

    Parameters
    ----------
    name : str
        'node: subcomponent'.
    level : int
        OK, WARN, ERROR or STALE; it becomes what rclpy or rosbags wants for a byte.
    text : str
        One line for a person.
    types : MessageTypes
    values : mapping, optional
        Shown as strings: floats with six digits.
    hardware_id : str
        Camera name.

    """
    pairs = [types.KeyValue(key=str(key),
                            value=f'{value:.6g}' if isinstance(value, float) else str(value))
             for key, value in (values or {}).items()]
    return types.DiagnosticStatus(name=name, level=level, message=text, hardware_id=hardware_id,
                                  values=pairs)


def diagnostics_message(statuses: Iterable[Message], header: Message,
                        types: MessageTypes) -> Message:
    """Build a DiagnosticArray."""
    return types.DiagnosticArray(header=header, status=list(statuses))


def status_level(msg: Message) -> int:
    """Return the level of a DiagnosticStatus, which is bytes in rclpy and int in rosbags."""
    return msg.level[0] if isinstance(msg.level, bytes) else int(msg.level)
