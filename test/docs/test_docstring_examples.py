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
"""Examples in docstrings run, and every public name of the package has one."""

import doctest
from importlib import import_module
import inspect
from pathlib import Path
import pkgutil

import msg_adapters
import pytest
import selfcal_ros

ROOT = Path(__file__).resolve().parents[2]
PUBLIC = sorted(name for name in selfcal_ros.__all__ if not name.startswith('__'))
#: Public names that rest on published work, and say on which.
WITH_REFERENCES = ('Camera', 'CameraFacts', 'calibrate', 'calibrate_known_object')


def _run(tests):
    """Run tests; returns what went wrong."""
    said = []
    for test in tests:
        doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    return ''.join(said)


@pytest.mark.parametrize('name', PUBLIC)
def test_a_public_name_has_examples_that_run(name):
    value = getattr(selfcal_ros, name)
    tests = doctest.DocTestFinder(recurse=False).find(value, name, globs={})
    assert sum(len(test.examples) for test in tests) >= 2, f'{name} has no example'
    assert not _run(tests)


@pytest.mark.parametrize('name', WITH_REFERENCES)
def test_a_method_names_its_sources(name):
    assert 'References\n----------' in inspect.getdoc(getattr(selfcal_ros, name))


def _with_examples():
    """List the other modules in whose text an example stands."""
    for package in (selfcal_ros, msg_adapters):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + '.'):
            path = ROOT / (module.name.replace('.', '/') + '.py')
            if path.is_file() and '>>> ' in path.read_text(encoding='utf-8'):
                yield module.name


@pytest.mark.parametrize('name', sorted(_with_examples()))
def test_every_other_example_runs_too(name):
    public = {id(getattr(selfcal_ros, one)) for one in PUBLIC}
    module = import_module(name)
    tests = [test for test in doctest.DocTestFinder(exclude_empty=True).find(module)
             if test.examples and id(getattr(module, test.name.rsplit('.')[-1], None))
             not in public]
    assert not _run(tests)
