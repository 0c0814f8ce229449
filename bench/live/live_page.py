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
"""What the live page costs while nobody looks, and while a browser does, at 30 Hz."""

from __future__ import annotations

from importlib.util import find_spec
import os
from pathlib import Path
import re
import subprocess
import sys
import tempfile
import threading
import time

from bench.inputs import end, process_environment, ROOT
from bench.live.live import _message, RATE_HZ
from bench.tables import Report
from selfcal_ros.synthetic.recordings import agv_drive

#: Images of the drive, there and back, and seconds to measure each case.
VIEWS, SECONDS = 60, 20.0
#: Share of a core, in percent, without a browser.
MOST_IDLE = 5.0
NODES = ('feature_tracker', 'calibration_page')


def run(report: Report, options) -> None:
    """Measure the processor time of the page's process."""
    report.section('The live page, 640x480 at 30 Hz',
                   'Images published here; feature_tracker and calibration_page in processes of '
                   'their own;', 'processor time of each, in percent of a core.')
    if find_spec('rclpy') is None or find_spec('tornado') is None \
            or not Path('/proc/self/stat').exists():
        report.say("Left out: it needs rclpy, Tornado and Linux's /proc.")
        return
    seconds = SECONDS if not options.runs else min(max(options.runs, 2), SECONDS)
    rows = measure(seconds)
    report.table(('case', *NODES, 'images a second in the browser'),
                 [(case, *(f'{100 * share:.1f} %' for share in shares), f'{rate:.1f}')
                  for case, shares, rate in rows])
    report.say('')
    report.verdict('the page without a browser', 100 * rows[0][1][1], MOST_IDLE, '% of a core')
    report.judge(rows[1][2] > 0, f'with a browser: {rows[1][2]:.1f} images a second')


def measure(seconds: float) -> list[tuple[str, list[float], float]]:
    """Return, without and with a browser, the load of each node and the images shown a second."""
    images = [image for image, _ in agv_drive(VIEWS, rate_hz=RATE_HZ).frames()]
    with tempfile.TemporaryDirectory() as folder:
        # a domain of its own: other ROS programs on this machine must not hear the images
        os.environ.update({
            'FASTRTPS_DEFAULT_PROFILES_FILE': str(ROOT / 'config' / 'fastdds.xml'),
            'ROS_DOMAIN_ID': str(1 + os.getpid() % 100), 'ROS_LOG_DIR': folder})
        nodes = [subprocess.Popen(
            [sys.executable, '-m', f'selfcal_ros.nodes.{name}', '--ros-args', '-p', 'port:=0'],
            start_new_session=True, cwd=folder, env=process_environment(), text=True,
            stderr=subprocess.PIPE if name == NODES[1] else subprocess.DEVNULL)
            for name in NODES]
        try:
            for line in nodes[1].stderr:
                if found := re.search(r'http://\S+', line):
                    break
            threading.Thread(target=nodes[1].stderr.read, daemon=True).start()
            return _cases(images, nodes, found[0], seconds)
        finally:
            end(nodes)


def _cases(images, nodes, url: str, seconds: float) -> list:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    import rclpy
    from selfcal_ros.nodes.quality_of_service import IMAGES_IN
    from sensor_msgs.msg import Image
    rclpy.init()
    camera = rclpy.create_node('bench_camera')
    try:
        publisher = camera.create_publisher(Image, 'image', IMAGES_IN)
        said = camera.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # in place of a calibrator, which would only take the machine's time
        status = DiagnosticArray(status=[DiagnosticStatus(
            name='planar_calibrator: calibration', message='calibrated',
            values=[KeyValue(key=key, value=value) for key, value in (
                ('keyframes', '30'), ('resets', '0'), ('fx', '520'), ('fx sigma', '1'),
                ('calibration file', 'camera.yaml'))])])
        stop = threading.Event()

        def play():
            messages = [_message(image) for image in [*images, *images[-2:0:-1]]]
            began, k = time.perf_counter(), 0
            while not stop.wait(max(0.0, began + k / RATE_HZ - time.perf_counter())):
                message = messages[k % len(messages)]
                stamp = message.header.stamp
                stamp.sec, stamp.nanosec = divmod(10 ** 15 + k * 33_333_333, 10 ** 9)
                publisher.publish(message)
                if k % 30 == 0:
                    said.publish(status)
                k += 1

        player = threading.Thread(target=play)
        player.start()
        try:
            deadline = time.monotonic() + 30
            while not publisher.get_subscription_count() and time.monotonic() < deadline:
                time.sleep(0.05)
            time.sleep(3)
            rows = [('nobody looks', _loads(nodes, seconds), 0.0)]
            with Looker(url) as looker:
                time.sleep(2)
                seen = looker.images
                loads = _loads(nodes, seconds)
                rows.append(('a browser looks', loads, (looker.images - seen) / seconds))
            return rows
        finally:
            stop.set()
            player.join()
    finally:
        camera.destroy_node()
        rclpy.try_shutdown()


def _loads(nodes, seconds: float) -> list[float]:
    """Return the processor time of processes over a while, as a share of it."""
    def spent(node):
        fields = Path(f'/proc/{node.pid}/stat').read_text(encoding='ascii').rsplit(')', 1)[1]
        return sum(map(int, fields.split()[11:13])) / os.sysconf('SC_CLK_TCK')

    before, began = [spent(node) for node in nodes], time.perf_counter()
    time.sleep(seconds)
    elapsed = time.perf_counter() - began
    return [(spent(node) - then) / elapsed for node, then in zip(nodes, before)]


class Looker:
    """What a browser does: it asks for the next image when it has one."""

    def __init__(self, url: str):
        self._url, self.images = url, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._look)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()

    def _look(self):
        import asyncio
        from urllib.request import urlopen

        from tornado.websocket import websocket_connect

        async def talk():
            page = urlopen(self._url).read().decode()
            token = re.search(r'name="token" content="([^"]+)"', page)[1]
            link = await websocket_connect(
                f'{self._url.replace("http", "ws", 1)}live?token={token}')
            await link.write_message('image')
            while not self._stop.is_set():
                if isinstance(await link.read_message(), bytes):
                    self.images += 1
                    await link.write_message('image')
            link.close()

        asyncio.run(talk())
