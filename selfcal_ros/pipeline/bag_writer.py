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
"""Write images to a rosbag2 recording."""

from __future__ import annotations

from collections.abc import Iterable
import os
from pathlib import Path
import re
import shutil
import sqlite3
import tempfile

from msg_adapters.image import compressed_image_message, image_message
from msg_adapters.message_types import rosbags_types
from msg_adapters.stamps import header_message

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.pipeline.frame_source import Frame
from selfcal_ros.values.output_files import check_place, refused_by_folder

#: As rosbags names its plugins, but for the case.
_STORAGES = ('mcap', 'sqlite3')
_TOPIC = re.compile(r'^(/[A-Za-z_][A-Za-z0-9_]*)+$')


def write_image_bag(path: str | Path, frames: Iterable[Frame], topic: str = '/camera/image_raw',
                    storage: str = 'mcap', compressed: str | None = None,
                    frame_id: str = 'camera_optical_frame') -> int:
    """
    Write frames as a rosbag2 folder; it appears whole or not at all.

    Parameters
    ----------
    path : str or Path
        Folder to make; it must not exist.
    frames : iterable of Frame
        Their colour image is written where they have one, their grey image otherwise.
    topic : str
        Absolute topic name.
    storage : {'mcap', 'sqlite3'}
    compressed : {'jpeg', 'png'}, optional
        Write sensor_msgs/CompressedImage to <topic>/compressed instead of sensor_msgs/Image.
    frame_id : str
        For frames that do not name their coordinate frame.

    Returns
    -------
    int
        Number of images written.

    Raises
    ------
    InputError
        If the folder exists or cannot be made, or there are no frames.
    ArgumentError
        If the topic, storage or compression is impossible.

    """
    path = Path(path)
    _check(path, topic, storage, compressed)
    check_place(path)
    parent = path.absolute().parent
    try:
        # the files inside carry the name of the folder, so it must be the final one
        temporary = tempfile.mkdtemp(prefix='.selfcal-', dir=parent)
    except OSError as error:
        raise refused_by_folder(path, parent, error) from None
    try:
        inside = Path(temporary) / path.name
        count = _write(inside, frames, topic, storage, compressed, frame_id)
        if not count:
            raise InputError(f'There are no images to write to {path}.')
        os.replace(inside, path)
    except (OSError, sqlite3.Error) as error:
        why = getattr(error, 'strerror', None) or error
        raise InputError(f'{path} cannot be written: {why}.') from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return count


def _check(path: Path, topic: str, storage: str, compressed: str | None) -> None:
    """Refuse what cannot be written, before any frame is read."""
    if storage not in _STORAGES:
        raise ArgumentError(f'Storage {storage!r} is unknown; choose mcap or sqlite3.')
    if compressed not in (None, 'jpeg', 'png'):
        raise ArgumentError(f'Compression {compressed!r} is unknown; choose jpeg or png.')
    if not _TOPIC.match(topic):
        raise ArgumentError(f'{topic!r} is no absolute topic name; write it like '
                            '/camera/image_raw.')
    if storage == 'sqlite3' and set(str(path.absolute())) & set('?#%'):
        raise ArgumentError(f'SQLite takes the characters ?, # and % in {path} for parts of an '
                            'address; choose another name, or the storage mcap.')
    if path.exists():
        raise InputError(f'{path} exists already; remove it or choose another name.')


def _write(folder: Path, frames: Iterable[Frame], topic: str, storage: str,
           compressed: str | None, frame_id: str) -> int:
    """Write frames into a folder that does not exist; returns how many."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
    store = get_typestore(Stores.ROS2_JAZZY)
    types = rosbags_types(store)
    kind = 'sensor_msgs/msg/CompressedImage' if compressed else 'sensor_msgs/msg/Image'
    count = 0
    with Writer(folder, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        connection = writer.add_connection(f'{topic}/compressed' if compressed else topic,
                                           kind, typestore=store)
        for frame in frames:
            if frame.stamp_ns < 0 and storage == 'mcap':
                raise InputError(f'{frame.name or "An image"} has a stamp before 1970, which MCAP '
                                 'cannot hold; choose --storage sqlite3.')
            header = header_message(frame.stamp_ns, frame.frame_id or frame_id, types)
            image = frame.image if frame.bgr is None else frame.bgr
            if compressed:
                message = compressed_image_message(image, header, types, compressed)
            else:
                message = image_message(image, header, types)
            writer.write(connection, frame.stamp_ns, store.serialize_cdr(message, kind))
            count += 1
    return count
