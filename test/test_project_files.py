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
"""The files that other people's tools read agree with the package."""

import json
from pathlib import Path
import re

import selfcal_ros
import yaml

ROOT = Path(__file__).resolve().parents[1]


def _yaml(name):
    return yaml.safe_load((ROOT / name).read_text(encoding='utf-8'))


def _texts():
    """List the text files of the project."""
    parts = ('.ci', '.github', 'bench', 'config', 'docs', 'examples', 'launch', 'msg_adapters',
             'resource', 'scripts', 'selfcal_ros', 'test', 'test_support')
    inside = [path for part in parts for path in (ROOT / part).rglob('*') if path.is_file()]
    # what recorders write into bags/ is theirs
    return [path for path in [*inside, *ROOT.glob('*'), *ROOT.glob('bags/*')]
            if path.is_file() and '__pycache__' not in path.parts and path.suffix in {
                '', '.cff', '.cfg', '.cpp', '.css', '.j2', '.js', '.json', '.md', '.py', '.rst',
                '.rviz', '.svg', '.toml', '.xml', '.yaml', '.yml'} and path.name != '.git']


def test_the_citation_is_of_this_version():
    citation = _yaml('CITATION.cff')
    assert citation['version'] == selfcal_ros.__version__
    assert citation['license'] == 'Apache-2.0'


def test_containers_copy_what_is_there_and_leave_the_rest():
    text = (ROOT / 'Dockerfile').read_text(encoding='utf-8')
    # a line of one command goes on after a backslash, and comments within it are left out
    lines = re.sub(r'\\\n(\s*#.*\n)*', ' ', text).splitlines()
    words = [line.split() for line in lines if line and not line.startswith('#')]
    assert {line[0] for line in words} <= {'ARG', 'FROM', 'WORKDIR', 'COPY', 'RUN', 'ENV',
                                           'ENTRYPOINT', 'CMD'}
    assert ['FROM', 'ros:${ROS_DISTRO}-ros-base'] in words
    copied = {source for line in words if line[0] == 'COPY' for source in line[1:-1]}
    assert all((ROOT / source).exists() for source in copied)
    ignored = (ROOT / '.dockerignore').read_text(encoding='utf-8').split()
    assert not copied & set(ignored)
    for line in words:
        if line[0] in ('ENTRYPOINT', 'CMD'):
            assert all(isinstance(word, str) for word in json.loads(' '.join(line[1:])))
    # the container to develop in is made of the same file
    folder = ROOT / '.devcontainer'
    about = json.loads((folder / 'devcontainer.json').read_text(encoding='utf-8'))
    assert (folder / about['build']['dockerfile']).resolve() == ROOT / 'Dockerfile'
    assert (folder / about['build']['context']).resolve() == ROOT
    assert about['workspaceFolder'] == '/ws/src/selfcal_ros'


def test_the_workflow_runs_make_test_on_every_python_that_setup_py_takes():
    jobs = _yaml('.github/workflows/test.yml')['jobs']
    matrix = jobs['wheels']['strategy']['matrix']['include']
    least = re.search(r"python_requires='>=([\d.]+)'",
                      (ROOT / 'setup.py').read_text(encoding='utf-8'))[1]
    assert min((one['python'] for one in matrix), key=lambda v: int(v.split('.')[1])) == least
    assert {'oldest', 'numpy==1.26.*', 'numpy==2.*'} == {one['versions'] for one in matrix}
    # there is no NumPy 1.26 for Python 3.13
    assert {'python': '3.13', 'versions': 'numpy==1.26.*'} not in matrix
    run = [line for step in jobs['wheels']['steps'] for line in step.get('run', '').splitlines()]
    assert {'make lint PYTHON=python', 'make test PYTHON=python'} <= set(run)
    # `make test` leaves both out: style and types, and what takes long
    assert 'make lint' in (ROOT / '.ci/run').read_text(encoding='utf-8').splitlines()
    workspace = [step['run'] for step in jobs['ros']['steps']
                 if 'pytest -n' in step.get('run', '')]
    assert len(workspace) == 1 and 'long' not in workspace[0]


def test_the_oldest_libraries_are_of_the_series_that_setup_py_takes():
    pinned = dict(line.strip().split('==') for line in (ROOT / 'test/oldest.txt').read_text(
        encoding='utf-8').splitlines() if not line.startswith('#'))
    taken = dict(re.findall(r"'([\w-]+)>=([\d.]+)',", (ROOT / 'setup.py').read_text(
        encoding='utf-8').split('install_requires')[1].split('extras_require')[0]))
    # rosbags is in no Ubuntu
    assert set(pinned) == set(taken) - {'rosbags'}
    for name, version in pinned.items():
        assert version.split('.')[0] == taken[name].split('.')[0]
        assert [int(one) for one in version.split('.')] >= [
            int(one) for one in taken[name].split('.')], name


def test_the_hooks_of_git_run_the_linters_of_make_lint():
    hooks = {hook['id'] for repository in _yaml('.pre-commit-config.yaml')['repos']
             for hook in repository['hooks']}
    recipe = (ROOT / 'Makefile').read_text(encoding='utf-8').split('\nlint:')[1].split('\n\n')[0]
    linters = set(re.findall(r'python -m (\w+)', recipe))
    assert linters and linters <= hooks
    assert {'trailing-whitespace', 'end-of-file-fixer', 'check-yaml'} <= hooks


def test_lines_end_cleanly():
    assert len(_texts()) > 400
    for path in _texts():
        text = path.read_text(encoding='utf-8')
        assert not re.search(r'[ \t\r]$', text, re.M), path
        assert not text or text.endswith('\n'), path
