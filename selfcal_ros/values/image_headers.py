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
What the header of an image file announces, looked at before anything is decoded.

A few bytes can announce gigapixels, for which a decoder takes the memory at once; and decoders
fill up with grey what is missing of a jpeg.
"""

from __future__ import annotations

import re

from selfcal_ros.errors import DamagedImage, InputError

#: Larger images than this are refused: 134 million pixels.
MAX_PIXELS = 2 ** 27
#: Nor is a file of one longer.
MAX_FILE_BYTES = 2 ** 28
#: No coding of images makes more pixels of a byte: deflate 1032, of eight pixels each in TIFF and
#: PNG of one bit; a jpeg of one colour comes to some 500.
_PIXELS_A_BYTE = 1032 * 8
#: What is announced within these is decoded whatever it is: a mask may be all of one colour.
_HARMLESS_PIXELS = 2 ** 22
_KINDS = 'jpeg, png, bmp, tiff, webp or pgm'
#: The tag by which a photograph says how it is to be turned; 1: not at all.
_ORIENTATION = 0x112
_PNG = b'\x89PNG\r\n\x1a\n'
_PNM = re.compile(rb'P([1-6])(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s')


def check_image(content: bytes) -> None:
    """
    Refuse what is no image, not whole, or announces more pixels than it can hold.

    Raises
    ------
    InputError
        With a sentence that begins with 'The image'; a DamagedImage where others may be whole.

    """
    if not content:
        raise DamagedImage('The image is empty (0 bytes).')
    whole = True
    if content.startswith(_PNG):
        size, whole = _png(content)
    elif content.startswith(b'\xff\xd8'):
        size, whole = _jpeg(content)
    elif content.startswith(b'BM'):
        size = _bmp(content)
    elif content.startswith((b'II*\0', b'MM\0*')):
        size = _tiff(content)
    elif content.startswith(b'RIFF') and content[8:12] == b'WEBP':
        # no webp is larger than 16383 x 16383, which its decoder knows
        size, whole = None, len(content) >= 8 + int.from_bytes(content[4:8], 'little')
    else:
        found = _PNM.match(content[:2000])
        if not found:
            raise DamagedImage('The image cannot be decoded: it is damaged, or no '
                               f'{_KINDS} image.')
        size = int(found[2]), int(found[3])
    if not whole:
        raise DamagedImage('The image is truncated: its end is missing.')
    if size is None:
        return
    pixels = size[0] * size[1]
    if not 0 < pixels <= MAX_PIXELS or min(size) < 0:
        raise InputError(f'The image announces {size[0]} x {size[1]} pixels, which is '
                         f'impossible; at most {MAX_PIXELS} may be.')
    if pixels > _HARMLESS_PIXELS and pixels > _PIXELS_A_BYTE * len(content):
        raise InputError(f'The image announces {size[0]} x {size[1]} pixels, which is '
                         f'impossible in {len(content)} bytes; it is damaged.')


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


def _bmp(content: bytes) -> tuple[int, int]:
    """Return the announced size; a negative height counts from the top."""
    if int.from_bytes(content[14:18], 'little') == 12:
        return (int.from_bytes(content[18:20], 'little'), int.from_bytes(content[20:22], 'little'))
    return (int.from_bytes(content[18:22], 'little', signed=True),
            abs(int.from_bytes(content[22:26], 'little', signed=True)))


def _tiff(content: bytes) -> tuple[int, int]:
    """Return the announced size of the first image; zeros where there is none."""
    found = _tiff_numbers(content, 256, 257)
    return found[256], found[257]


def _tiff_numbers(content: bytes, *tags: int) -> dict[int, int]:
    """Return what the first directory holds of some tags; zero of those that it lacks."""
    order = 'little' if content[:1] == b'I' else 'big'

    def number(at: int, count: int) -> int:
        return int.from_bytes(content[at:at + count], order)  # type: ignore[arg-type]

    found = dict.fromkeys(tags, 0)
    directory = number(4, 4)
    for entry in range(min(number(directory, 2), 1000)):
        at = directory + 2 + 12 * entry
        tag = number(at, 2)
        if tag in found:
            found[tag] = number(at + 8, 2 if number(at + 2, 2) == 3 else 4)
    return found


def is_turned(content: bytes) -> bool:
    """Tell whether a photograph says (in EXIF) that programs shall turn or mirror it."""
    at = 2 if content.startswith(b'\xff\xd8') else len(content)
    while content[at:at + 1] == b'\xff' and content[at + 1:at + 2] not in (b'\xda', b''):
        length = int.from_bytes(content[at + 2:at + 4], 'big')
        if content[at + 1] == 0xe1 and content[at + 4:at + 10] == b'Exif\0\0':
            return 2 <= _tiff_numbers(content[at + 10:at + 2 + length], _ORIENTATION
                                      )[_ORIENTATION] <= 8
        at += 2 + max(length, 2)
    return False
