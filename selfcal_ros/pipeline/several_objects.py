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
"""Several objects in the same images: which files, and what each is called."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import re

from selfcal_ros.errors import ArgumentError
from selfcal_ros.findings.phrase import put_in_words


def several(text: str) -> list[str]:
    """
    Part a list of files at its commas.

    A file whose name has a comma is one file, if it is there.

    Raises
    ------
    ArgumentError
        If there is nothing between two commas.

    """
    if Path(text).exists():
        return [text]
    paths = [word.strip() for word in text.split(',')]
    if not all(paths):
        raise ArgumentError(f'Models are parted by commas; {text!r:.80} has an empty place.')
    return paths


def object_names(paths: Sequence[str | Path]) -> list[str]:
    """
    Name objects by the files of their models, as topics may be called.

    Parameters
    ----------
    paths : sequence of str or Path

    Returns
    -------
    list of str
        Letters, digits and underscores, no two alike: `cube`, `cube_2`.

    """
    names: list[str] = []
    for path in paths:
        name = re.sub('[^A-Za-z0-9]+', '_', Path(path).stem).strip('_')
        name = name if name[:1].isalpha() else f'object_{name}'.rstrip('_')
        count, other = 1, name
        while other in names:
            count += 1
            other = f'{name}_{count}'
        names.append(other)
    return names


def parted_starts(text: str, count: int) -> list[str]:
    """
    Part start poses at their semicolons, one an object.

    Raises
    ------
    ArgumentError
        If there are fewer or more than objects.

    """
    words = [word.strip() for word in text.split(';')] if count > 1 else [text.strip()]
    if len(words) != count:
        raise ArgumentError(put_in_words(
            '--init has {poses} pose{poses:plural} for {objects} object{objects:plural}; part '
            'them by semicolons, in the order of the models.',
            {'poses': len(words), 'objects': count}))
    return words
