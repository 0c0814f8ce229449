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
"""Processes end with the one that started them, by whatever it ends."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest
from selfcal_ros.pipeline.child_process import end_processes, run_module

ROOT = Path(__file__).resolve().parents[2]
#: What a module does that tells its number, and waits.
WAIT = 'open(f"{os.getpid()}.pid", "x").close()\ntime.sleep(600)\n'

pytestmark = pytest.mark.skipif(not Path('/proc/self/stat').is_file(),
                                reason='there is no /proc here')


def alive(process):
    """Tell whether a process runs; the dead that nobody has buried do not."""
    try:
        return Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


@pytest.fixture
def family(tmp_path):
    """Start a command that runs a module which has started another; returns it and both."""
    Path(tmp_path / 'inner.py').write_text(f'import os, time\n{WAIT}')
    Path(tmp_path / 'outer.py').write_text(
        'import os, time\nfrom selfcal_ros.pipeline.child_process import start_module\n'
        f'start_module("inner")\n{WAIT}')
    code = ('import signal\nfrom selfcal_ros.cli.own_process import own_process\n'
            'from selfcal_ros.pipeline.child_process import run_module\n'
            # which whoever starts the tests may ignore
            'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
            'signal.signal(signal.SIGHUP, signal.SIG_DFL)\n'
            'with own_process():\n    run_module("outer")\n')
    command = subprocess.Popen([sys.executable, '-c', code], cwd=tmp_path, env={
        **os.environ, 'PYTHONPATH': f'{ROOT}{os.pathsep}{tmp_path}'})
    children = []
    try:
        deadline = time.monotonic() + 60
        while len(children) < 2:
            assert command.poll() is None and time.monotonic() < deadline
            time.sleep(0.02)
            children = [int(path.stem) for path in tmp_path.glob('*.pid')]
        yield command, children
    finally:
        command.kill()
        command.wait()
        for child in filter(alive, children):
            os.kill(child, signal.SIGKILL)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_the_whole_family_ends_with_the_command(family, number):
    command, children = family
    command.send_signal(number)
    assert command.wait(30) == -number
    deadline = time.monotonic() + 30
    while any(map(alive, children)):
        assert time.monotonic() < deadline, 'orphans'
        time.sleep(0.02)


def test_a_module_is_run_to_its_end_with_its_arguments(tmp_path, monkeypatch):
    (tmp_path / 'ending.py').write_text('import sys\nsys.exit(int(sys.argv[1]))\n')
    monkeypatch.chdir(tmp_path)
    assert run_module('ending', ['7']) == 7


def test_what_a_module_says_is_passed_on_until_it_is_broken_off(tmp_path):
    (tmp_path / 'noisy.py').write_text(
        'import os, signal, sys, time\n'
        'def complain(*_):\n    os.write(2, b"terminate called\\n")\n    os._exit(1)\n'
        'signal.signal(signal.SIGTERM, complain)\n'
        'print("images arrive", file=sys.stderr, flush=True)\ntime.sleep(600)\n')
    code = ('import signal\nfrom selfcal_ros.cli.own_process import own_process\n'
            'from selfcal_ros.pipeline.child_process import run_module\n'
            'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
            'with own_process(library_noise=True, unfinished="interrupted."):\n'
            '    run_module("noisy")\n')
    with subprocess.Popen([sys.executable, '-c', code], cwd=tmp_path, text=True,
                          stderr=subprocess.PIPE, env={
                              **os.environ, 'PYTHONPATH': f'{ROOT}{os.pathsep}{tmp_path}'},
                          ) as command:
        assert command.stderr.readline() == 'images arrive\n'
        command.send_signal(signal.SIGINT)
        assert command.stderr.read() == 'interrupted.\n'
    assert command.returncode == -signal.SIGINT


def test_whoever_does_not_end_is_killed():
    stubborn = subprocess.Popen(
        [sys.executable, '-c', 'import signal, time\nsignal.signal(signal.SIGTERM, '
         'signal.SIG_IGN)\nprint(flush=True)\ntime.sleep(600)'], stdout=subprocess.PIPE)
    stubborn.stdout.readline()
    end_processes([stubborn], 0.1)
    assert stubborn.returncode == -signal.SIGKILL
    stubborn.stdout.close()
