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
"""Bags that ask for more than they may have are one sentence, at once and in little memory."""

import bz2
import re
import shutil
import sqlite3
import struct

import lz4.frame
import numpy as np
import pytest
from rosbags.rosbag1 import reader as rosbag1_reader
from selfcal_ros.errors import InputError
from selfcal_ros.pipeline import bag_limits
from selfcal_ros.pipeline.bag_source import image_topics
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.pipeline.sources import open_source

#: Zeros that a bomb of the tests decompresses to, and what a chunk may have there.
BOMB, ALLOWED = 2 ** 23, 2 ** 16


@pytest.fixture(scope='module')
def good(tmp_path_factory):
    """Return a folder with two good recordings."""
    folder = tmp_path_factory.mktemp('good')
    frames = [Frame(k, 10 ** 18 + k * 10 ** 8, np.full((48, 64), 40 * k, np.uint8))
              for k in range(3)]
    write_image_bag(folder / 'mcap', frames)
    write_image_bag(folder / 'db3', frames, storage='sqlite3')
    return folder


@pytest.fixture
def small_chunks(monkeypatch):
    """Let chunks be small, so that bombs can be, too."""
    monkeypatch.setattr(bag_limits, 'MAX_CHUNK_BYTES', ALLOWED)


def refusal(path):
    """Read a recording to its end; return the sentence with which it is refused."""
    with pytest.raises(InputError) as caught:
        with open_source(path) as source:
            for _ in source:
                pass
    sentence = str(caught.value)
    assert sentence.endswith('.') and '\n' not in sentence and str(path) in sentence
    return sentence


def compressed(kind):
    """Return the bomb in one of the codings."""
    zeros = bytes(BOMB)
    if kind == 'lz4':
        return lz4.frame.compress(zeros)
    return bag_limits._zstd_module().compress(zeros)


def record(code, data):
    """Return a record of mcap."""
    return bytes([code]) + struct.pack('<Q', len(data)) + data


def text(content):
    """Return a string as mcap writes it."""
    return struct.pack('<I', len(content)) + content


@pytest.mark.parametrize('announced', [BOMB, 1000])
@pytest.mark.parametrize('kind', ['zstd', 'lz4'])
def test_a_chunk_that_decompresses_to_gigabytes(tmp_path, small_chunks, kind, announced):
    path = tmp_path / 'bomb.mcap'
    data = compressed(kind)
    path.write_bytes(
        b'\x89MCAP0\r\n' + record(1, text(b'ros2') + text(b''))
        + record(3, struct.pack('<H', 1) + text(b'sensor_msgs/msg/Image') + text(b'ros2msg')
                 + text(b''))
        + record(4, struct.pack('<HH', 1, 1) + text(b'/image') + text(b'cdr') + text(b''))
        + record(6, struct.pack('<QQQI', 0, 1, announced, 0) + text(kind.encode())
                 + struct.pack('<Q', len(data)) + data)
        + record(15, bytes(4)) + record(2, bytes(20)) + b'\x89MCAP0\r\n')
    assert 'in one piece' in refusal(path) or 'decompresses to more' in refusal(path)
    with pytest.raises(InputError):
        image_topics(path)


@pytest.mark.parametrize('mode', ['FILE', 'MESSAGE'])
def test_a_compressed_folder(good, tmp_path, small_chunks, mode):
    folder = tmp_path / 'bomb'
    shutil.copytree(good / 'db3', folder)
    database = folder / 'db3.db3'
    named = database
    if mode == 'FILE':
        named = folder / 'db3.db3.zstd'
        named.write_bytes(compressed('zstd'))
        database.unlink()
    else:
        with sqlite3.connect(database) as connection:
            connection.execute('UPDATE messages SET data = ?', (compressed('zstd'),))
        connection.close()
    metadata = folder / 'metadata.yaml'
    about = metadata.read_text(encoding='utf-8').replace('db3.db3', named.name)
    about = re.sub('compression_format: .*', 'compression_format: zstd', about)
    metadata.write_text(re.sub('compression_mode: .*', f'compression_mode: {mode}', about),
                        encoding='utf-8')
    assert 'decompresses to more' in refusal(folder)


def test_chunks_of_bags_of_ros_1(small_chunks):
    bag_limits.bound_rosbags()
    for kind, data in (('lz4', compressed('lz4')), ('bz2', bz2.compress(bytes(BOMB)))):
        with pytest.raises(bag_limits.BagLimit):
            rosbag1_reader.decompressors[kind](data)


def test_many_chunks_of_one_instant(good, small_chunks, monkeypatch):
    path = next((good / 'mcap').glob('*.mcap'))
    with open_source(path) as source:
        assert sum(1 for _ in source) == 3
    monkeypatch.setattr(bag_limits, 'MAX_CHUNK_BYTES', 3000)
    assert 'sort it by time' in refusal(path)


@pytest.mark.parametrize('statements, odd', [
    (['DROP TABLE schema',
      'CREATE VIEW schema AS WITH RECURSIVE a(schema_version) AS (SELECT 1 UNION ALL SELECT '
      'schema_version + 1 FROM a) SELECT max(schema_version) AS schema_version FROM a'], 'schema'),
    (['ALTER TABLE messages RENAME TO kept',
      'CREATE TABLE messages(id, topic_id, timestamp, data AS (zeroblob(1000000000)))'],
     'messages')])
def test_tables_that_are_queries(good, tmp_path, statements, odd):
    path = tmp_path / 'odd.db3'
    shutil.copy(good / 'db3' / 'db3.db3', path)
    with sqlite3.connect(path) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()
    assert f'its {odd!r} is more than a plain table' in refusal(path)


@pytest.mark.parametrize('old, new, words', [
    ('message_count: 3', 'message_count: many', "'many' where it cannot be"),
    ('message_count: 3', 'message_count: -3', "'-3' where it cannot be"),
    ('message_count: 3', 'message_count: 1.0e+999', 'where it cannot be'),
    ('message_count: 3', 'message_count: [3]', 'where it cannot be'),
    ('name: /camera/image_raw', 'name: [1, 2]', 'where it cannot be'),
    ('name: /camera/image_raw', 'nothing: x', 'not what the recorder'),
    ('version: 9', 'version: {}', 'where it cannot be'),
    ('mcap.mcap', '..', 'cannot be read'),
    ('rosbag2_bagfile_information:', 'a: &a {b: *a}\nrosbag2_bagfile_information:', 'aliases')])
def test_metadata_that_are_not_what_they_say(good, tmp_path, old, new, words):
    folder = tmp_path / 'odd'
    shutil.copytree(good / 'mcap', folder)
    path = folder / 'metadata.yaml'
    about = path.read_text(encoding='utf-8')
    assert old in about
    path.write_text(about.replace(old, new), encoding='utf-8')
    assert words in refusal(folder)
