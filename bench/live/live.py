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
"""From image to tracks at 30 Hz: the tracker in this process, and the node over DDS."""

from __future__ import annotations

from importlib.util import find_spec
import os
import subprocess
import sys
import tempfile
import time

from bench.inputs import end, process_environment, ROOT
from bench.tables import Report
import numpy as np
from selfcal_ros.features.klt import KltTracker
from selfcal_ros.synthetic.recordings import agv_drive

#: Images of the drive; 30 Hz for so many seconds, there and back until it is over.
VIEWS, RATE_HZ, SECONDS = 240, 30.0, 12.0
MAX_MS = 35.0
#: Corners that are followed at once, by default.
CORNERS = {'the node': 400, 'the command': 700}


def run(report: Report, options) -> None:
    """Render a slow drive once; time the tracker, then the node."""
    count = VIEWS if not options.runs else max(options.runs, 10)
    images = [image for image, _ in agv_drive(count, rate_hz=RATE_HZ).frames()]
    in_process(report, images)
    over_dds(report, images)


def there_and_back(images, seconds: float = SECONDS):
    """Yield images for so long at 30 Hz, turning round at the ends."""
    loop = [*images, *images[-2:0:-1]]
    for k in range(int(seconds * RATE_HZ)):
        yield loop[k % len(loop)]


def latencies_row(name: str, values_ms, lost: str) -> tuple:
    """One row of the table of latencies."""
    p50, p95, p99 = np.percentile(values_ms, [50, 95, 99])
    return (name, len(values_ms), f'{p50:.1f}', f'{p95:.1f}', f'{p99:.1f}',
            f'{np.max(values_ms):.1f}', lost, f'{1000 / RATE_HZ / p50:.1f}')


HEADER = ('path', 'images', 'median ms', 'p95 ms', 'p99 ms', 'max ms', 'lost',
          'frame period / median')


def in_process(report: Report, images) -> None:
    """Time KltTracker.add, one call an image."""
    report.section('Image to tracks in one process, 640x480',
                   'KltTracker on a rendered drive, one call an image.')
    rows = []
    for name, most in CORNERS.items():
        tracker, times = KltTracker(most=most), []
        for image in there_and_back(images):
            began = time.perf_counter()
            tracker.add(image)
            times.append(1000 * (time.perf_counter() - began))
        # the first image finds all corners anew, and OpenCV starts its threads
        rows.append((latencies_row(f'KltTracker, {most} corners ({name})', times[1:], '0')))
        if most == CORNERS['the node']:
            judged = float(np.percentile(times[1:], 99))
    report.table(HEADER, rows)
    report.say('')
    report.verdict('99 of 100 images, with the corners of the node', judged, MAX_MS, 'ms')


def over_dds(report: Report, images) -> None:
    """Publish at 30 Hz from one process, track in another, and time what comes back."""
    report.section('Image to tracks over DDS, 640x480 at 30 Hz',
                   'sensor_msgs/Image published here, feature_tracker in a process of its own, '
                   'tracks received here;', 'from before publish() to the callback of the tracks.')
    if find_spec('rclpy') is None:
        report.say('Left out: rclpy is not installed.')
        return
    with tempfile.TemporaryDirectory() as folder:
        # a domain of its own: other ROS programs on this machine must not hear the images
        os.environ.update({
            'FASTRTPS_DEFAULT_PROFILES_FILE': str(ROOT / 'config' / 'fastdds.xml'),
            'ROS_DOMAIN_ID': str(1 + os.getpid() % 100), 'ROS_LOG_DIR': folder})
        node = subprocess.Popen([sys.executable, '-m', 'selfcal_ros.nodes.feature_tracker'],
                                start_new_session=True, cwd=folder, env=process_environment())
        try:
            times, sent = exchange(images)
        finally:
            end([node])
    report.table(HEADER, [latencies_row('publish, feature_tracker, tracks', times,
                                        f'{sent - len(times)} of {sent}')])
    report.say('')
    report.verdict('99 of 100 images', float(np.percentile(times, 99)), MAX_MS, 'ms')
    report.judge(len(times) >= 0.99 * sent,
                 f'keeps up: {len(times)} of {sent} images gave tracks')


def exchange(images):
    """
    Publish images at 30 Hz and wait for their tracks.

    Returns
    -------
    times : list of float
        Milliseconds from before publish() to the tracks' callback.
    sent : int

    """
    import rclpy
    from selfcal_ros.nodes.quality_of_service import IMAGES_IN, PER_IMAGE
    from sensor_msgs.msg import Image, PointCloud2

    rclpy.init()
    node = rclpy.create_node('bench_camera')
    published, times = {}, []

    def on_tracks(msg):
        key = msg.header.stamp.sec, msg.header.stamp.nanosec
        if key in published:
            times.append(1000 * (time.perf_counter() - published.pop(key)))

    try:
        publisher = node.create_publisher(Image, 'image', IMAGES_IN)
        node.create_subscription(PointCloud2, 'tracks', on_tracks, PER_IMAGE)
        deadline = time.monotonic() + 30
        while not publisher.get_subscription_count() and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)
        messages = [_message(image) for image in images]
        # the first images pay for what starts late in both processes
        _play(node, publisher, messages[:5], published, 0)
        _drain(node, published, 3.0)
        times.clear()
        published.clear()
        stream = list(there_and_back(messages))
        _play(node, publisher, stream, published, 1_000_000)
        _drain(node, published, 3.0)
        return times, len(stream)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _message(image):
    from sensor_msgs.msg import Image
    height, width = image.shape
    message = Image(height=height, width=width, encoding='mono8', step=width)
    message.data.frombytes(image.tobytes())
    message.header.frame_id = 'camera_optical_frame'
    return message


def _play(node, publisher, messages, published, first: int) -> None:
    """Publish at 30 Hz; between images, let the tracks come in."""
    import rclpy
    began = time.perf_counter()
    for k, message in enumerate(messages):
        due = began + k / RATE_HZ
        while (wait := due - time.perf_counter()) > 0:
            rclpy.spin_once(node, timeout_sec=wait)
        stamp_ns = (first + k) * 33_333_333
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10 ** 9)
        published[message.header.stamp.sec, message.header.stamp.nanosec] = time.perf_counter()
        publisher.publish(message)


def _drain(node, published, seconds: float) -> None:
    import rclpy
    deadline = time.monotonic() + seconds
    while published and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.05)
