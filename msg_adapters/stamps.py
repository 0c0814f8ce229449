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
"""Time stamps and headers."""

from __future__ import annotations

from msg_adapters.message_types import Message, MessageTypes

from selfcal_ros.errors import ArgumentError


def stamp_ns(stamp: Message) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def time_message(nanoseconds: int, types: MessageTypes) -> Message:
    """
    Build a builtin_interfaces/Time.

    Raises
    ------
    ArgumentError
        If the time does not fit; ROS counts seconds in 32 bits.

    """
    seconds, rest = divmod(int(nanoseconds), 1_000_000_000)
    if not -2 ** 31 <= seconds < 2 ** 31:
        raise ArgumentError(f'{nanoseconds} ns is beyond the range of a ROS time stamp.')
    return types.Time(sec=seconds, nanosec=rest)


def header_message(nanoseconds: int, frame_id: str, types: MessageTypes) -> Message:
    """Build a std_msgs/Header."""
    return types.Header(stamp=time_message(nanoseconds, types), frame_id=frame_id)


def copy_header(header: Message, types: MessageTypes) -> Message:
    """Copy a header bit by bit, also from rosbags' kind to rclpy's or back."""
    stamp = types.Time(sec=header.stamp.sec, nanosec=header.stamp.nanosec)
    return types.Header(stamp=stamp, frame_id=header.frame_id)
