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
"""The files of a bag, looked at before a library opens them."""

from __future__ import annotations

from pathlib import Path

from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.bag_limits import check_metadata, is_compressed_file
from selfcal_ros.values.foreign_files import BAG_BEGINNINGS

_KIND = {'.mcap': 'an mcap file', '.db3': 'a rosbag2 sqlite3 file', '.bag': 'a ROS 1 bag'}


def format_name(path: Path) -> str:
    """Call a bag by its format."""
    return 'rosbag2 folder' if path.is_dir() else _KIND[path.suffix].split(' ', 1)[1]


def check_files(path: Path) -> None:
    """
    Find what rosbags would not, or would say less clearly.

    Raises
    ------
    InputError
        If files are missing, or are no bag by their name and first bytes.

    """
    if path.is_dir():
        files = sorted(entry for entry in path.iterdir() if entry.suffix in ('.mcap', '.db3'))
        closed = (path / 'metadata.yaml').is_file()
        if not files and not closed:
            raise InputError(f'{path} is no bag; give a folder with an .mcap or .db3 file in it.')
        if not closed:
            raise InputError(f'{path} has no metadata.yaml, so the recording was not closed; run '
                             f'`ros2 bag reindex` on it, or give the file {files[0].name}.')
        check_metadata(path)
    else:
        files = [path]
        if is_compressed_file(path):
            raise InputError(f'{path}: this bag is compressed; give its folder, '
                             f'{path.absolute().parent}.')
    for file in files:
        _check_file(file)


def _check_file(path: Path) -> None:
    """Check magic number and, for SQLite, completeness."""
    if path.exists() and path.suffix not in BAG_BEGINNINGS:
        raise InputError(f'{path} is no bag; give a rosbag2 folder, or an .mcap, .db3 or .bag '
                         'file.')
    try:
        size = path.stat().st_size
        with path.open('rb') as stream:
            head = stream.read(100)
    except OSError as error:
        raise InputError(f'{path} cannot be read: {error.strerror}.') from None
    if size == 0:
        raise InputError(f'{path} is empty (0 bytes); give another file.')
    if not head.startswith(BAG_BEGINNINGS[path.suffix]):
        raise InputError(f'{path} is not {_KIND[path.suffix]}, although its name ends in '
                         f'{path.suffix}.')
    if path.suffix == '.db3':
        if set(str(path)) & set('?#%'):
            raise InputError(f'{path} cannot be opened because SQLite takes the characters ?, # '
                             'and % in a path for parts of an address; rename it.')
        # SQLite notices missing pages only when a query meets them
        page = int.from_bytes(head[16:18], 'big')
        page = 65536 if page == 1 else page
        pages = int.from_bytes(head[28:32], 'big')
        if head[24:28] == head[92:96] and size < page * pages:
            raise InputError(f'{path} is truncated: {size} of {page * pages} bytes are there.')
        log = path.with_name(path.name + '-wal')
        if log.is_file() and log.stat().st_size:
            raise InputError(f'{path} was not closed by the recorder ({log.name} holds the rest); '
                             f'open it once with `sqlite3 {path.name} "PRAGMA '
                             'wal_checkpoint(TRUNCATE);"`.')
