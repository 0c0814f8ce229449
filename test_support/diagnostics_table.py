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
"""The keys of diagnostics that docs/nodes.md explains."""

from functools import lru_cache
from pathlib import Path
import re

PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'nodes.md'
#: What a word in capitals stands for; PARAMETER is fx or k1.
ANY, PARAMETER = r'\w+', r'[a-z]{1,4}\d?'


@lru_cache(maxsize=None)
def written_keys():
    """Return a pattern for each key that is explained."""
    section = PAGE.read_text(encoding='utf-8').split('\n## Diagnostics\n')[1].split('\n## ')[0]
    tables = section.split('\n| key | meaning |\n')[1:]
    cells = [row.split(' | ')[0] for table in tables for row in table.splitlines()
             if row.startswith('| `')]
    keys = [key for cell in cells for key in re.findall('`(.*?)`', cell)]
    return tuple(re.compile(re.sub('[A-Z]{4,}', lambda found: PARAMETER if
                                   found[0] == 'PARAMETER' else ANY, key)) for key in keys)


def not_written(keys):
    """List the keys of a DiagnosticStatus that the page does not explain."""
    return [key for key in keys if not any(one.fullmatch(key) for one in written_keys())]
