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
"""Angular rates from messages of an inertial unit; those of rclpy and of rosbags alike."""

from __future__ import annotations

from msg_adapters.message_types import Message
from msg_adapters.stamps import stamp_ns

#: Type of the messages.
IMU_TYPE = 'sensor_msgs/msg/Imu'


def angular_rate(msg: Message) -> tuple[int, tuple[float, float, float], str]:
    """
    Read the gyro of an Imu.

    Returns
    -------
    stamp_ns : int
    rate_rad_s : (float, float, float)
        About the axes of its frame; NaN where the message says that it has no gyro (REP 145).
    frame : str

    """
    rate = msg.angular_velocity
    known = float(msg.angular_velocity_covariance[0]) != -1
    return (stamp_ns(msg.header.stamp),
            (rate.x, rate.y, rate.z) if known else (float('nan'),) * 3, str(msg.header.frame_id))
