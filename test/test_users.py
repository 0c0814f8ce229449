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
"""Public functions and classes are there for somebody: the program, a bench, an example, users."""

import ast
from collections import Counter
from functools import cache
from pathlib import Path
import re

from test_support.syntax_trees import tree_of, trees_in

ROOT = Path(__file__).resolve().parents[1]
#: What counts as use. `bench` and `bags` make what the package is judged by.
USERS = ('selfcal_ros', 'msg_adapters', 'launch', 'bench', 'docs', 'examples', 'bags')
#: Used by tests alone, and why they stay.
ALLOWED = {
    # tornado calls them
    'nodes/page_server.py': {'set_default_headers', 'write_error', 'check_origin', 'on_close',
                             'on_message'},
    # the thesis: general tensor and cameras of a reduced one (B), F of planar motion (A.1)
    'geometry/trifocal.py': {'linear_tensor_estimate'},
    'geometry/tensor_cameras.py': {'planar_cameras', 'planar_camera_slopes',
                                   'cameras_in_pixels'},
    'geometry/planar_pairs.py': {'planar_fundamental'},
    # the thesis: from projective to metric structure, step by step (2.2, 5.2)
    'calibration/structure/upgrade.py': {'plane_at_infinity'},
    'calibration/structure/metric_structure.py': {'to_affine', 'to_metric'},
    # other programs read with them what this one writes
    'report/poses_csv.py': {'read_poses'},
    # how much of a table is settled, for whoever judges it
    'rorapid/visibility/visibility_table.py': {'share_decided'},
}
#: Folders of scenes with known truth, which are made to be tested against.
SCENES = 'selfcal_ros/synthetic'


@cache
def _trees():
    found = {ROOT / 'setup.py': tree_of(ROOT / 'setup.py'),
             **trees_in(*(ROOT / folder for folder in USERS))}
    return {path.relative_to(ROOT).as_posix(): tree for path, tree in found.items()}


def _public(tree):
    """Yield public functions and classes, and public methods of public classes."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith('_'):
            yield node, ''
            for part in node.body if isinstance(node, ast.ClassDef) else ():
                if isinstance(part, ast.FunctionDef) and not part.name.startswith('_'):
                    yield part, node.name


@cache
def _uses(file):
    """Return the names that a file imports from others, those after a dot, and those it says."""
    imported, members = set(), set()
    for node in ast.walk(_trees()[file]):
        if isinstance(node, ast.ImportFrom):
            imported |= {one.name for one in node.names}
        elif isinstance(node, ast.Attribute):
            members.add(node.attr)
        elif isinstance(node, ast.keyword):
            members.add(node.arg)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            # entry points, and what is looked up by its name
            members |= set(re.findall(r'^[A-Za-z_]\w*$|(?<=[:.])[A-Za-z_]\w*$', node.value))
    return imported, members


@cache
def _named(file):
    """Count how often a file names what."""
    return Counter(part.id for part in ast.walk(_trees()[file]) if isinstance(part, ast.Name))


def _inside(file, node):
    """Tell whether a file names what it defines outside of the definition."""
    return _named(file)[node.name] > sum(
        isinstance(part, ast.Name) and part.id == node.name for part in ast.walk(node))


@cache
def _for_tests_alone():
    """Return what no program uses: its file and its name."""
    stated = set(re.findall(r'^#+ .*?\b(\w+)$', (ROOT / 'docs' / 'api.md').read_text('utf-8'),
                            re.M))
    members = set().union(*(_uses(file)[1] for file in _trees()))
    files_with = Counter(name for file in _trees() for name in _uses(file)[0])
    found = set()
    for file, tree in _trees().items():
        if not file.startswith(('selfcal_ros/', 'msg_adapters/')) or file.startswith(SCENES):
            continue
        imports = _uses(file)[0]
        for node, home in _public(tree):
            used = node.name in members or (not home and (
                files_with[node.name] > (node.name in imports) or _inside(file, node)))
            if not used and node.name not in stated:
                found.add((file.removeprefix('selfcal_ros/'), node.name))
    return found


def test_what_is_public_is_used_by_more_than_tests():
    allowed = {(file, name) for file, names in ALLOWED.items() for name in names}
    assert not _for_tests_alone() - allowed, 'use it, delete it, or move it to test_support'


def test_what_is_allowed_is_there_and_still_without_a_user():
    allowed = {(file, name) for file, names in ALLOWED.items() for name in names}
    assert not allowed - _for_tests_alone()
