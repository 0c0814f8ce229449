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
Decode jpeg, png and other image files, wary of damaged and absurd ones.

OpenCV decodes a truncated jpeg without an error and fills the rest with grey, and a few bytes can
announce gigapixels; both are found here before it decodes.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from selfcal_ros.errors import InputError

#: Larger images than this are refused as absurd: 268 million pixels.
MAX_PIXELS = 2 ** 28
_PNG = b'\x89PNG\r\n\x1a\n'


def decode_file(data: Any, colour: bool = False) -> np.ndarray:
    """
    Decode an image file.

    The pixels come in the order of the sensor: an orientation in the EXIF data is not applied,
    because the calibration of a camera belongs to its sensor.

    Parameters
    ----------
    data : bytes or ndarray of uint8
    colour : bool
        Return bgr, of images that have colours.

    Returns
    -------
    ndarray of uint8 or uint16, shape (H, W) or (H, W, 3)

    Raises
    ------
    InputError
        If the data are damaged, truncated, no image, or neither 8 nor 16 bits deep.

    """
    raw = np.frombuffer(data, np.uint8) if not isinstance(data, np.ndarray) else data
    content = raw.tobytes()
    if not content:
        raise InputError('The image is empty (0 bytes).')
    if content.startswith(_PNG):
        size, complete = _png(content)
    elif content.startswith(b'\xff\xd8'):
        size, complete = _jpeg(content)
    else:
        size, complete = None, True
    if not complete:
        raise InputError('The image is truncated: its end is missing.')
    if size is not None and not 0 < size[0] * size[1] <= MAX_PIXELS:
        raise InputError(f'The image announces {size[0]} x {size[1]} pixels, which is impossible.')
    flags = cv2.IMREAD_ANYCOLOR if colour else cv2.IMREAD_GRAYSCALE
    try:
        image = cv2.imdecode(raw, flags | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    except (cv2.error, MemoryError):
        image = None
    if image is None or image.size == 0:
        raise InputError('The image cannot be decoded: it is damaged, or no jpeg, png, bmp, tiff '
                         'or pgm image.')
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f'Images of type {image.dtype} are not supported; use 8 or 16 bits.')
    return image


def _png(content: bytes) -> tuple[tuple[int, int] | None, bool]:
    """Return the announced size and whether the end is there."""
    if len(content) < 24:
        return None, False
    size = int.from_bytes(content[16:20], 'big'), int.from_bytes(content[20:24], 'big')
    return size, content.rfind(b'IEND') > 0


def _jpeg(content: bytes) -> tuple[tuple[int, int] | None, bool]:
    """Return the announced size and whether the end is there."""
    size, at = None, 2
    while at + 4 <= len(content):
        if content[at] != 0xff:
            return size, True   # damaged; the decoder decides
        marker = content[at + 1]
        if marker == 0xff:
            at += 1
            continue
        length = int.from_bytes(content[at + 2:at + 4], 'big')
        if 0xc0 <= marker <= 0xcf and marker not in (0xc4, 0xc8, 0xcc):
            frame = content[at + 5:at + 9]
            if len(frame) < 4:
                return size, False
            size = int.from_bytes(frame[2:], 'big'), int.from_bytes(frame[:2], 'big')
        if marker == 0xda:
            # within the coded data 0xff is followed by 0 or a restart marker
            return size, content.find(b'\xff\xd9', at + 2 + length) > 0
        at += 2 + max(length, 2)
    return size, False
