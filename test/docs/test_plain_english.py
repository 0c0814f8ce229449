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
The documents are written in plain English: no sentence is longer than 25 words.

Headings, tables, code and what lies between `<!-- x:y -->` marks are left out. A sentence ends
with a full stop, a question mark or an exclamation mark, or with its paragraph or list item.
"""

from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 25
#: Characters of a line of prose.
WIDEST = 110
PAGES = sorted(path for path in [
    *ROOT.glob('*.md'), *(ROOT / 'docs').rglob('*.md'), *(ROOT / 'bench').rglob('*.md'),
    *(ROOT / 'examples').glob('*.md'), *(ROOT / 'bags').glob('*.md')]
    if path.name not in ('api.md', 'references.md'))
# not the end of a sentence
_ABBREVIATION = re.compile(r'\b(e\.g|i\.e|et al|[A-Z]|No|Fig|eq|vs)\.(?=\s)')


def prose(text):
    """List the paragraphs and list items of a page: (line number, text)."""
    text = re.sub(r'<!-- (\w+:\w+) -->.*?<!-- /\1 -->', lambda found: '\n' * found[0].count('\n'),
                  text, flags=re.S)
    found, fenced, blank = [], False, True
    for number, line in enumerate(text.splitlines(), start=1):
        fenced ^= line.lstrip().startswith('```')
        code = fenced or line.lstrip().startswith('```') or (
            re.match(r' {4,}\S', line) and blank and not re.match(r'\s*([-*]|\d+\.) ', line))
        if code:
            # an indented block goes on until a line is less indented
            continue
        item = re.match(r'\s*([-*]|\d+\.)\s+', line)
        if not line.strip() or re.match(r'\s*(\||#|!\[|<)', line):
            blank = True
            continue
        if item or blank or not found:
            found.append([number, line[item.end():] if item else line])
        else:
            found[-1][1] += ' ' + line.strip()
        blank = False
    return found


def sentences(paragraph):
    """Split a paragraph, with every piece of code as one word."""
    plain = re.sub(r'!?\[([^\]]*)\]\([^)]*\)', r'\1', paragraph)
    plain = re.sub(r'`[^`]*`', 'CODE', plain).replace('**', '').replace('*', '')
    plain = _ABBREVIATION.sub(r'\1', plain)
    return re.split(r'(?<=[.!?])[)"\']?\s+', plain.strip())


def words(sentence):
    """Count what is read as a word."""
    return len([word for word in sentence.split() if re.search(r'\w', word)])


@pytest.mark.parametrize('path', PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_sentence_is_long(path):
    long = [f'{path.name}:{number}: {words(sentence)} words: {sentence}'
            for number, paragraph in prose(path.read_text(encoding='utf-8'))
            for sentence in sentences(paragraph) if words(sentence) > LONGEST]
    assert not long, '\n'.join(long)


#: Written by a program, which does not wrap.
GENERATED = ('troubleshooting.md',)


@pytest.mark.parametrize('path', [path for path in PAGES if path.name not in GENERATED],
                         ids=lambda path: str(path.relative_to(ROOT)))
def test_prose_is_wrapped(path):
    fenced, wide = False, []
    for number, line in enumerate(path.read_text(encoding='utf-8').splitlines(), start=1):
        fenced ^= line.lstrip().startswith('```')
        text = re.sub(r'\([^)]*\)', '', line)  # addresses of links cannot be wrapped
        if not fenced and not re.match(r'\s*\||\s{4}', line) and len(text) > WIDEST:
            wide.append(f'{path.name}:{number}: {len(line)} characters')
    assert not wide, '\n'.join(wide)


def test_sentences_are_told_apart_and_counted():
    page = ('# A heading of words that do not count\n\nOne two three. Four `five six` seven?\n\n'
            '| a | table |\n\n    code that is not read\n\n* an item\n  of four words\n')
    assert [[words(one) for one in sentences(text)] for _, text in prose(page)] == [[3, 3], [5]]
