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
"""
Docstrings are in plain English, as the documents are: no sentence is longer than 25 words.

What stands in brackets, behind a colon or behind a semicolon counts by itself. Examples, tables
and lists of formulas are left out.
"""

import ast
from pathlib import Path
import re

import pytest
from test.docs.test_plain_english import LONGEST, sentences, words

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ('selfcal_ros', 'msg_adapters', 'bench')
PARTS = sorted({path.parent.relative_to(ROOT) for folder in FOLDERS
                for path in (ROOT / folder).rglob('*.py')})
# an empty line, the line under a heading, a parameter with its type, an item
_BREAK = re.compile(r'\n\s*\n|\n\s*-{3,}\n|\n(?=\S[^\n]* : )|\n(?=\* )')
#: Paragraphs with more signs of equality are formulas.
MOST_EQUATIONS = 2


def long_sentences(docstring):
    """List the sentences of a docstring that are too long."""
    found = []
    for paragraph in _BREAK.split(docstring):
        if (re.search(r'(^|\n)\s*(>>>|\.\. |\|)|^    .*   ', paragraph)
                or paragraph.count('=') > MOST_EQUATIONS):
            continue
        text = re.sub(r'\([^()]*\)', '', re.sub(r'\s+', ' ', paragraph).replace('``', '`'))
        found += [part for sentence in sentences(text) for part in re.split(r'[;:]\s', sentence)
                  if words(part) > LONGEST]
    return found


@pytest.mark.parametrize('part', PARTS, ids=str)
def test_no_sentence_of_a_docstring_is_long(part):
    long = []
    for path in sorted((ROOT / part).glob('*.py')):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
                long += [f'{path.name}:{getattr(node, "lineno", 1)}: {one}'
                         for one in long_sentences(ast.get_docstring(node) or '')]
    assert not long, '\n'.join(long)


def test_a_long_sentence_is_found_and_what_stands_in_brackets_is_not():
    long = ' '.join(['word'] * 26)
    assert long_sentences(f'A title.\n\n{long}.\n\nReturns\n-------\nint') == [f'{long}.']
    assert not long_sentences(f'A title (with {long}): and more.\n\nx : int\n    It.')
