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
"""The three kinds of topics that the nodes use, and how reliably each travels."""

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

#: Images: best effort matches every publisher; late images are worth nothing.
IMAGES_IN = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
#: Images of publishers that are reliable: large ones then arrive whatever the size of the
#: transport's buffers, if later.
IMAGES_IN_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
#: Images for people: viewers may ask for reliable ones, and want the newest.
IMAGES_OUT = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
#: Images of a recording: none is to be lost.
IMAGES_REPLAYED = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
#: One small message an image: tracks, camera_info. They wait for two seconds of 30 Hz.
PER_IMAGE = QoSProfile(depth=60, reliability=ReliabilityPolicy.RELIABLE)
#: Results: whoever comes late gets the last one.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: For timers that must tick also while use_sim_time is set and nothing is played.
STEADY = Clock(clock_type=ClockType.STEADY_TIME)
