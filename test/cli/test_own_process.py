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
"""The command as a process: closed and full streams, other alphabets, signals, no orphans."""

import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest
from selfcal_ros.cli import many
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.report.camera_yaml import write_camera_yaml
from test_support.command_line import selfcal

ROOT = Path(__file__).resolve().parents[2]
posix = pytest.mark.skipif(os.name != 'posix', reason='streams and signals are those of POSIX')


def run(*arguments, redirected='', **more):
    """Run Python from a shell that redirects its streams."""
    environment = {**os.environ, 'PYTHONPATH': str(ROOT), **more}
    return subprocess.run(['sh', '-c', f'"$@" {redirected}', 'sh', sys.executable, *arguments],
                          env=environment, capture_output=True, timeout=120, check=False)


@pytest.fixture
def camera_file():
    """Write a camera file whose name is no UTF-8; returns the name."""
    write_camera_yaml('camera.yaml', Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (), 640,
                                            480), 'camera')
    name = os.fsdecode(b'b\xe9.yaml')
    os.rename('camera.yaml', name)
    return name


@posix
def test_streams_that_are_closed_full_or_of_ascii(camera_file):
    command = ('-m', 'selfcal_ros.cli.main')
    done = run(*command, '--version', redirected='<&- >&- 2>&-')
    assert (done.returncode, done.stderr) == (0, b'')
    done = run(*command, 'compare', camera_file, camera_file, '--json', '-',
               PYTHONIOENCODING='ascii')
    assert done.returncode == 0 and json.loads(done.stdout)['a'] == camera_file
    if os.path.exists('/dev/full'):
        done = run(*command, '--version', redirected='> /dev/full')
        assert done.returncode == 2
        assert done.stderr.count(b'\n') == 1 and b'No space left' in done.stderr


@posix
def test_sigterm_removes_what_is_temporary_and_ends_the_process_as_it_does():
    code = ('import os, signal, tempfile, time\n'
            'from selfcal_ros.cli.own_process import own_process\n'
            'with own_process(), tempfile.TemporaryDirectory(dir="."):\n'
            '    os.kill(os.getpid(), signal.SIGTERM)\n'
            '    time.sleep(60)\n')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, timeout=120,
                          env={**os.environ, 'PYTHONPATH': str(ROOT)}, check=False)
    assert done.returncode == -signal.SIGTERM and done.stderr == b''
    assert not list(Path().iterdir())


@posix
@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT])
def test_a_signal_that_an_import_swallows_still_ends_the_process(number):
    # as NumPy does, which says instead that a module cannot be imported
    code = ('import os, signal, sys\n'
            'from selfcal_ros.cli import main\n'
            # which whoever starts the tests may ignore
            'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
            'def swallowing(name):\n'
            '    try:\n'
            f'        os.kill(os.getpid(), {int(number)})\n'
            '    except BaseException:\n'
            '        pass\n'
            '    raise ImportError("could not import module")\n'
            'sys.argv = ["selfcal", "compare", "a.yaml", "b.yaml"]\n'
            'main.import_module = swallowing\n'
            'sys.exit(main.main())\n')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, timeout=120,
                          env={**os.environ, 'PYTHONPATH': str(ROOT)}, check=False)
    assert done.returncode == -number
    assert b'Traceback' not in done.stderr and b'fault' not in done.stderr


@posix
@pytest.mark.parametrize('verb, said', [
    ('compare', b'selfcal compare: interrupted; each file that it wrote by then is whole.\n'),
    ('watch', b'\n')])
def test_an_interrupt_is_one_sentence_and_ends_the_process_as_shells_expect(verb, said):
    code = ('import os, signal, sys\n'
            'from selfcal_ros.cli import main\n'
            'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
            f'sys.argv = ["selfcal", {verb!r}]\n'
            'main._run = lambda argv: os.kill(os.getpid(), signal.SIGINT)\n'
            'sys.exit(main.main())\n')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, timeout=120,
                          env={**os.environ, 'PYTHONPATH': str(ROOT)}, check=False)
    # a shell tells of 130
    assert (done.returncode, done.stderr) == (-signal.SIGINT, said)


def alive(process: int) -> bool:
    """Tell whether a process runs; the dead that nobody has buried do not."""
    try:
        state = Path(f'/proc/{process}/stat').read_text(encoding='utf-8').rpartition(')')[2]
    except OSError:
        return False
    return state.split()[0] != 'Z'


@pytest.mark.skipif(not Path('/proc/self/stat').is_file(), reason='there is no /proc here')
def test_workers_end_with_a_parent_that_is_killed():
    Path('waiting.py').write_text(
        'import os, time\ndef wait(name):\n    with open(name, "x") as stream:\n'
        '        stream.write(f"{os.getpid()}\\n")\n    time.sleep(600)\n', encoding='utf-8')
    code = ('import waiting\nfrom selfcal_ros.pipeline.engines import run_jobs\n'
            'list(run_jobs(waiting.wait, ["one", "two"], workers=2))')
    parent = subprocess.Popen([sys.executable, '-c', code], env={
        **os.environ, 'PYTHONPATH': f'{ROOT}{os.pathsep}.'})
    try:
        names, deadline = [Path('one'), Path('two')], time.monotonic() + 100
        while not all(name.is_file() and name.read_text(encoding='utf-8').endswith('\n')
                      for name in names):
            assert parent.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        parent.kill()
        parent.wait()
    workers = [int(name.read_text(encoding='utf-8')) for name in names]
    while any(map(alive, workers)):
        assert time.monotonic() < deadline, 'orphans'
        time.sleep(0.05)


def test_a_wrong_camera_name_is_known_before_the_work(capsys):
    Path('tracks.csv').write_text('nonsense', encoding='utf-8')
    for name in ('ä', 'a b', 'a\n', ''):
        assert selfcal('calibrate', 'tracks.csv', '--camera-name', name) == 2
        heard = capsys.readouterr().err
        assert 'camera name' in heard and heard.count('\n') == 1


def test_no_recording_becomes_a_hidden_file_or_one_with_too_long_a_name():
    assert many._plain_name('日本 /image') == '日本_image'
    assert many._plain_name('...') == 'recording'
    assert len((many._plain_name('長' * 300) + '_10.yaml').encode()) < 255
