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
"""Every file keeps the style of .flake8 and the types that pyproject.toml asks for."""

from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.linter
def test_flake8_finds_nothing():
    pytest.importorskip('flake8')
    done = subprocess.run([sys.executable, '-m', 'flake8', '.'], cwd=ROOT, capture_output=True,
                          text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.linter
def test_mypy_finds_nothing():
    pytest.importorskip('mypy')
    # its annotations are older than what ours are checked against
    pytest.importorskip('numpy', minversion='2')
    # a cache that `make lint` has left spares nine tenths of the time
    done = subprocess.run([sys.executable, '-m', 'mypy'], cwd=ROOT, capture_output=True,
                          text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize('package', ['selfcal_ros', 'msg_adapters'])
def test_packages_say_that_they_carry_types(package):
    assert (ROOT / package / 'py.typed').is_file()
    text = (ROOT / 'setup.py').read_text(encoding='utf-8')
    assert text.count("'py.typed'") == 2, 'not installed with the packages'
