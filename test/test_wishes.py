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
"""docs/wishes.md names a test for each wish of users, and these tests exist."""

import ast
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / 'docs' / 'wishes.md').read_text(encoding='utf-8')
NAMED = re.compile(r'`(test/[\w/]+\.py)::(\w+)`')


@pytest.mark.parametrize('path, name', sorted(set(NAMED.findall(TEXT))))
def test_every_named_test_exists(path, name):
    tree = ast.parse((ROOT / path).read_text(encoding='utf-8'))
    assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_every_wish_has_a_test():
    rows = [line for line in TEXT.splitlines() if re.match(r'\| \d+ \|', line)]
    assert [int(row.split('|')[1]) for row in rows] == list(range(1, 21))
    for row in rows:
        assert NAMED.search(row), row
        # nothing beside names of tests in the last column
        assert not NAMED.sub('', row.rstrip('| ').split('|')[-1]).strip(), row
