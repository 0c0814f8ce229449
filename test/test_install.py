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

import email
from importlib.metadata import distributions
from importlib.util import find_spec
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
import pytest
from test_support.ros_domain import reserved_domain

ROOT = Path(__file__).resolve().parents[1]
#: What may lie beside the sources but is no part of them.
NOT_SOURCES = shutil.ignore_patterns('.git', '.venv*', 'build', 'install', 'log', 'out',
                                     '*.egg-info', '__pycache__', '.pytest_cache', '.hypothesis',
                                     '.mypy_cache')
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
def workspace(tmp_path):
    """Make the workspace that the Dockerfile makes."""
    text = (ROOT / 'Dockerfile').read_text(encoding='utf-8')
    for line in re.findall(r'^COPY (.+)$', text, re.M):
        *given, target = line.split()
        for one in given:
            # several files go into a folder, whose name ends so
            place = tmp_path / 'ws' / target / ('' if not target.endswith('/') else Path(one).name)
            place.parent.mkdir(parents=True, exist_ok=True)
            if (ROOT / one).is_dir():
                shutil.copytree(ROOT / one, place, ignore=NOT_SOURCES)
            else:
                shutil.copy(ROOT / one, place)
    return tmp_path / 'ws'


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
    # our own pip installs into it: one of its own costs seconds
    run(base if base.exists() else sys.executable, '-m', 'venv', '--without-pip', folder, env=env,
        cwd='/')
    return folder / 'bin'


def pip_install(binaries, *what, env, cwd):
    run(sys.executable, '-m', 'pip', '--python', binaries / 'python', 'install', '--quiet',
        '--no-compile', '--disable-pip-version-check', *what, env=env, cwd=cwd)


def lend(binaries, needs):
    """
    Link what is asked for, and what that asks for, into an environment, as if pip had done so.

    The files are those of this test's environment: to unpack them again costs half a minute. What
    it lacks, or has in another version than asked for, is left to pip. Nothing else is lent, so
    that an import of what is not asked for fails.
    """
    here = {}
    for one in distributions(path=[sysconfig.get_path('purelib'), sysconfig.get_path('platlib')]):
        here.setdefault(canonicalize_name(one.name), one)
    site, = (binaries.parent / 'lib').glob('python3*/site-packages')
    todo, lent = [Requirement(need) for need in needs], set()
    while todo:
        need = todo.pop()
        name = canonicalize_name(need.name)
        found = here.get(name)
        if (need.marker and not need.marker.evaluate({'extra': ''})) or name in lent \
                or not found or found.version not in need.specifier or not found.files:
            continue
        lent.add(name)
        todo += [Requirement(one) for one in found.requires or ()]
        for file in found.files:
            if '..' not in file.parts and found.locate_file(file).is_file():
                (site / file).parent.mkdir(parents=True, exist_ok=True)
                (site / file).symlink_to(found.locate_file(file))
    return lent


def source_distribution(sources, env):
    """Build the archive of the sources, look at it; returns its path and what it needs."""
    run(sys.executable, '-c', 'from setuptools import build_meta; build_meta.build_sdist("dist")',
        env=env, cwd=sources)
    path, = (sources / 'dist').glob('*.tar.gz')
    with tarfile.open(path) as archive:
        names = {name.partition('/')[2] for name in archive.getnames()}
        about = email.message_from_binary_file(archive.extractfile(
            f'{path.name.removesuffix(".tar.gz")}/PKG-INFO'))
        place, = (name for name in archive.getnames() if name.endswith('/requires.txt'))
        # without what extras need, which comes after
        needs = archive.extractfile(place).read().decode().partition('[')[0].split()
    # what the wheel is made from, and what ROS wants of it
    tracked = {str(file.relative_to(sources)) for folder in (
        'selfcal_ros', 'msg_adapters', 'launch', 'config', 'scripts', 'resource')
        for file in (sources / folder).rglob('*') if file.is_file()}
    assert {*tracked, 'package.xml', 'pyproject.toml', 'setup.cfg', 'README.md'} <= names
    # what a package index looks at
    assert about['Name'].replace('-', '_') == 'selfcal_ros' and about['Version']
    assert about['Description-Content-Type'] == 'text/markdown'
    assert about['Summary'] and about.get_payload().startswith('# selfcal_ros')
    return path, needs


def test_pip_without_ros_gives_a_selfcal_that_works_on_bags(tmp_path, sources, clean):
    binaries = environment(tmp_path / 'venv', clean)
    archive, needs = source_distribution(sources, clean)
    lend(binaries, needs)
    # by way of the archive, so that the wheel is built from what the archive has
    pip_install(binaries, archive, env=clean, cwd=tmp_path)
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


def test_colcon_gives_executables_that_ros2_run_finds(tmp_path, workspace, clean):
    binaries = environment(tmp_path / 'colcon', clean)
    # colcon's own pin; newer setuptools have dropped what it calls
    pip_install(binaries, 'colcon-core', 'colcon-bash', 'colcon-ros', 'setuptools<80', env=clean,
                cwd=tmp_path)
    # the libraries that the package needs come from the environment of this test
    site = subprocess.run([binaries / 'python', '-c', 'import sysconfig; '
                           'print(sysconfig.get_path("purelib"))'], capture_output=True, text=True,
                          env=clean).stdout.strip()
    Path(site, 'test_environment.pth').write_text(sysconfig.get_path('purelib') + '\n',
                                                  encoding='utf-8')
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
        newcomers_path(workspace, tmp_path, clean)


#: A driver whose CameraInfo is empty.
DRIVER = """
import rclpy
from sensor_msgs.msg import CameraInfo
rclpy.init()
node = rclpy.create_node('driver')
infos = node.create_publisher(CameraInfo, '/camera/camera_info', 10)
node.create_timer(0.1, lambda: infos.publish(CameraInfo(width=640, height=480)))
rclpy.spin(node)
"""
#: Lines of the page that want a whole installation of ROS, or are done already.
ELSEWHERE = ('rosdep install', 'colcon build', 'ros2 launch', 'ros2 service call /planar')


def newcomers_path(workspace, home, env):
    """Run the commands of a page of the documents as they stand there."""
    page = ROOT / 'docs' / 'how-to' / 'from-colcon-to-driver.md'
    lines = re.findall(r'^ {4}(\S.*)$', page.read_text(encoding='utf-8'), re.M)
    todo = [line for line in lines if not line.startswith(ELSEWHERE)]
    assert len(todo) == 6 and todo[0] == 'source install/setup.bash' == todo[4]
    build, folder, calibrate, serve, _, look = todo
    tools = home / 'tools'
    tools.mkdir()
    (tools / 'ros2').write_text(
        f'#!/bin/sh\nexec {sys.executable} {ROOT}/test_support/ros2_stand_in.py "$@"\n',
        encoding='utf-8')
    (tools / 'ros2').chmod(0o755)
    profile = str(ROOT / 'config' / 'fastdds.xml')
    started = []
    with reserved_domain() as domain:
        env = {**env, 'HOME': str(home), 'ROS_DOMAIN_ID': str(domain),
               'ROS_LOG_DIR': str(home / 'log'), 'PATH': f'{tools}{os.pathsep}{env["PATH"]}',
               'FASTRTPS_DEFAULT_PROFILES_FILE': profile,
               'FASTDDS_DEFAULT_PROFILES_FILE': profile}
        env.pop('ROS_HOME', None)
        try:
            said = run('bash', '-c', f'{build} && {folder} && {calibrate}', env=env, cwd=workspace)
            assert 'fx' in said and (home / '.ros' / 'camera_info' / 'front.yaml').is_file()
            for command in ([sys.executable, '-c', DRIVER],
                            ['bash', '-c', f'{build} && exec {serve}']):
                started.append(subprocess.Popen(command, env=env, cwd=workspace,
                                                stderr=subprocess.DEVNULL))
            said = run('bash', '-c', f'{build} && {look}', env=env, cwd=workspace)
            width, focal = re.search(r'width: (\d+) \nk: ([\d.]+)', said).groups()
            assert width == '640' and abs(float(focal) - 520) < 2
        finally:
            for process in started:
                process.terminate()
            for process in started:
                process.wait(20)
