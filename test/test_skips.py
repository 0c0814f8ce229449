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
"""A skip for a reason that nobody expects fails the run, and every skip is told."""

from importlib.util import find_spec
import os
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

HERE = Path(__file__).resolve().parent


@pytest.fixture(params=['one process', 'xdist'])
def run(request, tmp_path):
    """Run tests with the conftest of this folder, and without what ROS adds to pytest."""
    if request.param == 'xdist' and not find_spec('xdist'):
        pytest.fail('pytest-xdist is one of the tools of the extra test')
    shutil.copy(HERE / 'conftest.py', tmp_path)

    def started(text, *arguments):
        (tmp_path / 'test_it.py').write_text('import pytest\n' + text, encoding='utf-8')
        parallel = ['-p', 'xdist', '-n', '1'] if request.param == 'xdist' else []
        done = subprocess.run(
            [sys.executable, '-m', 'pytest', '--import-mode=importlib', '-p', 'no:cacheprovider',
             *parallel, *arguments, str(tmp_path)], cwd=tmp_path, capture_output=True, text=True,
            timeout=120, env={**os.environ, 'PYTEST_DISABLE_PLUGIN_AUTOLOAD': '1'})
        return done.returncode, done.stdout

    return started


def test_an_expected_skip_is_told_and_passes(run):
    status, said = run('def test_a(): pytest.skip("rclpy is not installed")\n'
                       'def test_b(): pass\n')
    assert status == 0
    assert '   1 rclpy is not installed' in said
    assert 'UNEXPECTED' not in said


def test_a_skip_of_what_is_required_fails(run):
    status, said = run('def test_a(): pytest.skip("rclpy is not installed")\n', '--require', 'ros')
    assert status == 1
    assert 'UNEXPECTED SKIP: rclpy is not installed' in said


@pytest.mark.parametrize('text', [
    'def test_a(): pytest.skip("it was raining")\n',
    'pytest.skip("it was raining", allow_module_level=True)\n',
    '@pytest.mark.skip(reason="it was raining")\ndef test_a(): pass\n'])
def test_an_unexpected_skip_fails(run, text):
    status, said = run(text)
    assert status != 0
    assert 'UNEXPECTED SKIP: it was raining' in said


def test_a_failure_that_is_expected_is_no_skip(run):
    status, said = run('@pytest.mark.xfail\ndef test_a(): assert False\n')
    assert status == 0
    assert 'left out' not in said
