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
Take the pages that lie outside of docs/ into the site: a hook of MkDocs, named in mkdocs.yml.

Links are written as they hold in the repository. Here those between docs/ and the pages beside
it are turned into links of the site; a link to a source file becomes its path in plain text.
"""

from __future__ import annotations

import os
from pathlib import Path, PurePosixPath
import re

ROOT = Path(__file__).resolve().parents[1]
#: Page of the repository, and its place in the site.
OUTSIDE = {
    'README.md': 'project/readme.md',
    'examples/README.md': 'project/examples.md',
    'bags/README.md': 'project/recordings.md',
    'CONTRIBUTING.md': 'project/contributing.md',
    'QUALITY_DECLARATION.md': 'project/quality.md',
    'SECURITY.md': 'project/security.md',
    'bench/README.md': 'project/benchmarks.md',
}
_LINK = re.compile(r'(!?)\[([^\]]*)\]\(([^)\s#]*)(#[^)\s]*)?\)')


def on_files(files, config):
    """Add the pages from outside."""
    from mkdocs.structure.files import File
    for source, place in {**OUTSIDE, **_results()}.items():
        files.append(File.generated(
            config, place, content=(ROOT / source).read_text(encoding='utf-8')))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turn the links of a page into links of the site."""
    place = page.file.src_uri
    outside = {**OUTSIDE, **_results()}
    source = next((name for name, other in outside.items() if other == place), f'docs/{place}')
    return with_links_of_the_site(markdown, source, outside)


def with_links_of_the_site(markdown: str, source: str, outside: dict[str, str]) -> str:
    """
    Rewrite the relative links of a page.

    Parameters
    ----------
    markdown : str
    source : str
        Path of the page in the repository.
    outside : dict of str to str
        Paths of pages outside of docs/, and their places in the site.

    """
    place = PurePosixPath(outside.get(source, source.removeprefix('docs/')))

    def rewrite(found):
        picture, text, target, anchor = found.groups(default='')
        if not target or '://' in target or target.startswith('mailto:'):
            return found[0]
        path = os.path.normpath(PurePosixPath(source).parent / target)
        if path in outside:
            there = outside[path]
        elif path.startswith('docs/'):
            there = path.removeprefix('docs/')
        else:
            return text if text.startswith('`') else f'{text} (`{path}`)'
        return f'{picture}[{text}]({os.path.relpath(there, place.parent)}{anchor})'

    return _LINK.sub(rewrite, markdown)


def _results() -> dict[str, str]:
    """Find the tables of the benches."""
    return {f'bench/results/{path.name}': f'project/{path.name}'
            for path in sorted((ROOT / 'bench' / 'results').glob('*.md'))}
