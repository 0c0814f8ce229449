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
"""The package installs with pip into an environment without ROS, and with colcon."""

from importlib.util import find_spec
import json
import os
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: What may lie beside the sources but is no part of them.
NOT_SOURCES = shutil.ignore_patterns('.git', '.venv*', 'build', 'install', 'log', 'out',
                                     '*.egg-info', '__pycache__', '.pytest_cache', '.hypothesis')
#: What ros2 launch and viewers look for, by folder of share/selfcal_ros.
SHARED = {folder: {path.name for path in (ROOT / folder).iterdir() if path.is_file()}
          for folder in ('launch', 'config')}
EXECUTABLES = sorted(path.name for path in (ROOT / 'scripts').iterdir())

pytestmark = [pytest.mark.install,
              pytest.mark.skipif(os.environ.get('COLCON') == '1', reason='colcon is at work'),
              pytest.mark.skipif(sys.prefix == sys.base_prefix and not find_spec('ensurepip'),
                                 reason='this Python cannot make virtual environments; install '
                                        'python3-venv')]


@pytest.fixture
def sources(tmp_path):
    """Copy the sources: an installation leaves files behind."""
    return shutil.copytree(ROOT, tmp_path / 'ws' / 'src' / 'selfcal_ros', ignore=NOT_SOURCES)


@pytest.fixture
def clean():
    """Hide the environment of this test from what it starts."""
    # the ROS wheels restart Python with their libraries once; a new environment shall, too
    hidden = ('PYTHONPATH', 'VIRTUAL_ENV', 'PYTHONHOME')
    return {name: value for name, value in os.environ.items() if name not in hidden}


def run(*command, env, cwd, timeout_s=300, status=0):
    """Run a command, and show all that it said if it does not end as it should."""
    done = subprocess.run([str(word) for word in command], env=env, cwd=cwd, timeout=timeout_s,
                          capture_output=True, text=True)
    assert done.returncode == status, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout + done.stderr


def environment(folder, env):
    """Make a virtual environment; returns its bin folder."""
    base = Path(sys.base_prefix) / 'bin' / f'python3.{sys.version_info.minor}'
    run(base if base.exists() else sys.executable, '-m', 'venv', folder, env=env, cwd='/')
    return folder / 'bin'


def pip_install(binaries, *what, env, cwd):
    run(binaries / 'python', '-m', 'pip', 'install', '--quiet', '--no-compile',
        '--disable-pip-version-check', *what, env=env, cwd=cwd)


def test_pip_without_ros_gives_a_selfcal_that_works_on_bags(tmp_path, sources, clean):
    binaries = environment(tmp_path / 'venv', clean)
    pip_install(binaries, '.', env=clean, cwd=sources)
    run(binaries / 'python', '-c', 'import rclpy', env=clean, cwd=tmp_path, status=1)
    said = run(binaries / 'selfcal', 'demo', env=clean, cwd=tmp_path)
    assert 'no ROS' in said and 'truth' in said
    # the recording was installed: the demo did not find it in the repository
    assert (tmp_path / 'venv' / 'share' / 'selfcal_ros' / 'bags' / 'agv_drive').is_dir()
    assert (tmp_path / 'venv' / 'share' / 'selfcal_ros' / 'bags' / 'arm_move').is_dir()
    for name in ('tracked_object/metadata.yaml', 'tracked_object.model.yaml',
                 'tracked_object.camera.yaml', 'tracked_object.pos'):
        assert (tmp_path / 'venv' / 'share' / 'selfcal_ros' / 'bags' / name).is_file()
    content = json.loads((tmp_path / 'selfcal_demo' / 'result.json').read_text(encoding='utf-8'))
    assert abs(content['camera']['fx'] - 520) < 0.002 * 520
    # what ros2 run, launch and ament look for
    prefix = tmp_path / 'venv'
    assert (prefix / 'share/ament_index/resource_index/packages/selfcal_ros').is_file()
    assert (prefix / 'share/selfcal_ros/package.xml').is_file()
    assert (prefix / 'share/selfcal_ros/result.schema.json').is_file()
    assert (prefix / 'share/man/man1/selfcal.1').is_file()
    for name in ('agv', 'arm', 'track'):
        assert (prefix / f'share/selfcal_ros/launch/{name}.launch.py').is_file()
    for folder, names in SHARED.items():
        assert names <= {path.name for path in (prefix / 'share/selfcal_ros' / folder).iterdir()}
    shims = prefix / 'lib' / 'selfcal_ros'
    assert sorted(path.name for path in shims.iterdir()) == EXECUTABLES
    assert 'selfcal_ros' in run(shims / 'selfcal', '--version', env=clean, cwd=tmp_path)


def test_colcon_gives_executables_that_ros2_run_finds(tmp_path, sources, clean):
    binaries = environment(tmp_path / 'colcon', clean)
    # colcon's own pin; newer setuptools have dropped what it calls
    pip_install(binaries, 'colcon-core', 'colcon-ros', 'setuptools<80', env=clean, cwd=tmp_path)
    # the libraries that the package needs come from the environment of this test
    site = subprocess.run([binaries / 'python', '-c', 'import sysconfig; '
                           'print(sysconfig.get_path("purelib"))'], capture_output=True, text=True,
                          env=clean).stdout.strip()
    Path(site, 'test_environment.pth').write_text(sysconfig.get_path('purelib') + '\n',
                                                  encoding='utf-8')
    workspace = tmp_path / 'ws'
    run(binaries / 'colcon', 'build', '--event-handlers', 'console_direct+', env=clean,
        cwd=workspace)
    prefix = workspace / 'install' / 'selfcal_ros'
    folder = prefix / 'lib' / 'selfcal_ros'
    assert sorted(path.name for path in folder.iterdir()) == EXECUTABLES
    assert (prefix / 'share/ament_index/resource_index/packages/selfcal_ros').is_file()
    for shared, names in SHARED.items():
        there = {path.name for path in (prefix / 'share/selfcal_ros' / shared).iterdir()}
        assert names <= there
    assert (prefix / 'share/selfcal_ros/bags/agv_drive/metadata.yaml').is_file()
    assert (prefix / 'share/man/man1/selfcal.1').is_file()
    started = f'. {workspace}/install/setup.sh && exec "$0" "$@"'
    said = run('sh', '-c', started, folder / 'selfcal', '--version', env=clean, cwd=tmp_path)
    assert said.startswith('selfcal_ros ')
    if find_spec('rclpy'):
        said = run('sh', '-c', started, folder / 'bag_player', env=clean, cwd=tmp_path, status=2)
        assert 'needs a bag' in said
