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
"""Those who start nodes of their own: wrong inputs, signals, and which result is the last."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.nodes import node_processes
from selfcal_ros.nodes.calibration_status import NOTHING_NEW, UNDER_WAY
from selfcal_ros.nodes.node_processes import images_of
from selfcal_ros.nodes.replay_supervisor import ReplaySupervisor

BAGS = Path(__file__).resolve().parents[2] / 'bags'
TRACKED = [f'{BAGS}/tracked_object', '--model', f'{BAGS}/tracked_object.model.yaml', '--camera',
           f'{BAGS}/tracked_object.camera.yaml', '--start-pose', f'{BAGS}/tracked_object.pos']


def children_of(parent):
    """List the processes that a process has started, without those that only wait for burial."""
    found = []
    for path in Path('/proc').glob('[0-9]*/stat'):
        try:
            state, above = path.read_text().rpartition(')')[2].split()[:2]
            words = (path.parent / 'cmdline').read_bytes()
        except OSError:
            continue
        # from when it has become the node
        if int(above) == parent and state != 'Z' and b'--ros-args' in words \
                and b'child_process' not in words:
            found.append(int(path.parent.name))
    return found


def alive(process):
    """Tell whether a process runs."""
    try:
        return Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


@pytest.mark.long
@pytest.mark.ros
@pytest.mark.skipif(not Path('/proc/self/stat').is_file(), reason='there is no /proc here')
@pytest.mark.parametrize('module, words, count, number', [
    ('replay_supervisor', [f'{BAGS}/agv_drive'], 2, signal.SIGTERM),
    ('tracking_supervisor', TRACKED, 1, signal.SIGINT)])
def test_a_signal_ends_a_supervisor_and_its_nodes(tmp_path, module, words, count, number):
    command = subprocess.Popen(
        [sys.executable, '-c', 'import signal\n'
         # which whoever starts the tests may ignore
         'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
         f'from selfcal_ros.nodes.{module} import main\nmain()', *words, '--output', tmp_path],
        stderr=subprocess.PIPE, text=True, env=dict(os.environ))
    nodes = []
    try:
        deadline = time.monotonic() + 60
        while len(nodes) < count:
            assert command.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
            nodes = children_of(command.pid)
        command.send_signal(number)
        _, errors = command.communicate(timeout=30)
        assert command.returncode == -number and 'Traceback' not in errors
        assert not any(map(alive, nodes))
    finally:
        command.kill()
        command.wait()


def test_nothing_starts_with_a_bag_or_a_rate_that_cannot_be_played(tmp_path):
    (tmp_path / 'film.mp4').touch()
    for name, words in (('nope', 'nope cannot be read'), ('film.mp4', 'film.mp4 is no bag'),
                        ('.', 'is no bag')):
        with pytest.raises(InputError, match=words):
            images_of(tmp_path / name, 1.0)
    for rate in (0.0, -1.0, float('nan')):
        with pytest.raises(ArgumentError, match='from 0.01 to 100'):
            images_of(BAGS / 'agv_drive', rate)
    last_ns, playing_s = images_of(BAGS / 'agv_drive', 2.0)
    assert last_ns > 10 ** 18 and playing_s == pytest.approx(images_of(
        BAGS / 'agv_drive', 1.0)[1] / 2)


@pytest.fixture
def calibrator(monkeypatch):
    """Stand in for a supervisor; what a calibrator does next is a list of steps, each a call."""
    def wait_for(node, condition, timeout_s, what):
        while not condition():
            assert node.coming, f'no {what}'
            node.results.append(node.coming.pop(0))

    monkeypatch.setattr('selfcal_ros.nodes.replay_supervisor.wait_for', wait_for)

    def make(*answers):
        def call(_):
            success, message, now, later = answers.pop(0)
            made.results += now
            made.coming += later
            return SimpleNamespace(success=success, message=message)

        answers = list(answers)
        made = SimpleNamespace(camera_infos=[(1, 500.0)], results=[], coming=[], call=call,
                               _calibrate=None, _heard=0.0)
        made._calibrations = lambda: ReplaySupervisor._calibrations(made)
        return ReplaySupervisor.final_result(made, 1, 1.0)

    return make


OLD, LAST = {'status': 'calibrated', 'fx': 1}, {'status': 'calibrated', 'fx': 2}
FAILED = {'status': 'not_calibrated'}


def test_a_result_that_comes_while_the_last_is_asked_for_is_not_the_last(calibrator):
    started = 'estimating from 9 views; the result comes on ~/result'
    assert calibrator((True, started, [OLD], [LAST])) == LAST
    assert calibrator((False, UNDER_WAY[0], [], [OLD]), (True, started, [], [LAST])) == LAST
    assert calibrator((False, UNDER_WAY[1], [OLD], []), (True, started, [], [FAILED])) == FAILED
    assert calibrator((True, NOTHING_NEW, [OLD, FAILED, LAST], [])) == LAST
    assert calibrator((True, NOTHING_NEW, [FAILED], [LAST])) == LAST


def test_what_is_refused_for_want_of_views_is_the_result(calibrator):
    # in whatever words: 'under way' is none of ours to look for
    found = calibrator((False, '2 views under way so far, three are needed', [], []))
    assert found['status'] == 'not_calibrated' and 'three are needed' in found['reason']


def test_a_node_that_fails_is_named():
    processes = node_processes.NodeProcesses()
    ended = SimpleNamespace(poll=lambda: 2, returncode=2)
    processes._started.append(('feature_tracker', ended))
    with pytest.raises(node_processes.ReplayTimeout, match='feature_tracker ended with status 2'):
        processes.alive()
