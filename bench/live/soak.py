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
Do the nodes grow while they run? Hours of a recorded drive in a loop, as fast as they answer.

Each node is a process of its own. It gets the next message when it has answered the last few, so
that ten hours pass in some twenty minutes; timers tick in real time. The live page answers nothing
and is sent 500 messages a second. The slope of a node's memory is that of a line through the
second half. Its standard error allows for the steps in which an allocator grows: it is half of the
widest change between neighbouring tenths.
"""

from __future__ import annotations

from importlib.util import find_spec
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import time

from bench.inputs import process_environment, ROOT
from bench.tables import Report
import numpy as np

#: Images a second of the simulated time; of nodes that take milliseconds for one, fewer.
RATE_HZ = 30.0
SLOWER_HZ = {'planar_calibrator': 10.0, 'affine_calibrator': 10.0, 'feature_tracker': 10.0,
             'rorapid_tracker': 3.0}
#: Simulated hours, and seconds of real time at most, a node.
HOURS, MOST_S = 10.0, 3600.0
#: So many messages may be unanswered; the tracker of objects takes the newest only.
AHEAD, AHEAD_OF_OBJECTS = 8, 1
#: Messages a second of real time to a node that answers none.
UNANSWERED_HZ = 500.0
#: More growth than this, beyond twice its error, fails; the calibrator's 54 MB an hour did.
MOST_MB_PER_HOUR = 1.0
BAG, OBJECT = ROOT / 'bags' / 'agv_drive', ROOT / 'bags' / 'tracked_object'
#: Calibrators without their estimates, which would take all the time.
COLLECTING = ['monitor:=false', 'max_keyframes:=400', 'first_estimate:=400', 'idle_s:=3600.0']
#: Parameters of each node.
NODES = {
    'bag_player': [f'bag:={BAG}', 'loop:=true', 'rate:=100.0'],
    'feature_tracker': [],
    'planar_calibrator': COLLECTING,
    'affine_calibrator': COLLECTING,
    'camera_info_publisher': [],
    'calibration_page': ['port:=0', 'calibrator:=planar_calibrator'],
    'rorapid_tracker': [f'model:={OBJECT}.model.yaml', f'camera_file:={OBJECT}.camera.yaml',
                        f'start_pose:={OBJECT}.pos'],
}
HEADER = ('node', 'images', 'simulated hours', 'MB', 'MB an hour', '±', 'threads', 'files')


def run(report: Report, options) -> None:
    """Run every node for its hours, or for as long as there is time."""
    report.section('Memory of the nodes over simulated hours', *__doc__.split('\n\n')[1:])
    if find_spec('rclpy') is None:
        report.say('Left out: rclpy is not installed.')
        return
    rows = []
    for name in NODES:
        images, mb, counts = soak(name)
        hours = images / SLOWER_HZ.get(name, RATE_HZ) / 3600
        slope, error = growth(hours, mb)
        rows.append((name, int(images[-1]), f'{hours[-1]:.1f}', f'{mb[-1]:.0f}',
                     f'{slope:+.2f}', f'{error:.2f}', *(f'{a} to {b}' for a, b in zip(*counts))))
        report.verdict(f'{name}: growth beyond twice its error', max(slope - 2 * error, 0.0),
                       MOST_MB_PER_HOUR, 'MB an hour')
        report.judge(counts[0] == counts[1], f'{name}: no more threads and files than after a '
                     'tenth of the time')
    report.table(HEADER, rows)


def growth(hours: np.ndarray, mb: np.ndarray) -> tuple[float, float]:
    """
    Return the slope of the second half and its standard error, in MB an hour.

    Parameters
    ----------
    hours, mb : ndarray, shape (N,)

    """
    late = hours >= hours[-1] / 2
    hours, mb = hours[late], mb[late]
    slope = np.polyfit(hours, mb, 1)[0]
    tenths = np.array([part.mean() for part in np.array_split(mb, min(10, len(mb)))])
    step = np.abs(np.diff(tenths)).max(initial=0.0) / 2
    return float(slope), float(max(step / (hours[-1] - hours[0]), 1e-3))


def soak(name: str) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int]]]:
    """
    Run a node.

    Returns
    -------
    images, mb : ndarray, shape (N,)
        Messages until then, and memory.
    counts : list of (int, int)
        Threads and open files after a tenth of the time, and at the end.

    """
    import rclpy
    with tempfile.TemporaryDirectory() as folder:
        os.environ.update({
            'FASTRTPS_DEFAULT_PROFILES_FILE': str(ROOT / 'config' / 'fastdds.xml'),
            'ROS_DOMAIN_ID': str(1 + os.getpid() % 100), 'ROS_LOG_DIR': folder,
            'ROS_HOME': folder})
        given = [word for one in NODES[name] for word in ('-p', one)]
        process = subprocess.Popen(
            [sys.executable, '-m', f'selfcal_ros.nodes.{name}', '--ros-args', *given],
            start_new_session=True, cwd=folder, env=process_environment(),
            stderr=subprocess.DEVNULL)
        rclpy.init()
        try:
            return _watch(process, Feeder(name))
        finally:
            rclpy.try_shutdown()
            process.send_signal(signal.SIGINT)
            process.wait(20)


def allocated_mb(process: int) -> float:
    """
    Return the memory that a process has allocated and uses, in MB.

    Segments shared by DDS do not count: each participant of the machine that comes by adds some.
    """
    text = Path(f'/proc/{process}/status').read_text(encoding='ascii')
    return int(re.search(r'RssAnon:\s+(\d+) kB', text)[1]) * 1024 / 1e6


def _watch(process, feeder) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int]]]:
    began, images, mb, counts = time.monotonic(), [], [], []
    feeder.connect()
    end = time.monotonic() + MOST_S
    while feeder.images < HOURS * 3600 * feeder.rate_hz and time.monotonic() < end:
        if process.poll() is not None:
            raise RuntimeError(f'{process.args} ended with status {process.returncode}')
        feeder.feed(1.0)
        images.append(feeder.images)
        mb.append(allocated_mb(process.pid))
        late = (time.monotonic() - began) / MOST_S > 0.1
        if late or not counts:
            now = tuple(len(os.listdir(f'/proc/{process.pid}/{one}')) for one in ('task', 'fd'))
            counts = [counts[0] if len(counts) > 1 else now, now]
    return np.array(images), np.array(mb), counts


class Feeder:
    """Sends a node what it reads, and counts what it answers."""

    def __init__(self, name: str):
        import rclpy
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from sensor_msgs.msg import CameraInfo, CompressedImage, PointCloud2
        self.images = self._sent = self._number = 0
        self.rate_hz = SLOWER_HZ.get(name, RATE_HZ)
        self._node = rclpy.create_node('soak')
        self._messages, self._publisher = [], None
        self._ahead = AHEAD_OF_OBJECTS if name == 'rorapid_tracker' else AHEAD
        topic, kind = {'bag_player': ('image/compressed', CompressedImage),
                       'feature_tracker': ('tracks', PointCloud2),
                       'rorapid_tracker': ('pose', PoseWithCovarianceStamped),
                       'calibration_page': (None, None)}.get(name, ('camera_info', CameraInfo))
        if topic is not None:
            self._node.create_subscription(kind, topic, self._heard, 60)
        self._topic = topic
        if name == 'bag_player':
            return
        images = recorded(OBJECT if name == 'rorapid_tracker' else BAG)
        # there and back: nothing jumps but the time, and that not for objects
        self._jumps = name != 'rorapid_tracker'
        topic, self._messages = {
            'feature_tracker': lambda: ('image/compressed', images + images[::-1]),
            'rorapid_tracker': lambda: ('image/compressed', images + images[::-1]),
            'planar_calibrator': lambda: ('tracks', tracked(images)),
            'affine_calibrator': lambda: ('tracks', tracked(images)),
            'calibration_page': lambda: ('tracks', tracked(images)),
            'camera_info_publisher': lambda: ('driver/camera_info', [
                CameraInfo(header=image.header, width=640, height=480) for image in images]),
        }[name]()
        self._publisher = self._node.create_publisher(type(self._messages[0]), topic, 60)

    def _heard(self, _):
        self.images += 1

    def connect(self) -> None:
        """Wait for the node."""
        import rclpy
        while self._topic is not None and not self._node.count_publishers(self._topic) or (
                self._publisher is not None and not self._publisher.get_subscription_count()):
            rclpy.spin_once(self._node, timeout_sec=0.05)

    def _stamped(self, number: int):
        """Return a message of the loop, with a time that begins anew with it."""
        place = number % len(self._messages)
        message = self._messages[place]
        now_s = (place if self._jumps else number) / self.rate_hz
        message.header.stamp.sec = 100 + int(now_s)
        message.header.stamp.nanosec = int(now_s % 1 * 1e9)
        return message

    def feed(self, seconds: float) -> None:
        """Send for a while; what stays unanswered is given up."""
        import rclpy
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self._topic is None:
                self._deliver()
                continue
            if self._publisher is not None:
                self._publisher.publish(self._stamped(self._number))
                self._number += 1
                self._sent += 1
            wait = time.monotonic() + 0.2
            while True:
                rclpy.spin_once(self._node, timeout_sec=0.01)
                if self._sent - self.images < self._ahead:
                    break
                if time.monotonic() > wait:
                    self._sent = self.images
                    break

    def _deliver(self) -> None:
        """Send one message to a node that answers none."""
        self._publisher.publish(self._stamped(self._number))
        self._number += 1
        self.images += 1
        time.sleep(1 / UNANSWERED_HZ)


def recorded(bag) -> list:
    """Return the images of a recording."""
    from rclpy.serialization import deserialize_message
    from selfcal_ros.pipeline.replay import ImageRecording
    from sensor_msgs.msg import CompressedImage
    with ImageRecording(bag) as recording:
        return [deserialize_message(raw, CompressedImage) for _, raw in recording.messages()]


def tracked(images: list) -> list:
    """Return the tracks of images."""
    from msg_adapters.image import ImageDecoder
    from msg_adapters.message_types import rclpy_types
    from msg_adapters.tracks import tracks_message
    from selfcal_ros.features.klt import KltTracker
    tracker, decoder, found = KltTracker(most=400), ImageDecoder(), []
    for image in images:
        grey = decoder.grey(image)
        ids, xy = tracker.add(grey)
        found.append(tracks_message(ids, xy, grey.shape[::-1], image.header, rclpy_types()))
    return found
