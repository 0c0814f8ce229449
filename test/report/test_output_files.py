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
"""Files appear whole or not at all."""

import os
from pathlib import Path
import stat

import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.report.overlay_video import OverlayVideo
from selfcal_ros.values import output_files
from selfcal_ros.values.output_files import (atomic_write, check_outputs, check_writable,
                                             OutputTaken)


def test_write_and_replace(tmp_path):
    path = tmp_path / 'a.txt'
    assert atomic_write(str(path), 'ä\n') == path
    assert path.read_bytes() == 'ä\n'.encode()
    atomic_write(path, b'\x00\xff')
    assert path.read_bytes() == b'\x00\xff'
    assert [entry.name for entry in tmp_path.iterdir()] == ['a.txt']


def test_what_another_run_has_made_meanwhile_is_kept(tmp_path, monkeypatch):
    path = tmp_path / 'a.txt'
    atomic_write(path, 'first', replace=False)
    for _ in range(2):
        with pytest.raises(OutputTaken, match='a.txt has been made meanwhile and is kept'):
            atomic_write(path, 'second', replace=False)
        assert path.read_text() == 'first' and len(list(tmp_path.iterdir())) == 1
        # again, where the file system has no links
        monkeypatch.setattr(output_files.os, 'link', _no_links)
    path.write_text('')
    # nothing is lost with an empty one
    atomic_write(path, 'second', replace=False)
    atomic_write(tmp_path / 'b.txt', 'third', replace=False)
    assert path.read_text() == 'second' and (tmp_path / 'b.txt').read_text() == 'third'


def _no_links(*_):
    raise PermissionError(1, 'Operation not permitted')


def test_permissions_are_those_of_a_plain_file(tmp_path):
    (tmp_path / 'plain').write_text('x')
    atomic_write(tmp_path / 'atomic', 'x')
    assert stat.S_IMODE((tmp_path / 'atomic').stat().st_mode) == stat.S_IMODE(
        (tmp_path / 'plain').stat().st_mode)
    os.chmod(tmp_path / 'plain', 0o640)
    atomic_write(tmp_path / 'plain', 'y')
    assert stat.S_IMODE((tmp_path / 'plain').stat().st_mode) == 0o640


def test_links_are_followed_and_devices_kept(tmp_path):
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'folder' / 'target').write_text('old')
    (tmp_path / 'link').symlink_to(tmp_path / 'folder' / 'target')
    atomic_write(tmp_path / 'link', 'new')
    assert (tmp_path / 'link').is_symlink()
    assert (tmp_path / 'folder' / 'target').read_text() == 'new'
    check_writable('/dev/null')
    atomic_write('/dev/null', 'x')
    assert stat.S_ISCHR(os.stat('/dev/null').st_mode)


def test_an_output_that_is_an_input_is_refused_whatever_its_name(tmp_path):
    drive = tmp_path / 'drive.mcap'
    drive.write_bytes(b'recorded')
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'link.yaml').symlink_to(drive)
    os.link(drive, tmp_path / 'hard.yaml')
    for output in (drive, tmp_path / 'folder' / '..' / 'drive.mcap', tmp_path / 'link.yaml',
                   tmp_path / 'hard.yaml'):
        with pytest.raises(ArgumentError, match='is the input .* choose another name'):
            check_outputs((None, output), (drive, None))
    check_outputs((tmp_path / 'other.mcap', tmp_path / 'x.yaml'), (drive, 'chessboard:9x6:0.02'))
    with pytest.raises(ArgumentError, match='same name'):
        check_outputs((tmp_path / 'a', tmp_path / 'folder' / '..' / 'a'), (drive,))
    assert drive.read_bytes() == b'recorded'


def test_images_and_bags_of_a_folder_are_not_replaced_but_others_may_lie_beside(tmp_path):
    for name in ('a.png', 'drive_0.mcap', 'metadata.yaml', 'camera.yaml'):
        (tmp_path / name).write_bytes(b'x')
    for name in ('a.png', 'drive_0.mcap', 'metadata.yaml'):
        with pytest.raises(ArgumentError, match='a part of it'):
            check_outputs((tmp_path / name,), (tmp_path,))
    check_outputs((tmp_path / 'camera.yaml', tmp_path / 'new.html'), (tmp_path,))


def test_a_failure_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / 'a.txt'
    path.write_text('old')

    def full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(output_files.os, 'fsync', full)
    with pytest.raises(InputError, match='No space left'):
        atomic_write(path, 'new')
    assert path.read_text() == 'old' and len(list(tmp_path.iterdir())) == 1


def test_check_writable_leaves_no_trace(tmp_path):
    assert check_writable(tmp_path / 'a.txt') == tmp_path / 'a.txt'
    assert list(tmp_path.iterdir()) == []


def refused(path):
    """Return the sentence with which both functions refuse the path."""
    with pytest.raises(InputError) as first:
        check_writable(path)
    with pytest.raises(InputError) as second:
        atomic_write(path, 'x')
    assert str(first.value) == str(second.value) and str(first.value).endswith('.')
    return str(first.value)


def test_places_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / 'file').write_text('x')
    assert 'is a folder' in refused(tmp_path)
    assert 'not a folder' in refused(tmp_path / 'file' / 'a.txt')
    assert 'does not exist' in refused(tmp_path / 'missing' / 'a.txt')
    assert 'cannot be written' in refused('a\0b')
    assert 'cannot be written' in refused(tmp_path / ('x' * 300))
    monkeypatch.chdir(tmp_path)
    assert check_writable('bare.txt') == Path('bare.txt')


@pytest.mark.skipif(not Path('/proc/self').is_dir(), reason='there is no /proc here')
def test_a_folder_that_refuses_new_files():
    assert 'refuses new files' in refused('/proc/camera.yaml')


def test_a_read_only_folder(tmp_path):
    tmp_path.chmod(0o500)
    try:
        if os.access(tmp_path, os.W_OK):
            pytest.skip('this user may write anywhere')
        assert 'refuses new files' in refused(tmp_path / 'a.txt')
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize('name', ['overlay.mp4', 'overlay.avi'])
def test_a_video_that_the_disk_has_no_room_for_is_none(tmp_path, name):
    resource = pytest.importorskip('resource')
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    image = np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8)
    with OverlayVideo(tmp_path / name) as video:
        for _ in range(30):
            video.add(image)
    size = (tmp_path / name).stat().st_size
    (tmp_path / name).unlink()
    with pytest.raises(InputError, match='disk may be full'):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size * 2 // 3, before[1]))
        try:
            with OverlayVideo(tmp_path / name) as video:
                for _ in range(30):
                    video.add(image)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())
