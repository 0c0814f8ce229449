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
"""Files that others wrote: how much of them is read, and how much is made of it, is bounded."""

from __future__ import annotations

import os
from pathlib import Path
import stat
from typing import Any

import yaml

from selfcal_ros.errors import InputError

#: How a bag begins, by the suffix of its name.
BAG_BEGINNINGS = {'.mcap': b'\x89MCAP0\r\n', '.db3': b'SQLite format 3\0',
                  '.bag': b'#ROSBAG V2.0'}
#: Entries that a YAML file may have, its aliases written out.
MAX_ENTRIES = 500_000
#: Lists and mappings within each other.
MAX_DEPTH = 100
#: libyaml's is some ten times as fast, where PyYAML was built with it.
SAFE_LOADER: type = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


def read_limited(path: str | Path, limit: int, what: str = '') -> bytes:
    """
    Read a file of so many bytes at most; devices and pipes without a name are none.

    Parameters
    ----------
    path : str or Path
    limit : int
        Bytes.
    what : str
        What to call it before its name, 'The mask' for example.

    Raises
    ------
    InputError
        If it cannot be read, is no file or is longer.

    """
    # an empty name is this folder
    path = Path(path)
    name = f'{what} {path}'.strip()
    try:
        # a pipe that nobody writes to would be waited for
        with open(path, 'rb', opener=lambda name, flags: os.open(
                name, flags | getattr(os, 'O_NONBLOCK', 0))) as stream:
            mode = os.fstat(stream.fileno()).st_mode
            # <(command) of a shell is a pipe that somebody writes to
            handed = stat.S_ISFIFO(mode) and str(path).startswith(('/dev/', '/proc/'))
            if handed:
                os.set_blocking(stream.fileno(), True)
            elif not stat.S_ISREG(mode):
                raise InputError(f'{name} is no file but a device or a pipe; give a file.')
            raw = stream.read(limit + 1)
    except FileNotFoundError as error:
        raise InputError(f'{name} cannot be read: {error.strerror}; check the path.') from None
    except IsADirectoryError as error:
        raise InputError(f'{name} cannot be read: {error.strerror}; name a file in it.') from None
    except (OSError, ValueError) as error:
        why = getattr(error, 'strerror', None) or error
        raise InputError(f'{name} cannot be read: {why}.') from None
    if len(raw) > limit:
        raise InputError(f'{name} is too large for such a file: longer than {limit} bytes.')
    return raw


def load_foreign_yaml(text: str | bytes, source: str, loader: type = SAFE_LOADER) -> Any:
    """
    Parse YAML whose aliases and merges do not make it larger than a file may be.

    A few hundred bytes of aliases of aliases stand for more than any memory holds. The entries
    are counted on the graph of nodes, before anything is made of it.

    Parameters
    ----------
    text : str or bytes
    source : str
        Starts the sentence of an error.
    loader : type
        A safe loader of PyYAML.

    Raises
    ------
    InputError
        If it is no YAML, or stands for more than `MAX_ENTRIES`.

    """
    try:
        # libyaml composes by recursion, which ends in a crash
        if _depth(text, loader) > MAX_DEPTH:
            raise InputError(f'{source} is not valid YAML, or nested deeper than {MAX_DEPTH}.')
        parser = loader(text)
        try:
            node = parser.get_single_node()
            if node is None:
                return None
            if _written_out(node, {}) > MAX_ENTRIES:
                raise InputError(f'{source} stands for more than {MAX_ENTRIES} entries, as it '
                                 'repeats itself by aliases; it is not read.')
            return parser.construct_document(node)
        finally:
            parser.dispose()
    except (yaml.YAMLError, ValueError, ArithmeticError, AttributeError, LookupError,
            RecursionError, TypeError) as error:
        # explicit tags on values that do not fit them raise the latter
        where = getattr(error, 'problem_mark', None)
        line = f' (line {where.line + 1})' if where else ''
        raise InputError(f'{source} is not valid YAML{line}.') from None


def _depth(text: str | bytes, loader: type) -> int:
    """Return how deep lists and mappings lie in each other, at most one more than may be."""
    depth = deepest = 0
    for event in yaml.parse(text, loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            deepest = max(deepest, depth)
            if deepest > MAX_DEPTH:
                break
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
    return deepest


def _written_out(node: yaml.Node, known: dict[int, int]) -> int:
    """Count the nodes below one, and that one; what contains itself has no end."""
    count = known.get(id(node))
    if count is not None:
        return count
    # found again on the way down: an alias to what it lies in
    known[id(node)] = MAX_ENTRIES + 1
    count = 1
    if isinstance(node, yaml.SequenceNode):
        count += sum(_written_out(child, known) for child in node.value)
    elif isinstance(node, yaml.MappingNode):
        count += sum(_written_out(child, known) for pair in node.value for child in pair)
    known[id(node)] = count
    return count
