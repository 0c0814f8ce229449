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
Image to CameraInfo at 1280x720 and 30 Hz: nodes in processes of their own, and in one.

The images are published here, as a camera driver would, and the CameraInfo of each is received
here: the same two process boundaries for both arrangements. The drive is long enough that
estimates run while images come.
"""

from __future__ import annotations

from contextlib import contextmanager
from importlib.util import find_spec
import os
import subprocess
import sys
import tempfile
import time

from bench.inputs import end, process_environment, ROOT
from bench.tables import Report
import cv2
import numpy as np
from selfcal_ros.synthetic.recordings import agv_drive

#: Images of the drive; at 30 Hz for so many seconds, there and back until it is over.
VIEWS, RATE_HZ, SECONDS = 180, 30.0, 12.0
#: Rendered at half the size and enlarged: latency does not ask how sharp an image is.
RENDERED, ENLARGED = (640, 360), 2
MAX_MS = 20.0
#: Required of either arrangement: the median of its CameraInfo over that of its tracks.
MAX_RATIO = 0.5
#: Processes of each arrangement: modules of selfcal_ros.nodes, with their arguments.
ARRANGEMENTS = {
    'two processes': [['feature_tracker'], ['planar_calibrator']],
    'one process': [['composition', 'feature_tracker', 'planar_calibrator']],
}
HEADER = ('arrangement', 'output', 'images', 'median ms', 'p95 ms', 'p99 ms', 'max ms', 'lost')


def run(report: Report, options) -> None:
    """Render a drive once; time both arrangements with it."""
    report.section('Image to CameraInfo, 1280x720 at 30 Hz',
                   'mono8 images published here, nodes elsewhere, tracks and CameraInfo received '
                   'here; from before publish() to the callback.')
    if find_spec('rclpy') is None:
        report.say('Left out: rclpy is not installed.')
        return
    count = VIEWS if not options.runs else max(options.runs, 20)
    images = [cv2.resize(image, None, fx=ENLARGED, fy=ENLARGED)
              for image, _ in agv_drive(count, RENDERED, rate_hz=RATE_HZ).frames()]
    rows = []
    for name, processes in ARRANGEMENTS.items():
        times, sent = measured(images, processes)
        for topic, values in times.items():
            rows.append((name, topic, sent, *(f'{value:.1f}' for value in np.percentile(
                values, [50, 95, 99, 100])), f'{sent - len(values)} of {sent}'))
        report.judge(len(times['tracks']) == len(times['camera_info']) == sent,
                     f'{name}: all images tracked, none lost')
        report.verdict(f'{name}: 95 of 100 images, image to CameraInfo',
                       float(np.percentile(times['camera_info'], 95)), MAX_MS, 'ms')
        report.verdict(f'{name}: CameraInfo over tracks, medians',
                       float(np.median(times['camera_info']) / np.median(times['tracks'])),
                       MAX_RATIO, '')
    report.table(HEADER, rows)


@contextmanager
def running(processes):
    """Run modules of selfcal_ros.nodes as processes; they are gone afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        # a domain of its own: other ROS programs on this machine must not hear the images
        os.environ.update({
            'FASTRTPS_DEFAULT_PROFILES_FILE': str(ROOT / 'config' / 'fastdds.xml'),
            'ROS_DOMAIN_ID': str(1 + os.getpid() % 100), 'ROS_LOG_DIR': folder})
        started = []
        try:
            for module, *arguments in processes:
                started.append(subprocess.Popen(
                    [sys.executable, '-m', f'selfcal_ros.nodes.{module}', *arguments],
                    start_new_session=True, cwd=folder, env=process_environment()))
            yield
        finally:
            end(started)


def measured(images, processes) -> tuple[dict, int]:
    """
    Publish images at 30 Hz to nodes in processes, and time what comes back.

    Returns
    -------
    times : dict
        By topic, milliseconds from before publish() to its callback.
    sent : int

    """
    import rclpy
    with running(processes):
        rclpy.init()
        camera = Camera(rclpy.create_node('bench_camera'))
        try:
            camera.connect()
            # the first images pay for what starts late in all processes
            camera.play(images[:10])
            camera.forget()
            stream = [*images, *images[-2:0:-1]]
            count = int(SECONDS * RATE_HZ)
            camera.play([stream[k % len(stream)] for k in range(count)])
            return camera.times, count
        finally:
            camera.node.destroy_node()
            rclpy.try_shutdown()


class Camera:
    """Publishes images, and times the tracks and the CameraInfo of each."""

    def __init__(self, node):
        from selfcal_ros.nodes.quality_of_service import IMAGES_IN, PER_IMAGE
        from sensor_msgs.msg import CameraInfo, Image, PointCloud2
        self.node = node
        self.publisher = node.create_publisher(Image, 'image', IMAGES_IN)
        self.times = {'tracks': [], 'camera_info': []}
        for topic, message in (('tracks', PointCloud2), ('camera_info', CameraInfo)):
            node.create_subscription(message, topic,
                                     lambda msg, topic=topic: self._heard(topic, msg), PER_IMAGE)
        self._published, self._count = {}, 0

    def forget(self) -> None:
        """Start the measurement anew."""
        for values in self.times.values():
            values.clear()
        self._published.clear()

    def connect(self) -> None:
        """Wait until everybody hears everybody."""
        import rclpy
        deadline = time.monotonic() + 30
        while not (self.publisher.get_subscription_count() and self.node.count_publishers('tracks')
                   and self.node.count_publishers('camera_info')):
            if time.monotonic() > deadline:
                raise TimeoutError('the nodes did not connect within 30 s')
            rclpy.spin_once(self.node, timeout_sec=0.1)

    def play(self, images) -> None:
        """Publish at 30 Hz, and wait for what comes of the last images."""
        import rclpy
        from sensor_msgs.msg import Image
        began = time.perf_counter()
        for k, image in enumerate(images):
            height, width = image.shape
            message = Image(height=height, width=width, encoding='mono8', step=width)
            message.data.frombytes(image.tobytes())
            message.header.frame_id = 'camera_optical_frame'
            stamp_ns = 10 ** 18 + self._count * 33_333_333
            self._count += 1
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10 ** 9)
            due = began + k / RATE_HZ
            while (wait := due - time.perf_counter()) > 0:
                rclpy.spin_once(self.node, timeout_sec=wait)
            self._published[_key(message)] = time.perf_counter()
            self.publisher.publish(message)
        deadline = time.monotonic() + 3.0
        while time.monotonic() < deadline and \
                min(map(len, self.times.values())) < len(self._published):
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def _heard(self, topic: str, message) -> None:
        began = self._published.get(_key(message))
        if began is not None:
            self.times[topic].append(1000 * (time.perf_counter() - began))


def _key(message) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec
