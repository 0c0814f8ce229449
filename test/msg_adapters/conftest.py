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
"""Run every message test with both kinds of messages."""

import os

# rclpy reads this when a message class is first imported
os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')

from msg_adapters.message_types import rclpy_types, rosbags_types  # noqa: E402
import pytest  # noqa: E402


@pytest.fixture(params=['rclpy', 'rosbags'])
def types(request):
    """Return the builders of one kind of message; skip rclpy's where it is not installed."""
    if request.param == 'rclpy':
        pytest.importorskip('rclpy', reason='rclpy is not installed')
        pytest.importorskip('sensor_msgs.msg', reason='the ROS messages are not installed')
        return rclpy_types()
    return rosbags_types()


@pytest.fixture
def header(types):
    """Return a header with a stamp that does not survive a detour through a float."""
    return types.Header(stamp=types.Time(sec=1_700_000_001, nanosec=123_456_789),
                        frame_id='camera_optical_frame')
