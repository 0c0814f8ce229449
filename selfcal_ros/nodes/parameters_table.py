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
Markdown tables of the nodes' topics, services and parameters.

`python -m selfcal_ros.nodes.parameters_table` prints them all. With `--update docs/nodes.md` it
fills in what lies between `<!-- parameters:NODE -->` and `<!-- /parameters:NODE -->`, and between
`<!-- interface:NODE -->` and `<!-- /interface:NODE -->`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import Field, fields
from pathlib import Path
import re
import sys
from typing import Any

from selfcal_ros.nodes.interfaces import INTERFACES
from selfcal_ros.nodes.parameters import (AffineCalibratorParameters, BagPlayerParameters,
                                          CalibrationPageParameters,
                                          CameraInfoPublisherParameters,
                                          FeatureTrackerParameters, PlanarCalibratorParameters,
                                          RorapidTrackerParameters)
from selfcal_ros.values.output_files import atomic_write

#: Parameters by node.
PARAMETERS = {
    'feature_tracker': FeatureTrackerParameters,
    'planar_calibrator': PlanarCalibratorParameters,
    'affine_calibrator': AffineCalibratorParameters,
    'rorapid_tracker': RorapidTrackerParameters,
    'bag_player': BagPlayerParameters,
    'camera_info_publisher': CameraInfoPublisherParameters,
    'calibration_page': CalibrationPageParameters,
}
_BLOCK = re.compile(r'(<!-- (parameters|interface):(\w+) -->\n).*?(?=<!-- /\2:\3 -->)', re.S)


def parameters_table(node: str) -> str:
    """Return the parameters of a node as a Markdown table, with a line end."""
    rows = [(f'`{entry.name}`', f'`{literal(entry.default)}`', _allowed(entry),
             'yes' if entry.metadata['live'] else 'no', entry.metadata['description'])
            for entry in fields(PARAMETERS[node])]
    return _table(('parameter', 'default', 'allowed', 'at run time', 'meaning'), rows)


def interface_table(node: str) -> str:
    """Return the topics and services of a node as a Markdown table, with a line end."""
    return _table(('', 'name', 'type', 'meaning'),
                  [(end.direction, f'`{end.name}`', f'`{end.type}`', end.description)
                   for end in INTERFACES[node]])


def updated(text: str) -> str:
    """
    Return a text with its tables brought up to date.

    Raises
    ------
    KeyError
        If a marker names a node that does not exist.

    """
    tables = {'parameters': parameters_table, 'interface': interface_table}
    return _BLOCK.sub(lambda found: found[1] + tables[found[2]](found[3]), text)


def literal(value: object) -> str:
    """Write a value as YAML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if value == '' else str(value)


def _allowed(entry: Field[Any]) -> str:
    low, high, one_of = (entry.metadata[key] for key in ('low', 'high', 'one_of'))
    if one_of:
        return ', '.join(f'`{value}`' for value in one_of)
    if isinstance(entry.default, bool):
        return '`true`, `false`'
    return 'text' if low is None and high is None else f'{low:g} to {high:g}'


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ['---'] * len(header), *rows]
    text = ''.join(f'| {" | ".join(line)} |\n' for line in lines)
    # a name in angle brackets is no tag
    return text.replace('<', '&lt;')


def main(argv: list[str] | None = None) -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--update', type=Path, metavar='FILE')
    args = parser.parse_args(argv)
    if args.update:
        text = args.update.read_text(encoding='utf-8')
        if updated(text) != text:
            atomic_write(args.update, updated(text))
        return 0
    for node in PARAMETERS:
        print(f'### {node}\n\n{interface_table(node)}\n{parameters_table(node)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
