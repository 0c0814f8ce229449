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
"""The bag writer: whole bags or none; what it writes is read back in test_sources.py."""

from dataclasses import replace
import errno
import tempfile

import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.bag_writer import write_image_bag
from selfcal_ros.pipeline.sources import Frame, open_source


def frames():
    """Return three frames."""
    return [Frame(k, 1 + k, np.full((6, 8), k, np.uint8)) for k in range(3)]


@pytest.mark.parametrize('compressed', [None, 'png'])
def test_colour_is_written_where_there_is_some(tmp_path, compressed):
    bgr = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
    write_image_bag(tmp_path / 'bag', [Frame(0, 1, np.zeros((6, 8), np.uint8), bgr=bgr)],
                    compressed=compressed, frame_id='front')
    with open_source(tmp_path / 'bag', colour=True) as source:
        assert (next(iter(source)).bgr == bgr).all() and source.frame_id == 'front'


def test_a_folder_that_takes_no_bag_asks_for_another(tmp_path, monkeypatch):
    def refused(**_):
        raise OSError(errno.EROFS, 'Read-only file system')

    monkeypatch.setattr(tempfile, 'mkdtemp', refused)
    with pytest.raises(InputError) as caught:
        write_image_bag(tmp_path / 'bag', frames())
    assert str(caught.value) == (
        f'{tmp_path / "bag"} cannot be written: the folder {tmp_path} refuses new files '
        '(Read-only file system); choose another folder.')


def test_a_stamp_before_1970_is_for_sqlite3(tmp_path):
    early = [replace(frames()[0], stamp_ns=-10**9)]
    with pytest.raises(InputError, match='before 1970.* --storage sqlite3'):
        write_image_bag(tmp_path / 'bag', early)
    write_image_bag(tmp_path / 'bag', early, storage='sqlite3')
    with open_source(tmp_path / 'bag') as source:
        assert next(iter(source)).stamp_ns == -10**9


def test_the_bag_writer_leaves_nothing_half_written(tmp_path):
    def broken():
        yield frames()[0]
        raise RuntimeError('camera unplugged')

    with pytest.raises(RuntimeError):
        write_image_bag(tmp_path / 'bag', broken())
    with pytest.raises(InputError, match='no images'):
        write_image_bag(tmp_path / 'bag', [])
    assert list(tmp_path.iterdir()) == []
    write_image_bag(tmp_path / 'bag', frames())
    with pytest.raises(InputError, match='exists already'):
        write_image_bag(tmp_path / 'bag', frames())
    with pytest.raises(InputError, match='cannot be written'):
        write_image_bag(tmp_path / 'bag' / 'metadata.yaml' / 'x', frames())
    with pytest.raises(InputError, match='does not exist; make it first'):
        write_image_bag(tmp_path / 'none' / 'bag', frames())
    for wrong in ({'topic': 'no slash'}, {'storage': 'csv'}, {'compressed': 'gif'}):
        with pytest.raises(ArgumentError):
            write_image_bag(tmp_path / 'other', frames(), **wrong)
