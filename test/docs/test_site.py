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
"""The site of the documents builds without a warning, and needs no network to be read."""

from importlib.util import find_spec
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r'!?\[[^\]]*\]\(([^)\s#]+)(?:#[^)\s]*)?\)')


def _pages():
    """List every Markdown page of the project."""
    return sorted([*(ROOT / 'docs').rglob('*.md'), *(ROOT / 'bench').rglob('*.md'),
                   *(ROOT / 'examples').glob('*.md'), *(ROOT / 'bags').glob('*.md'),
                   *ROOT.glob('*.md')])


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    if not find_spec('mkdocs'):
        pytest.skip('MkDocs is not installed')
    folder = tmp_path_factory.mktemp('site')
    done = subprocess.run([sys.executable, '-m', 'mkdocs', 'build', '--strict',
                           '--site-dir', folder], cwd=ROOT, capture_output=True, text=True,
                          timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_builds_without_a_warning(site):
    pages = {str(path.relative_to(site)) for path in site.rglob('*.html')}
    assert {'index.html', 'nodes.html', 'how-to/calibrate-my-agv.html',
            'project/readme.html'} <= pages


def test_the_site_loads_nothing_from_a_network(site):
    for path in site.rglob('*.html'):
        text = path.read_text(encoding='utf-8')
        loaded = re.findall(r'<(?:script|img|iframe)\b[^>]*\bsrc="([^"]+)"|'
                            r'<link\b(?=[^>]*stylesheet)[^>]*\bhref="([^"]+)"', text)
        assert not [one for pair in loaded for one in pair if re.match('(https?:)?//', one)], path


@pytest.mark.parametrize('path', _pages(), ids=lambda path: str(path.relative_to(ROOT)))
def test_every_relative_link_leads_to_a_file(path):
    for target in LINK.findall(path.read_text(encoding='utf-8')):
        if not re.match(r'[a-z]+:', target):
            assert (path.parent / target).exists(), target
