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
"""Tables on the terminal, verdicts against what is required, and the machine they hold for."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
import os
import platform
import time

import selfcal_ros


class Report:
    """
    Prints tables as they are made, and keeps the verdicts.

    Attributes
    ----------
    failures : list of str
        What missed its requirement.

    """

    def __init__(self):
        """Start without failures."""
        self.failures = []
        self._section = ''

    def section(self, title: str, *remarks: str) -> None:
        """Print a heading and what a reader must know of the table below."""
        self._section = title
        print(f'\n## {title}\n', flush=True)
        for remark in remarks:
            print(remark)
        if remarks:
            print(flush=True)

    def table(self, header, rows) -> None:
        """Print rows as a Markdown table with aligned columns."""
        cells = [[_text(cell) for cell in row] for row in [header, *rows]]
        width = [max(map(len, column)) for column in zip(*cells)]
        lines = ['| ' + ' | '.join(cell.ljust(w) for cell, w in zip(row, width)) + ' |'
                 for row in cells]
        lines.insert(1, '|' + '|'.join('-' * (w + 2) for w in width) + '|')
        print('\n'.join(lines), flush=True)

    def verdict(self, what: str, value: float, limit: float, unit: str = '') -> bool:
        """Print whether |value| is within its limit, and remember if it is not."""
        held = abs(value) <= limit
        unit = unit and f' {unit}'
        return self.judge(held, f'{what}: {value:.3g}{unit}, required {limit:g}{unit}')

    def judge(self, held: bool, sentence: str) -> bool:
        """Print a verdict in words."""
        print(f'{"holds " if held else "MISSED"}  {sentence}', flush=True)
        if not held:
            self.failures.append(f'{self._section}: {sentence}')
        return bool(held)

    def say(self, sentence: str) -> None:
        """Print a line."""
        print(sentence, flush=True)


def _text(cell) -> str:
    if isinstance(cell, float):
        return f'{cell:.4g}'
    return str(cell)


def environment() -> str:
    """Date, versions and machine in one line."""
    parts = [time.strftime('%Y-%m-%d'), f'selfcal_ros {selfcal_ros.__version__}',
             f'Python {platform.python_version()}']
    for package in ('numpy', 'scipy', 'opencv-python-headless', 'pycolmap'):
        try:
            parts.append(f'{package} {version(package)}')
        except PackageNotFoundError:
            continue
    parts.append(f'{os.cpu_count()} CPUs, load {os.getloadavg()[0]:.1f}')
    parts += [f'{name} {os.environ.get(name, "all")}'
              for name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS')]
    return ', '.join(parts)


def percent(value: float, truth: float) -> float:
    """Error in percent of the truth."""
    return 100 * (value / truth - 1)
