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
What a bag may ask for: bounded decompression, plain tables, metadata that are what they say.

rosbags gives whatever a file asks for. A few kilobytes can decompress to gigabytes, tables can be
queries without end, and counts can be words. What is checked or bounded here is so before, or
while, rosbags reads it.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
import sqlite3
from types import ModuleType
from typing import Any, IO

from selfcal_ros.errors import InputError
from selfcal_ros.values.foreign_files import load_foreign_yaml, read_limited

#: A message or a chunk of messages, decompressed; chunks that overlap in time are held together.
MAX_CHUNK_BYTES = 2 ** 28
#: A file that is compressed as a whole: images come to a tenth at best.
MAX_FILE_RATIO = 100
_MAX_METADATA_BYTES = 10_000_000
_MEBIBYTE = 2 ** 20


class BagLimit(Exception):
    """A bag asks for more than it may have; its text says what, without the name of the bag."""


def bound_rosbags() -> None:
    """Let rosbags read no more at once than is announced and allowed; once is enough."""
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2, storage_mcap, storage_sqlite3
    if getattr(ros2, 'selfcal_ros_bounded', False):
        return
    chunks = storage_mcap.DECOMPRESSORS
    chunks['lz4'] = _lz4
    chunks['zstd'] = _zstd
    table = ros1.decompressors
    table['bz2'] = _bz2
    table['lz4'] = _lz4
    setattr(ros2, 'zstd', _BoundedZstd)
    setattr(storage_mcap, 'read_exact', _read_exact)
    for module in (ros2, storage_mcap, storage_sqlite3):
        # the quality of service of whoever recorded does not matter here, and is YAML
        setattr(module, 'parse_qos', _no_qos)
    for reader in (storage_mcap.McapReader, storage_sqlite3.Sqlite3Reader):
        setattr(reader, 'open', _bounded_open(reader.open))
    setattr(ros2, 'selfcal_ros_bounded', True)


def _bounded_open(inner: Callable[[Any], object]) -> Callable[[Any], None]:
    """Wrap the opening of a file, also of one that was decompressed to a temporary folder."""
    def opened(storage: Any) -> None:
        if storage.path.suffix == '.db3':
            check_tables(Path(storage.path))
        inner(storage)
        try:
            bound_storage(storage)
        except BaseException:
            storage.close()
            raise
    return opened


def _no_qos(*_: Any) -> list[Any]:
    return []


def _read_exact(stream: IO[bytes], size: int) -> bytes:
    """Read so many bytes, which may not be more than a chunk may have."""
    from rosbags.rosbag2.errors import ReaderError
    if size > MAX_CHUNK_BYTES:
        raise BagLimit(f'it announces {size // _MEBIBYTE} MiB in one piece')
    data: bytes = stream.read(size)
    if len(data) != size:
        raise ReaderError(f'{size} bytes are announced, {len(data)} are there')
    return data


def _bounded(decompressor: Any, data: bytes, size: int | None = None) -> bytes:
    """Decompress at most so many bytes, where it is not known as many as may be."""
    size = MAX_CHUNK_BYTES if size is None else size
    if size > MAX_CHUNK_BYTES:
        raise BagLimit(f'it announces {size // _MEBIBYTE} MiB of messages in one piece')
    raw: bytes = decompressor.decompress(data, size + 1)
    if len(raw) > size:
        raise BagLimit(f'it decompresses to more than the {size} bytes that may be')
    return raw


def _lz4(data: bytes, size: int | None = None) -> bytes:
    from lz4.frame import LZ4FrameDecompressor
    return _bounded(LZ4FrameDecompressor(), data, size)


def _bz2(data: bytes) -> bytes:
    return _bounded(bz2.BZ2Decompressor(), data)


def _zstd(data: bytes, size: int | None = None) -> bytes:
    return _bounded(_zstd_module().ZstdDecompressor(), data, size)


def _zstd_module() -> ModuleType:
    try:
        from compression import zstd
    except ImportError:
        from backports import zstd
    module: ModuleType = zstd
    return module


class _BoundedZstd:
    """What rosbags takes of the module zstd, bounded."""

    @staticmethod
    def decompress(data: bytes) -> bytes:
        """Decompress a message."""
        return _zstd(data)

    @staticmethod
    def open(stream: IO[bytes], mode: str = 'rb') -> _BoundedFile:
        """Open a compressed file for reading."""
        return _BoundedFile(stream, _zstd_module().open(stream, mode))


class _BoundedFile:
    """A file that is decompressed, not to a hundred times what it is."""

    def __init__(self, stream: IO[bytes], inner: IO[bytes]) -> None:
        at = stream.tell()
        self._left = MAX_CHUNK_BYTES + MAX_FILE_RATIO * stream.seek(0, 2)
        stream.seek(at)
        self._inner = inner

    def __enter__(self) -> _BoundedFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._inner.close()

    def read(self, size: int = -1) -> bytes:
        """Read so many bytes at most."""
        data: bytes = self._inner.read(min(size, _MEBIBYTE) if size >= 0 else _MEBIBYTE)
        self._left -= len(data)
        if self._left < 0:
            raise BagLimit(f'it decompresses to more than {MAX_FILE_RATIO} times its size')
        return data


def bound_storage(storage: Any) -> None:
    """
    Bound what an open file gives at once.

    Messages come in the order of time, so all chunks of an instant are decompressed together.

    Raises
    ------
    BagLimit
        If the chunks of an mcap file overlap so much that memory would not hold them.

    """
    if getattr(storage, 'dbconn', None) is not None:
        import apsw
        storage.dbconn.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
    events = []
    for chunk in getattr(storage, 'chunks', ()):
        events += [(chunk.message_start_time, 0, chunk.uncompressed_size),
                   (chunk.message_end_time, 1, -chunk.uncompressed_size)]
    held = 0
    for _, _, change in sorted(events):
        held += change
        if held > MAX_CHUNK_BYTES:
            raise BagLimit('more messages of the same time lie in it than memory may take; '
                           'sort it by time, in smaller chunks')


def check_tables(path: Path) -> None:
    """
    Refuse an SQLite file with anything but plain tables: a view can be a query without end.

    Raises
    ------
    InputError
        If there is a view, a trigger, or a table that is computed.

    """
    place = f'{path.absolute().as_uri()}?mode=ro&immutable=1'
    try:
        with closing(sqlite3.connect(place, uri=True)) as connection:
            connection.execute('PRAGMA trusted_schema=OFF')
            objects = connection.execute(
                'SELECT type, name, rootpage FROM sqlite_master LIMIT 10001').fetchall()
            odd = [name for kind, name, page in objects
                   if kind not in ('table', 'index') or not page]
            odd += [name for kind, name, page in objects
                    if kind == 'table' and page and _computed(connection, str(name))]
    except sqlite3.Error as error:
        raise InputError(f'{path} cannot be read as a bag; it is damaged or truncated '
                         f'({error}).') from None
    if odd or len(objects) > 10000:
        name = f'{odd[0]!s:.40}' if odd else 'objects'
        raise InputError(f'{path} is no recording of rosbag2: its {name!r} is more than a plain '
                         'table; it is not read.')


def _computed(connection: sqlite3.Connection, table: str) -> bool:
    """Tell a table with columns that are computed when they are read."""
    rows = connection.execute('SELECT hidden FROM pragma_table_xinfo(?)', (table,)).fetchall()
    return any(row[0] for row in rows)


def check_metadata(folder: Path) -> None:
    """
    Refuse metadata of a rosbag2 folder that are not what the recorder writes.

    Raises
    ------
    InputError
        With the sentence of what is wrong.

    """
    path = folder / 'metadata.yaml'
    content = load_foreign_yaml(read_limited(path, _MAX_METADATA_BYTES), str(path))
    try:
        about = content['rosbag2_bagfile_information']
        topics = [(topic['message_count'], topic['topic_metadata']['name'],
                   topic['topic_metadata']['type']) for topic in
                  about['topics_with_message_count']]
        names = list(about['relative_file_paths'])
        numbers = [about['version'], about['message_count'], about['duration']['nanoseconds'],
                   about['starting_time']['nanoseconds_since_epoch'],
                   *(count for count, _, _ in topics)]
        words = [about['storage_identifier'], *names, *(one for topic in topics
                                                        for one in topic[1:]),
                 about.get('compression_mode') or '', about.get('compression_format') or '']
    except (AttributeError, LookupError, TypeError):
        raise InputError(f'{path} is not what the recorder of rosbag2 writes; run `ros2 bag '
                         'reindex` on the folder.') from None
    wrong = [one for one in numbers if type(one) is not int or abs(one) >= 2 ** 63]
    wrong += [count for count, _, _ in topics if type(count) is int and count < 0]
    wrong += [one for one in words if not isinstance(one, str)]
    if not wrong and len(set(names)) < len(names):
        wrong = ['one file twice']
    if wrong:
        raise InputError(f'{path} has {str(wrong[0])!r:.40} where it cannot be; run `ros2 bag '
                         'reindex` on the folder.')


def is_compressed_file(path: Path) -> bool:
    """Tell a file of a compressed bag, which cannot be read without its folder."""
    if path.name.lower().endswith(('.db3.zstd', '.mcap.zstd', '.db3.zst', '.mcap.zst')):
        return True
    metadata = path.with_name('metadata.yaml')
    if path.suffix not in ('.db3', '.mcap') or not metadata.is_file():
        return False
    try:
        content = load_foreign_yaml(read_limited(metadata, _MAX_METADATA_BYTES), str(metadata))
        mode = content['rosbag2_bagfile_information']['compression_mode']
    except (InputError, LookupError, TypeError):
        # a file by itself may be good where its folder's metadata are not
        return False
    return str(mode).lower() in ('file', 'message')
