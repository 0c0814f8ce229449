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
"""
A node of one's own that listens to the tracks: is the camera moving, and how fast?

    ros2 run selfcal_ros feature_tracker --ros-args -r image:=/camera/image_raw
    python examples/motion_meter.py

It publishes the median displacement of the points between two images, in pixels, on `~/motion_px`.
"""

import sys

from msg_adapters.tracks import tracks_from_message
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from selfcal_ros.errors import InputError
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float32


class MotionMeter(Node):
    """Publishes how far the points of an image have moved since the one before."""

    def __init__(self):
        super().__init__('motion_meter')
        self._last = None
        self._motion = self.create_publisher(Float32, '~/motion_px', 10)
        # the tracks are reliable: ten images may wait
        self.create_subscription(PointCloud2, 'tracks', self._on_tracks, 10)

    def _on_tracks(self, msg):
        try:
            now = tracks_from_message(msg)
        except InputError as error:
            self.get_logger().warning(f'tracks dropped: {error}', throttle_duration_sec=5.0)
            return
        last, self._last = self._last, now
        if last is None or now.stamp_ns <= last.stamp_ns:
            return
        # the identity of a point is the same in every image that shows it
        _, before, after = np.intersect1d(last.track, now.track, return_indices=True)
        if len(before):
            moved = np.linalg.norm(now.xy[after] - last.xy[before], axis=1)
            self._motion.publish(Float32(data=float(np.median(moved))))


def main() -> int:
    """Run until Ctrl-C; returns the exit status."""
    rclpy.init()
    try:
        rclpy.spin(MotionMeter())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
