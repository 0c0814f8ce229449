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
"""The live page in a real browser, with a tracker and a calibrator at work."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace
from urllib.request import Request, urlopen

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from msg_adapters.message_types import rclpy_types
from msg_adapters.stamps import header_message
from msg_adapters.tracks import tracks_message
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from selfcal_ros.cli import watch
from selfcal_ros.cli.main import main
from selfcal_ros.nodes import page_node
from selfcal_ros.nodes.calibrator_node import CalibratorNode
from selfcal_ros.nodes.page_node import CalibrationPage, TRACKS_HZ
from selfcal_ros.nodes.parameters import PlanarCalibratorParameters
from selfcal_ros.nodes.feature_tracker_node import FeatureTrackerNode
from selfcal_ros.synthetic.special_scenes import drive
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger
from test_support import image_stream
from test_support.chromium import started_browser
from test_support.node_interfaces import has, written

#: Images of a wall are drawn, and the tracks of a drive with a known camera are calibrated.
OPTIONS = ('-p', 'keyframe_parallax:=0.001', '-p', 'first_estimate:=12', '-p', 'idle_s:=0.3',
           '-p', 'distortion:=none', '-p', 'port:=0', '-p', 'camera_name:=front',
           '-r', 'feature_tracker:tracks:=wall')
IMAGE = 'document.getElementById("image")'
#: Colours among the pixels of the image that is shown: those of tracks.
COLOURED = """(image => {
    const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
    [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
    pen.drawImage(image, 0, 0);
    const rgb = pen.getImageData(0, 0, canvas.width, canvas.height).data;
    let coloured = 0;
    for (let k = 0; k < rgb.length; k += 4)
        coloured += Math.max(rgb[k], rgb[k + 1], rgb[k + 2])
                    - Math.min(rgb[k], rgb[k + 1], rgb[k + 2]) > 40;
    return coloured / (rgb.length / 4);
})(document.getElementById("image"))"""


@pytest.fixture(scope='module')
def browser():
    """Start the browser once."""
    yield from started_browser()


class Stage:
    """Nodes, and what a person does with their page."""

    def __init__(self, graph, browser):
        self.graph = graph
        for node in (FeatureTrackerNode(),
                     CalibratorNode('planar_calibrator', PlanarCalibratorParameters)):
            graph.add(node)
        self.node = graph.add(CalibrationPage())
        self.tracks = graph.probe.create_publisher(PointCloud2, 'tracks', 30)
        self.camera = graph.probe.create_publisher(Image, 'image', 5)
        self.sequence = drive(np.random.default_rng(11), noise_px=0.1, views=20, tracks=300)
        self.browser = browser
        self.page = None

    def images_wanted(self):
        return self.camera.get_subscription_count() > 0

    def send(self, frames):
        """Publish the tracks of views."""
        tracks, camera, types = self.sequence.tracks, self.sequence.camera, rclpy_types()
        for frame in frames:
            mask = tracks.frame == frame
            self.tracks.publish(tracks_message(
                tracks.track[mask], tracks.xy[mask], (camera.width, camera.height),
                header_message(10 ** 18 + int(frame) * 10 ** 8, 'cam', types), types))
            self.graph.spin_for(0.02)

    def text(self, where):
        return self.page.evaluate(f'document.querySelector({where!r}).innerText')

    def wait(self, condition, what, timeout_s=60.0, meanwhile=lambda: None):
        """Let the nodes work until the page is as it should be."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, (what, self.text('body'))
            meanwhile()
            self.graph.spin_for(0.1)

    def press(self, name):
        """Press a button; returns what the page says then."""
        self.page.evaluate(f'document.getElementById("answer").textContent = "", '
                           f'document.getElementById("{name}").click()')
        self.wait(lambda: self.text('#answer') not in ('', '…'), name)
        return self.text('#answer')

    def parameter(self, name):
        """Return value and sigma of a parameter as they are shown; None where they are not."""
        for row in self.text('#parameters').splitlines():
            cells = row.replace('±', ' ').split()
            if cells[:1] == [name] and len(cells) == 3:
                return float(cells[1]), float(cells[2])
        return None


@pytest.fixture
def stage(graph, browser):
    return Stage(graph(*OPTIONS), browser)


def test_the_page_shows_images_and_numbers_as_they_come_and_its_buttons_work(stage, tmp_path):
    graph = stage.graph
    graph.wait_for(lambda: stage.tracks.get_subscription_count() == 2, what='calibrator and page')
    assert has(stage.node) == {end for end in written('calibration_page')
                               if '/overlay' not in end[1]}
    assert not stage.images_wanted(), 'nobody looks'
    page = stage.page = stage.browser.open(stage.node.server.url, 1280)
    # the image, with its tracks in colour
    stage.wait(stage.images_wanted, 'subscription')
    frames = iter(range(10 ** 6))
    stage.wait(lambda: page.evaluate(f'{IMAGE}.naturalWidth') == 320, 'image',
               meanwhile=lambda: stage.camera.publish(image_stream.image(next(frames) % 100)))
    stage.wait(lambda: page.evaluate(COLOURED) > 0.005, 'tracks',
               meanwhile=lambda: stage.camera.publish(image_stream.image(next(frames) % 100)))
    # no calibration yet
    assert 'no calibration yet' in stage.press('save')
    # numbers
    stage.send(range(12))
    stage.wait(lambda: stage.parameter('fx'), 'first calibration')
    first, first_sigma = stage.parameter('fx')
    stage.send(range(12, 20))
    stage.wait(lambda: stage.parameter('fx')[1] < first_sigma, 'sigma falls')
    value, sigma = stage.parameter('fx')
    assert abs(value - stage.sequence.camera.K[0, 0]) < 5 * sigma
    assert '20 views kept' in stage.text('.facts') and 'front' in stage.text('.facts')
    heights = page.evaluate('[...document.querySelector("#chart polyline.focal").points]'
                            '.map(p => p.y)')
    assert heights[-1] > heights[0], 'the chart falls, y being down'
    assert page.evaluate('Math.max(...[...document.querySelectorAll("#map rect")].map('
                         'r => +r.getAttribute("fill-opacity")))') > 0
    assert stage.text('#do') and stage.text('#why')
    # buttons
    said = stage.press('calibrate')
    assert 'views' in said or 'nothing new' in said or 'under way' in said
    path = tmp_path / 'ros_home' / 'camera_info' / 'front.yaml'
    assert stage.text('#kept') == f'Not saved yet. The button writes {path}.'
    assert str(path) in stage.press('save') and path.is_file()
    # an estimate that comes after it is newer than the file
    stage.wait(lambda: stage.text('#kept').startswith(f'Saved in {path} at '), 'saved',
               meanwhile=lambda: stage.press('save'))
    page.evaluate('document.getElementById("reset").click()')
    assert stage.text('#reset') == 'Forget everything?'
    assert stage.press('reset') == 'starting anew'
    stage.wait(lambda: stage.text('#state') == 'Not calibrated', 'reset')
    assert stage.parameter('fx') is None and stage.text('#share').startswith('0 %')
    assert stage.text('#kept').startswith(f'{path} holds the calibration that was saved at ')
    # markup in a message is text
    evil = '<b id="evil">x</b>'
    statuses = graph.probe.create_publisher(DiagnosticArray, '/diagnostics', 10)
    stage.wait(lambda: evil in stage.text('#text'), 'text',
               meanwhile=lambda: statuses.publish(DiagnosticArray(status=[DiagnosticStatus(
                   name='planar_calibrator: calibration', message=evil,
                   values=[KeyValue(key='resets', value='1')])])))
    assert page.evaluate('document.getElementById("evil")') is None
    # it fits a telephone, and does nothing that it must not
    for width, scheme in ((400, 'dark'), (320, 'light')):
        page.send('Emulation.setDeviceMetricsOverride', width=width, height=800,
                  deviceScaleFactor=1, mobile=True)
        page.media('screen', scheme)
        assert page.evaluate('document.documentElement.scrollWidth') <= width
    assert page.complaints == []
    origin = stage.node.server.url
    assert all(url.startswith((origin, 'blob:', 'data:', origin.replace('http', 'ws')))
               for url in page.requests)
    # whoever goes takes the load away
    page.send('Page.close')
    graph.wait_for(lambda: not stage.images_wanted(), what='end of the subscription')


@pytest.mark.long
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_the_command_serves_the_nodes_of_other_processes_until_it_is_stopped(graph, number):
    graph = graph()

    def saved(_, response):
        response.success, response.message = True, 'saved elsewhere'
        return response

    graph.probe.create_service(Trigger, 'front/planar_calibrator/save', saved)
    statuses = graph.probe.create_publisher(DiagnosticArray, '/diagnostics', 10)
    command = subprocess.Popen(
        [sys.executable, '-m', 'selfcal_ros.cli.main', 'watch', '--port', '0', '--namespace',
         'front'], stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        url = next(found[0] for line in command.stderr
                   if (found := re.search(r'http://127.0.0.1:\d+/', line)))
        token = re.search('name="token" content="(.+?)"', urlopen(url).read().decode())[1]
        graph.wait_for(lambda: statuses.get_subscription_count() > 0, what='page')
        graph.wait_for(lambda: statuses.publish(DiagnosticArray(status=[DiagnosticStatus(
            name='front/planar_calibrator: calibration',
            values=[KeyValue(key='keyframes'), KeyValue(key='calibration file')])]))
            or graph.probe.count_subscribers('/front/tracks') > 0, what='subscription')
        answers = []
        asking = threading.Thread(target=lambda: answers.append(urlopen(
            Request(f'{url}save', method='POST', headers={'X-Token': token})).read()))
        asking.start()
        graph.wait_for(lambda: answers, what='answer')
        asking.join()
        assert json.loads(answers[0]) == {'success': True, 'message': 'saved elsewhere'}
        if number == signal.SIGINT:
            # as a terminal does: to everybody at once
            os.killpg(command.pid, number)
        else:
            command.send_signal(number)
        assert command.wait(20) == -number
        assert 'Traceback' not in command.stderr.read()
        with pytest.raises(OSError):
            urlopen(url, timeout=5)
    finally:
        if command.poll() is None:
            os.killpg(command.pid, signal.SIGKILL)
            command.wait()
        command.stderr.close()


def test_without_ros_the_command_says_so(monkeypatch, capsys):
    monkeypatch.setattr(watch, 'find_spec', lambda name: None)
    assert main(['watch']) == 2
    assert "pip install '.[ros-wheels]' in the clone" in capsys.readouterr().err
    monkeypatch.undo()
    assert main(['watch', '--port', '70000']) == 2
    assert '--port must be from 0 to 65535' in capsys.readouterr().err


def test_the_first_calibrator_of_the_own_namespace_is_watched(graph):
    graph = graph('-p', 'port:=0', '-r', 'calibration_page:__ns:=/right')
    page = graph.add(CalibrationPage())
    for name in ('left/planar_calibrator', 'right/affine_calibrator', 'planar_calibrator'):
        page._consider(name)
    assert page._calibrator == 'right/affine_calibrator'
    topics = {one.topic_name for one in page.subscriptions}
    assert '/right/tracks' in topics and '/left/tracks' not in topics
    assert page._beside('feature_tracker/overlay', page._calibrator) == 'feature_tracker/overlay'
    # that of the root, too, where it is alone
    assert page._beside('tracks', 'planar_calibrator') == '/tracks'


@pytest.mark.parametrize('name, keys', [
    ('imu', ()), ('imu', ('keyframes',)),
    *((name, ('keyframes', 'calibration file')) for name in (
        'My Robot/Left IMU', 'Left IMU', '//', '', 'a//b', '7up/imu', 'x' * 300))])
def test_what_is_no_calibrator_is_not_watched(graph, name, keys):
    page = graph('-p', 'port:=0').add(CalibrationPage())

    def hear(name, keys):
        page._on_diagnostics(DiagnosticArray(status=[DiagnosticStatus(
            name=f'{name}: calibration', values=[KeyValue(key=key) for key in keys])]))

    hear(name, keys)
    assert page._calibrator == ''
    hear('planar_calibrator', ('frames', 'keyframes', 'calibration file'))
    assert page._calibrator == 'planar_calibrator'


def test_a_calibrator_that_cannot_be_is_refused(ended):
    for name in ('/My Robot/x', '/'):
        status, said = ended('calibration_page', '-p', 'port:=0', '-p', f"calibrator:='{name}'")
        assert status == 2 and said.count('\n') == 1, said
        assert said.startswith(f"The parameter calibrator cannot be '{name}': ")


def test_a_second_without_a_browser_costs_a_twentieth_of_a_core(graph, monkeypatch):
    page = graph('-p', 'port:=0', '-p', 'calibrator:=planar_calibrator').add(CalibrationPage())
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 480, (400, 2))
    types, now = rclpy_types(), [0.0]
    raw = [serialize_message(tracks_message(np.arange(400), xy + k, (640, 600), header_message(
        k, 'camera', types), types)) for k in range(30)]
    status = DiagnosticArray(status=[DiagnosticStatus(
        name='planar_calibrator: calibration', message='calibrated',
        values=[KeyValue(key=f'value {k}', value='1') for k in range(40)])])
    monkeypatch.setattr(page_node, 'time', SimpleNamespace(monotonic=lambda: now[0]))
    decoded = []
    take = page._state.take_tracks
    monkeypatch.setattr(page._state, 'take_tracks', lambda *args: decoded.append(take(*args)))
    seconds = 3
    began = time.thread_time()
    for second in range(seconds):
        for k, one in enumerate(raw):
            now[0] = 100 + second + k / 30
            page._on_tracks(one)
            if k % 6 == 0:
                page._look()
        page._on_diagnostics(status)
    spent = (time.thread_time() - began) / seconds
    # the executor takes another tenth of a millisecond or three a message
    assert spent < 0.03, spent
    assert 4 <= len(decoded) / seconds <= TRACKS_HZ
