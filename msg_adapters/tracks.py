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
Tracks to sensor_msgs/PointCloud2 and back: one message an image, with the image's header.

A point of the cloud has the fields

    x, y                        float32   pixels, (0, 0) at the centre of the top-left pixel
    id                          uint32    identity of the scene point
    image_width, image_height   uint16    size of the image, the same in every point

16 bytes in all. A float32 is off by at most 0.00013 px at 4000 px. The size travels with the
points so that a calibrator needs no other topic; a message without points does not tell it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from msg_adapters.clouds import cloud_message, cloud_records
from msg_adapters.message_types import Message, MessageTypes
from msg_adapters.stamps import stamp_ns

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.values.tracks import LARGEST_PX, Tracks

#: The size travels as 16 bits a side.
LARGEST_SIDE_PX = 2 ** 16 - 1
_POINT = np.dtype([('x', '<f4'), ('y', '<f4'), ('id', '<u4'), ('image_width', '<u2'),
                   ('image_height', '<u2')])


@dataclass(frozen=True)
class FrameTracks:
    """
    The points that are seen in one image.

    Attributes
    ----------
    track : ndarray of int, shape (N,)
        Identity of each scene point.
    xy : ndarray, shape (N, 2)
        Pixels.
    image_size : (int, int) or None
        Width and height; None where the message does not tell.
    stamp_ns : int
        Acquisition time.
    frame_id : str
        Coordinate frame of the camera.

    """

    track: np.ndarray
    xy: np.ndarray
    image_size: tuple[int, int] | None
    stamp_ns: int = 0
    frame_id: str = ''


def tracks_message(track: ArrayLike, xy: ArrayLike, image_size: tuple[int, int], header: Message,
                   types: MessageTypes) -> Message:
    """
    Build the PointCloud2 of one image.

    Parameters
    ----------
    track : array_like of int, shape (N,)
        From 0 to 2^32 - 1.
    xy : array_like, shape (N, 2)
        Pixels.
    image_size : (int, int)
        Width and height.
    header : std_msgs/Header
        That of the image.
    types : MessageTypes

    Raises
    ------
    ArgumentError
        If the shapes differ, or a value is not finite or out of range.

    """
    track, xy = np.asarray(track).ravel(), np.asarray(xy, float).reshape(-1, 2)
    if len(track) != len(xy) or not np.isfinite(xy).all():
        raise ArgumentError(f'Tracks need as many finite points as identities; got {len(track)} '
                            f'identities and {len(xy)} points.')
    if len(track) and not (track.dtype.kind in 'ui' and track.min() >= 0
                           and track.max() < 2 ** 32):
        raise ArgumentError('The identity of a track must be an integer from 0 to 2^32 - 1.')
    if not all(0 < int(size) <= LARGEST_SIDE_PX for size in image_size):
        raise ArgumentError(f'The image size must be positive and at most {LARGEST_SIDE_PX}, not '
                            f'{image_size}.')
    records = np.zeros(len(track), _POINT)
    records['x'], records['y'], records['id'] = xy[:, 0], xy[:, 1], track
    records['image_width'], records['image_height'] = image_size
    return cloud_message(records, header, types)


def tracks_from_message(msg: Message) -> FrameTracks:
    """
    Read the PointCloud2 of one image.

    Raises
    ------
    InputError
        If the cloud has no x, y and id, or an identity occurs twice. If a position is not finite
        or on no image, or the size is none that images have.

    """
    records = cloud_records(msg, ('x', 'y', 'id'), ('image_width', 'image_height'))
    xy = np.column_stack([records['x'], records['y']]).astype(float)
    if not np.isfinite(xy).all():
        bad = int(np.flatnonzero(~np.isfinite(xy).all(axis=1))[0])
        raise InputError(f'Point {bad} of the tracks message is not finite; check what publishes '
                         'it.')
    far = np.abs(xy).max(axis=1, initial=0) > LARGEST_PX
    if far.any():
        bad = int(np.argmax(far))
        raise InputError(f'Point {bad} of the tracks message is {np.abs(xy[bad]).max():.3g} '
                         'pixels off the image; check what publishes it.')
    if records['id'].dtype.kind not in 'ui':
        raise InputError('The field id of a tracks message must be an integer.')
    track = records['id'].astype(np.int64)
    if len(np.unique(track)) < len(track):
        raise InputError('A track occurs twice in one tracks message; check what publishes it.')
    return FrameTracks(track, xy, _image_size(records), stamp_ns(msg.header.stamp),
                       str(msg.header.frame_id))


def _image_size(records: np.ndarray) -> tuple[int, int] | None:
    """Return width and height, if points tell them; InputError where these are of no image."""
    if not len(records) or not {'image_width', 'image_height'} <= set(records.dtype.names or ()):
        return None
    widths, heights = records['image_width'], records['image_height']
    if widths.dtype.kind not in 'ui' or heights.dtype.kind not in 'ui':
        raise InputError('The fields image_width and image_height of a tracks message must be '
                         'integers.')
    size = int(widths[0]), int(heights[0])
    if (widths != size[0]).any() or (heights != size[1]).any():
        raise InputError('The points of a tracks message disagree on the image size.')
    if not 0 < min(size) <= max(size) <= LARGEST_PX:
        raise InputError(f'The image size of a tracks message cannot be {size[0]} x {size[1]}; '
                         'check what publishes it.')
    return size


def collect_tracks(frames: Iterable[FrameTracks], first_index: int = 0) -> Tracks:
    """
    Put the messages of a stream together; their count is the frame index.

    Raises
    ------
    InputError
        If the image size changes.

    """
    frames = list(frames)
    sizes = {frame.image_size for frame in frames if frame.image_size is not None}
    if len(sizes) > 1:
        raise InputError(f'The image size changes within the tracks: {sorted(sizes)}.')
    if not frames:
        return Tracks(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))
    index = np.arange(first_index, first_index + len(frames))
    return Tracks(np.repeat(index, [len(frame.track) for frame in frames]),
                  np.concatenate([frame.track for frame in frames]),
                  np.concatenate([frame.xy for frame in frames]),
                  sizes.pop() if sizes else None,
                  {int(i): frame.stamp_ns for i, frame in zip(index, frames)})
