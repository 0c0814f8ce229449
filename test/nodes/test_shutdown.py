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
"""A node that is told to stop ends at once, with status 0 and without a traceback."""

import os
import signal
import subprocess
import sys

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from sensor_msgs.msg import PointCloud2


@pytest.fixture
def start(tmp_path):
    """Start a node as a process of its own; it is gone after the test."""
    started = []

    def run(name, *arguments):
        process = subprocess.Popen(
            [sys.executable, '-m', f'selfcal_ros.nodes.{name}', '--ros-args', *arguments],
            stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
            cwd=tmp_path, env=dict(os.environ))
        started.append(process)
        return process

    yield run
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_until_it_spins(graph, name):
    """Wait for something that only a timer of the node does."""
    if name == 'feature_tracker':
        # it looks for images once somebody listens
        graph.listen(PointCloud2, 'tracks')
        graph.wait_for(lambda: graph.probe.count_subscribers('image') > 0, 30, name)
        return
    heard = (graph.listen(Clock, '/clock') if name == 'bag_player'
             else graph.listen(DiagnosticArray, '/diagnostics'))
    graph.wait_for(lambda: heard, 30, name)


@pytest.mark.long
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('name', ['feature_tracker', 'planar_calibrator', 'bag_player'])
def test_a_signal_ends_a_node_cleanly(graph, start, tmp_path, name, number):
    arguments = []
    if name == 'bag_player':
        write_image_bag(tmp_path / 'bag', [Frame(k, 10 ** 18 + k * 10 ** 9,
                                                 np.zeros((48, 64), np.uint8))
                                           for k in range(100)])
        arguments = ['-p', f'bag:={tmp_path / "bag"}', '-p', 'wait_for_subscribers_s:=0']
    process = start(name, *arguments)
    wait_until_it_spins(graph(), name)
    process.send_signal(number)
    _, errors = process.communicate(timeout=15)
    assert process.returncode == 0, errors
    assert 'Traceback' not in errors


@pytest.mark.long
def test_two_signals_in_a_row_end_a_node_cleanly(graph, start):
    process = start('planar_calibrator')
    wait_until_it_spins(graph(), 'planar_calibrator')
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=15)
    assert 'Traceback' not in errors
    assert process.returncode == 0, errors


#: Runs a node that sends itself a signal when a module is about to be imported, or a call made.
SIGNALLED = """
import importlib, os, signal, sys

class AtImport:
    def find_spec(self, name, path=None, target=None):
        if name == where:
            os.kill(os.getpid(), number)

node, where, number = sys.argv[1], sys.argv[2], int(sys.argv[3])
sys.meta_path.insert(0, AtImport())
if where == 'rclpy.init()':
    import rclpy
    init = rclpy.init
    def interrupted(**options):
        init(**options)
        os.kill(os.getpid(), number)
    rclpy.init = interrupted
sys.exit(importlib.import_module('selfcal_ros.nodes.' + node).main([]))
"""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('name, where', [
    ('feature_tracker', 'rclpy'), ('feature_tracker', 'cv2'), ('planar_calibrator', 'numpy'),
    ('affine_calibrator', 'scipy'), ('bag_player', 'sensor_msgs'),
    ('planar_calibrator', 'rclpy.init()')])
def test_a_signal_while_a_node_starts_ends_it_silently(tmp_path, name, where, number):
    process = subprocess.run([sys.executable, '-c', SIGNALLED, name, where, str(int(number))],
                             capture_output=True, text=True, timeout=30, cwd=tmp_path)
    assert (process.returncode, process.stderr, process.stdout) == (0, '', '')


@pytest.mark.skipif(not os.path.exists('/proc/self/status'), reason="needs Linux's /proc")
@pytest.mark.parametrize('name', ['feature_tracker', 'affine_calibrator', 'bag_player'])
def test_a_signal_at_once_ends_a_node_silently(start, name):
    process = start(name)

    def catches(number):
        with open(f'/proc/{process.pid}/status', encoding='ascii') as status:
            caught = next(line for line in status if line.startswith('SigCgt'))
        return int(caught.split()[1], 16) >> (number - 1) & 1

    # Python itself catches only SIGINT: from here on the node answers for itself
    while not catches(signal.SIGTERM):
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=15)
    assert (process.returncode, errors, output) == (0, '', '')


@pytest.mark.long
@pytest.mark.parametrize('name, arguments, words', [
    ('bag_player', [], 'needs a bag'),
    ('bag_player', ['-p', 'bag:=/nowhere'], '/nowhere'),
    ('feature_tracker', ['-p', 'max_features:=1'], 'max_features must be from 20 to 5000'),
    ('planar_calibrator', ['-p', 'camera_name:=a/b'], 'camera_name'),
    ('planar_calibrator', ['--params-file', '/nowhere.yaml'],
     'The parameter file /nowhere.yaml does not exist; name another.')])
def test_a_wrong_input_is_one_sentence_and_status_2(ended, name, arguments, words):
    status, errors = ended(name, *arguments)
    assert status == 2, errors
    assert words in errors and 'Traceback' not in errors
    # rcl has nothing to add
    assert errors.count('\n') == 1


def test_a_domain_that_cannot_be_is_one_sentence_and_status_2(ended, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '233')
    assert ended('feature_tracker') == (2, 'ROS_DOMAIN_ID must be from 0 to 232, not 233.\n')


@pytest.mark.parametrize('name', ['feature_tracker', 'planar_calibrator', 'affine_calibrator',
                                  'rorapid_tracker', 'bag_player', 'camera_info_publisher',
                                  'calibration_page', 'composition'])
def test_without_ros_a_node_says_so_in_one_sentence(tmp_path, name):
    # a Python in which nobody finds rclpy
    (tmp_path / 'sitecustomize.py').write_text(
        'import sys\n'
        'class Hidden:\n'
        '    def find_spec(self, name, path=None, target=None):\n'
        "        if name.partition('.')[0] == 'rclpy':\n"
        '            raise ModuleNotFoundError(name)\n'
        'import importlib.util as util\n'
        'plain = util.find_spec\n'
        "util.find_spec = lambda name, *rest: (None if name == 'rclpy' else plain(name, *rest))\n"
        'sys.meta_path.insert(0, Hidden())\n')
    found = subprocess.run(
        [sys.executable, '-m', f'selfcal_ros.nodes.{name}'], capture_output=True, text=True,
        timeout=60, check=False, env={**os.environ, 'PYTHONPATH': os.pathsep.join(
            [str(tmp_path), os.environ['PYTHONPATH']])})
    assert found.returncode == 2, found.stderr
    assert found.stderr == (
        f'{name} is a ROS node, and there is no ROS in this Python: source ROS 2, or pip install '
        "'.[ros-wheels]' in the clone.\n")
