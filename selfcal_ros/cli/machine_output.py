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
"""Results for another program: strict JSON in a file, or alone on standard output."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
from typing import Any

#: A file name that means standard output.
STANDARD_OUTPUT = '-'


def add_json_argument(parser: argparse._ActionsContainer) -> None:
    """Add the option --json."""
    parser.add_argument('--json', type=Path, metavar='FILE',
                        help='everything, for another program; "-" prints it, and nothing else')


def is_standard_output(path: Path | None) -> bool:
    """Tell whether the JSON goes to standard output, which is then nobody else's."""
    return path is not None and str(path) == STANDARD_OUTPUT


def write_json(path: Path, content: dict[str, Any] | str) -> None:
    """
    Write JSON to a file, whole or not at all, or to standard output.

    Parameters
    ----------
    path : Path
    content : dict or str
        Text is taken to be JSON already.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    if not isinstance(content, str):
        content = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + '\n'
    if is_standard_output(path):
        try:
            content.encode(sys.stdout.encoding or 'utf-8')
        except UnicodeEncodeError:
            # escaped as JSON does, where the terminal cannot show it
            content = json.dumps(json.loads(content), indent=2) + '\n'
        print(content, end='')
        return
    from selfcal_ros.values.output_files import atomic_write
    atomic_write(path, content)
