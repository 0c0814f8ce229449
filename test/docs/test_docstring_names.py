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
"""What docstrings set as code exists: modules, functions, classes, and members of them."""

import ast
import builtins
from functools import cache
from importlib.util import find_spec
from pathlib import Path
import re

import pytest
from test_support.syntax_trees import trees_in

ROOT = Path(__file__).resolve().parents[2]
#: Folders whose docstrings are read.
READ = ('selfcal_ros', 'msg_adapters', 'test_support', 'bench', 'docs', 'examples')
#: What others define, and what a user names.
FOREIGN = {
    # programs, services and packages
    'kinhec', 'launch', 'rbt', 'set_camera_info', 'stereo_image_proc', 'threadpoolctl',
    # formats: columns of a table, lines of an OBJ file, words of a CAO file
    'stamp_s', 'r11', 'r33', 'l', 'threshold', 'useLod',
    # an object, as a user may call it
    'cube_2',
    # any module, and the recorded worlds beside the project
    'MODULE', 'world_cases',
}
#: File names that look like members of modules.
FILES = re.compile(r'\.(?:csv|jsonl?|py|yaml|md|html|mcap|db3|cao)$')


@cache
def _trees():
    return trees_in(*(ROOT / folder for folder in READ))


def _names(tree):
    """Collect what a module defines, imports, names, or has as a word in a string."""
    docstrings = {id(node.body[0].value) for node in ast.walk(tree)
                  if isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Module))
                  and ast.get_docstring(node) is not None}
    names = set()
    for node in ast.walk(tree):
        names |= {getattr(node, key, None) for key in ('name', 'id', 'arg', 'attr', 'asname')}
        if isinstance(node, ast.alias):
            names |= set(node.name.split('.'))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) \
                and id(node) not in docstrings:
            names |= set(re.findall(r'[A-Za-z_]\w*', node.value))
    return names


@cache
def _modules():
    """Return the names in every module by its dotted name."""
    found = {}
    for path, tree in _trees().items():
        parts = path.relative_to(ROOT).with_suffix('').parts
        found['.'.join(parts).removesuffix('.__init__')] = _names(tree)
    for name in list(found):
        while '.' in name:
            name = name.rpartition('.')[0]
            found.setdefault(name, set())
    return found


@cache
def _known():
    return set().union(*_modules().values()).union(
        part for name in _modules() for part in name.split('.')) | FOREIGN


def _exists(name, arguments=()):
    """Tell whether a word or a dotted name means something."""
    parts = name.split('.')
    if len(parts) == 1:
        return name in _known()
    if FILES.search(name):
        return True
    if parts[0] not in arguments:
        for count in range(len(parts), 0, -1):
            start = '.'.join(parts[:count])
            homes = [names for module, names in _modules().items()
                     if module == start or module.endswith('.' + start)]
            if homes:
                return any((names | FOREIGN).issuperset(parts[count:]) for names in homes)
        if parts[0] in FOREIGN | set(dir(builtins)) or find_spec(parts[0]) is not None:
            return True
    # a member of a class, or of what the function takes
    near = parts[0][0].isupper() or parts[0] in arguments
    return near and _known().issuperset(parts)


def _named():
    """Yield the place of every name in a docstring, the name, and what the function takes."""
    for path, tree in _trees().items():
        for node in ast.walk(tree):
            if not isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Module)):
                continue
            codes = re.findall(r'(?<!`)`([^`\n]+)`(?!`)', ast.get_docstring(node) or '')
            if not codes:
                continue
            inner = [] if isinstance(node, ast.Module) else ast.walk(node)
            taken = {one.arg for one in inner if isinstance(one, ast.arg)} | {
                one.target.id for one in node.body
                if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)}
            for code in codes:
                found = re.match(r'[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*(?=\(|$)', code)
                if found:
                    place = f'{path.relative_to(ROOT)}: {getattr(node, "name", "its start")}'
                    yield place, found[0], taken


def test_every_name_in_a_docstring_exists():
    named = list(_named())
    assert len(named) > 800
    missing = [f'{place}: {name}' for place, name, taken in named if not _exists(name, taken)]
    assert not missing, '\n'.join(missing)


@pytest.mark.parametrize('name', [
    'pencil.conic_pencil', 'conic_pencil.no_such_function', 'object_bundle_of_old',
    'selfcal_ros.calibration.no_such_module', 'acquisition.points_from_nowhere'])
def test_what_is_gone_is_found(name):
    assert not _exists(name)


@pytest.mark.parametrize('name', [
    'conic_pencil.conic_pencil', 'selfcal_ros.calibrate', 'numpy.linalg.norm', 'poses.csv',
    'result.camera', 'view_graph'])
def test_what_there_is_is_known(name):
    assert _exists(name)
