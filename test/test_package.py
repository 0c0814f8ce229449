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
"""What is installed agrees with what is said about it."""

import ast
import importlib
import os
from pathlib import Path
import pkgutil
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import msg_adapters
import pytest
import selfcal_ros
from test_support.syntax_trees import trees_in

ROOT = Path(__file__).resolve().parents[1]


def _package_xml():
    return ElementTree.parse(ROOT / 'package.xml').getroot()


def test_versions_agree():
    assert _package_xml().findtext('version') == selfcal_ros.__version__
    assert f'\n{selfcal_ros.__version__} (' in (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')


def test_package_names_agree():
    assert _package_xml().findtext('name') == 'selfcal_ros'
    assert _package_xml().find('license').text == 'Apache-2.0'
    assert (ROOT / 'resource' / 'selfcal_ros').exists()


def _modules():
    for package in (selfcal_ros, msg_adapters):
        yield package.__name__
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + '.'):
            yield module.name


@pytest.mark.parametrize('name', sorted(_modules()))
def test_every_module_imports_and_its_public_names_exist(name):
    if name.startswith('selfcal_ros.nodes.'):
        pytest.importorskip('rclpy')
    module = importlib.import_module(name)
    for public in getattr(module, '__all__', ()):
        assert hasattr(module, public), f'{name}.__all__ lists {public}'


def test_every_executable_has_a_shim_and_a_target():
    text = (ROOT / 'setup.py').read_text(encoding='utf-8')
    executables = dict(re.findall(r"^    '(\w+)': '([\w.]+:main)',$", text, re.M))
    assert set(executables) == {path.name for path in (ROOT / 'scripts').iterdir()}
    for name, target in executables.items():
        shim = ROOT / 'scripts' / name
        assert os.access(shim, os.X_OK), f'{shim} is not executable'
        assert f'bin/{name}"' in shim.read_text(encoding='utf-8')
        module = ROOT / (target.split(':')[0].replace('.', '/') + '.py')
        assert '\ndef main(' in module.read_text(encoding='utf-8'), f'{module} has no main'


def test_recordings_fit_into_the_repository():
    size = sum(path.stat().st_size for path in (ROOT / 'bags').rglob('*') if path.is_file())
    assert size < 8_000_000


def test_python_files_carry_the_licence_header():
    header = (ROOT / 'selfcal_ros' / '__init__.py').read_text(encoding='utf-8')[:587]
    assert header.startswith('# Copyright')
    assert header.rstrip().endswith('limitations under the License.')
    for folder in ('selfcal_ros', 'msg_adapters', 'test', 'launch', 'bench', 'docs', 'examples'):
        for path in (ROOT / folder).rglob('*.py'):
            assert path.read_text(encoding='utf-8').startswith(header.rstrip()), path


def test_importing_the_core_needs_no_ros_and_waits_for_nothing_slow():
    # statistics and optimisers of SciPy take longer to load than all the rest
    code = ('import sys; import selfcal_ros, selfcal_ros.cli.main, selfcal_ros.cli.calibrate, '
            'selfcal_ros.pipeline.calibrate_input, selfcal_ros.calibration.calibrate; '
            'sys.exit(len({"rclpy", "scipy.stats", "scipy.optimize", "matplotlib"} '
            '& set(sys.modules)))')
    assert subprocess.run([sys.executable, '-c', code], cwd=ROOT, timeout=60).returncode == 0


#: What would need a screen, or somebody at a keyboard.
ASKS = {'namedWindow', 'waitKey', 'waitKeyEx', 'selectROI', 'input', 'getpass', 'pyplot'}


@pytest.mark.parametrize('folder', ['selfcal_ros', 'msg_adapters', 'launch'])
def test_nothing_opens_a_window_or_asks_at_the_keyboard(folder):
    found = []
    for path, tree in trees_in(ROOT / folder).items():
        for node in ast.walk(tree):
            called = getattr(node, 'func', None)
            names = {getattr(called, 'attr', None), getattr(called, 'id', None)}
            if isinstance(node, ast.ImportFrom | ast.Import):
                names = {alias.name.rpartition('.')[2] for alias in node.names}
            elif isinstance(node, ast.Attribute) and node.attr in ('stdin', 'imshow'):
                names = {ast.unparse(node)} & {'sys.stdin', 'cv2.imshow'}
            found += [f'{path.name}: {name}' for name in names
                      if name in ASKS | {'sys.stdin', 'cv2.imshow'}]
    assert not found
