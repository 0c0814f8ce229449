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
sensor_msgs/Image and CompressedImage to arrays and back, without cv_bridge.

Grey is the luma of ITU-R BT.601: of colours by OpenCV's weights, of YUV the Y as it was sent, of
Bayer patterns by demosaicing. 16-bit images are scaled by the depth of the sensor: the smallest
of 10, 12, 14 and 16 bits that holds their values, since cameras send 10- and 12-bit values in
16-bit words. `ImageDecoder` keeps this depth over a stream (it can only grow), so that the
brightness does not flicker from frame to frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
from msg_adapters.encoded import decode_file
from msg_adapters.message_types import Message, MessageTypes
import numpy as np
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.values.image_headers import MAX_PIXELS


@dataclass(frozen=True)
class _Layout:
    """How an encoding lays out a pixel."""

    dtype: str
    channels: int
    order: str


_BAYER = ('rggb', 'bggr', 'gbrg', 'grbg')


def _layouts() -> dict[str, Any]:
    table = {'yuv422': _Layout('u1', 2, 'uyvy'), 'uyvy': _Layout('u1', 2, 'uyvy'),
             'yuv422_yuy2': _Layout('u1', 2, 'yuyv'), 'yuyv': _Layout('u1', 2, 'yuyv'),
             'nv12': _Layout('u1', 1, 'nv12'), 'nv21': _Layout('u1', 1, 'nv21')}
    for bits, dtype in ((8, 'u1'), (16, 'u2')):
        table[f'mono{bits}'] = _Layout(dtype, 1, 'mono')
        for order in ('rgb', 'bgr', 'rgba', 'bgra'):
            table[f'{order}{bits}'] = _Layout(dtype, len(order), order)
        for order in _BAYER:
            table[f'bayer_{order}{bits}'] = _Layout(dtype, 1, order)
        # OpenCV's type names carry no colour order; ROS tools take them as bgr
        for channels, order in ((1, 'mono'), (3, 'bgr'), (4, 'bgra')):
            table[f'{bits}UC{channels}'] = _Layout(dtype, channels, order)
    table['8UC'] = table['8UC1']
    table['16UC'] = table['16UC1']
    return table


_LAYOUTS = _layouts()
#: Rows of Y are followed by half as many of both colours.
_TWO_PLANES = ('nv12', 'nv21')
#: Encodings of sensor_msgs/Image that can be read.
SUPPORTED_ENCODINGS = tuple(sorted(_LAYOUTS))

# OpenCV names a Bayer pattern by its second row, ROS by its first
_TO_GREY = {
    'rgb': cv2.COLOR_RGB2GRAY, 'bgr': cv2.COLOR_BGR2GRAY,
    'rgba': cv2.COLOR_RGBA2GRAY, 'bgra': cv2.COLOR_BGRA2GRAY,
    'rggb': cv2.COLOR_BayerBG2GRAY, 'bggr': cv2.COLOR_BayerRG2GRAY,
    'gbrg': cv2.COLOR_BayerGR2GRAY, 'grbg': cv2.COLOR_BayerGB2GRAY,
}
_TO_BGR = {
    'mono': cv2.COLOR_GRAY2BGR, 'rgb': cv2.COLOR_RGB2BGR,
    'rgba': cv2.COLOR_RGBA2BGR, 'bgra': cv2.COLOR_BGRA2BGR,
    'rggb': cv2.COLOR_BayerBG2BGR, 'bggr': cv2.COLOR_BayerRG2BGR,
    'gbrg': cv2.COLOR_BayerGR2BGR, 'grbg': cv2.COLOR_BayerGB2BGR,
    'uyvy': cv2.COLOR_YUV2BGR_UYVY, 'yuyv': cv2.COLOR_YUV2BGR_YUY2,
    'nv12': cv2.COLOR_YUV2BGR_NV12, 'nv21': cv2.COLOR_YUV2BGR_NV21,
}


#: Percentiles of an image that are its range, and rows or columns that are enough for them.
_USUAL, _SAMPLED = (0.2, 99.8), 128
#: What is added to either end of a range, as a share of it; it counts as so many values at least.
_ROOM, _LEAST_RANGE = 0.2, 64


def is_compressed(msg: Message) -> bool:
    """Tell a CompressedImage from an Image."""
    return hasattr(msg, 'format') and not hasattr(msg, 'encoding')


class ImageDecoder:
    """
    Decodes the images of one stream, Image and CompressedImage alike.

    Images of 16 bits are scaled to 8 by their depth. Those without colour are scaled by their
    range where that is less than half of it: a thermal camera may use a fortieth of its depth.

    Attributes
    ----------
    depth_bits : int
        Depth of the 16-bit images so far: 0 (none seen), 10, 12, 14 or 16. It only grows.
    range : (int, int), optional
        Values of 16-bit images without colour that are shown as 0 and 255; None before there is
        one. It only grows.

    """

    def __init__(self) -> None:
        self.depth_bits = 0
        self.range: tuple[int, int] | None = None

    def grey(self, msg: Message) -> np.ndarray:
        """
        Return the image in grey, shape (H, W), uint8, C-contiguous and writable.

        Raises
        ------
        InputError
            If the message contradicts itself or its encoding is not supported.

        """
        samples, order = _pixels(msg, colour=False)
        return self._eight_bits(_convert(samples, order, False), order == 'mono')

    def bgr(self, msg: Message) -> np.ndarray:
        """
        Return the image in colour, shape (H, W, 3), uint8, OpenCV's channel order.

        Raises
        ------
        InputError
            If the message contradicts itself or its encoding is not supported.

        """
        samples, order = _pixels(msg, colour=True)
        return self._eight_bits(_convert(samples, order, True), order == 'mono')

    def colour(self, msg: Message) -> np.ndarray | None:
        """Return what `bgr` does, or None where the image has no colours."""
        samples, order = _pixels(msg, colour=True)
        return None if order == 'mono' else self._eight_bits(_convert(samples, order, True), False)

    def file_grey(self, data: bytes) -> np.ndarray:
        """Return an encoded image file (jpeg, png, ...) in grey, shape (H, W), uint8."""
        return self._eight_bits(decode_file(data, colour=False), True)

    def file_colour(self, data: bytes) -> np.ndarray | None:
        """Return an encoded image file in bgr, (H, W, 3), uint8; None if it has no colours."""
        image = decode_file(data, colour=True)
        return None if image.ndim == 2 else self._eight_bits(image, False)

    def _eight_bits(self, image: np.ndarray, is_mono: bool) -> np.ndarray:
        """Scale 16 bits to 8 by the depth or the range of the stream."""
        if image.dtype == np.uint8:
            return image
        needed = int(image.max()).bit_length()
        self.depth_bits = max(self.depth_bits,
                              next(bits for bits in (10, 12, 14, 16) if needed <= bits))
        low, high = 0, (1 << self.depth_bits) - 1
        if is_mono:
            low, high = self.range = self._range_with(image)
        # to 255, rounded to nearest
        table = np.arange(1 << self.depth_bits, dtype=np.int64).clip(low, high) - low
        table = (table * 510 + high - low) // (2 * (high - low))
        shown: np.ndarray = table.astype(np.uint8)[image]
        return shown

    def _range_with(self, image: np.ndarray) -> tuple[int, int]:
        """Return what is to be shown, once an image of 16 bits is counted."""
        full = (1 << self.depth_bits) - 1
        step = max(min(image.shape[:2]) // _SAMPLED, 1)
        usual = np.percentile(image[::step, ::step], _USUAL)
        low, high = self.range or usual
        if self.range is None or usual[0] < low or usual[1] > high:
            # some room, lest the scale change at every image
            room = _ROOM * max(float(np.ptp(usual)), _LEAST_RANGE)
            low, high = min(low, usual[0] - room), max(high, usual[1] + room)
        if high - low > full / 2:
            return 0, full
        return max(int(low), 0), min(int(np.ceil(high)), full)


def depth_metres(msg: Message) -> np.ndarray:
    """
    Decode a depth image.

    Parameters
    ----------
    msg : sensor_msgs/Image
        16UC1 (or mono16), millimetres, or 32FC1, metres: REP 118.

    Returns
    -------
    ndarray of float32, shape (H, W)
        Metres; 0 or NaN where there is no depth.

    Raises
    ------
    InputError
        If it is of another encoding, or its size or data are wrong.

    """
    encoding = str(getattr(msg, 'encoding', 'compressed')).strip()
    if encoding not in ('16UC1', '16UC', 'mono16', '32FC1', '32FC'):
        raise InputError(f'A depth image must be 16UC1 (millimetres) or 32FC1 (metres), not '
                         f'{encoding!r:.40}.')
    if encoding.startswith('32'):
        height, width, step = int(msg.height), int(msg.width), int(msg.step)
        data = _bytes_of(msg.data)
        if (height <= 0 or width <= 0 or height * width > MAX_PIXELS or step < 4 * width
                or data.size < step * (height - 1) + 4 * width):
            raise InputError(f'The depth image says {width} x {height} pixels with step {step}, '
                             f'and holds {data.size} bytes; check what publishes it.')
        rows = np.lib.stride_tricks.as_strided(data, (height, 4 * width), (
            step * data.strides[0], data.strides[0]))
        kind = '>f4' if msg.is_bigendian else '<f4'
        return np.ascontiguousarray(rows).view(kind).astype(np.float32)
    samples, _ = _pixels(msg, False)
    return samples.astype(np.float32) * np.float32(1e-3)


def image_to_grey(msg: Message) -> np.ndarray:
    """Return one Image or CompressedImage in grey; see `ImageDecoder.grey`."""
    return ImageDecoder().grey(msg)


def image_to_bgr(msg: Message) -> np.ndarray:
    """Return one Image or CompressedImage in colour; see `ImageDecoder.bgr`."""
    return ImageDecoder().bgr(msg)


def _bytes_of(data: Any) -> np.ndarray:
    """View the data of a message as bytes."""
    try:
        if isinstance(data, (list, tuple, np.ndarray)):
            view = np.ascontiguousarray(data, dtype=np.uint8).ravel()
            # a plain cast would wrap other numbers around
            if isinstance(data, np.ndarray) and data.dtype != np.uint8:
                raise TypeError(data.dtype)
            return view
        return np.frombuffer(data, np.uint8) if len(data) else np.zeros(0, np.uint8)
    except (OverflowError, TypeError, ValueError, BufferError):
        raise InputError('The data of the image message are not bytes.') from None


def _pixels(msg: Message, colour: bool) -> tuple[np.ndarray, str]:
    """Return the samples (H, W) or (H, W, C), native byte order, and the channel order."""
    if is_compressed(msg):
        image = decode_file(_bytes_of(msg.data), colour)
        return image, 'bgr' if image.ndim == 3 else 'mono'
    encoding = str(msg.encoding).strip()
    layout = _LAYOUTS.get(encoding)
    if layout is None:
        raise InputError(f'The image encoding {encoding!r:.40} is not supported; supported are '
                         f'{", ".join(SUPPORTED_ENCODINGS)}.')
    height, width, step = int(msg.height), int(msg.width), int(msg.step)
    if height <= 0 or width <= 0 or height * width > MAX_PIXELS:
        raise InputError(f'An image of {width} x {height} pixels is impossible; check what '
                         'publishes it.')
    if layout.order in ('uyvy', 'yuyv') and width % 2:
        raise InputError(f'A {encoding} image must have an even width, not {width}.')
    if layout.order in _TWO_PLANES:
        if width % 2 or height % 2:
            raise InputError(f'A {encoding} image must have an even width and height, not {width} '
                             f'x {height}.')
        height = height * 3 // 2
    if layout.order in _BAYER and min(height, width) < 3:
        raise InputError(f'A Bayer image of {width} x {height} pixels is too small to decode.')
    data = _bytes_of(msg.data)
    row = width * layout.channels * int(layout.dtype[1])
    if step < row:
        raise InputError(f'The image says step {step}, but a row of {width} {encoding} pixels '
                         f'takes {row} bytes; check what publishes it.')
    # some drivers leave out the padding of the last row
    if data.size < step * (height - 1) + row:
        raise InputError(f'The image holds {data.size} bytes, but {width} x {msg.height} '
                         f'{encoding} with step {step} takes {step * height}; the message is '
                         'truncated.')
    rows = np.lib.stride_tricks.as_strided(data, (height, row), (step * data.strides[0],
                                                                 data.strides[0]))
    samples = np.ascontiguousarray(rows)
    if layout.dtype == 'u2':
        samples = samples.view('>u2' if msg.is_bigendian else '<u2').astype(np.uint16)
    shape = (height, width) if layout.channels == 1 else (height, width, layout.channels)
    samples = samples.reshape(shape)
    # rclpy and rosbags hand out views of the message; the caller owns what it gets
    return samples.copy() if np.may_share_memory(samples, data) else samples, layout.order


def _convert(samples: np.ndarray, order: str, colour: bool) -> np.ndarray:
    """Convert samples of the given channel order to grey or bgr of the same depth."""
    if not colour and order in ('uyvy', 'yuyv'):
        return np.ascontiguousarray(samples[..., 1 if order == 'uyvy' else 0])
    if not colour and order in _TWO_PLANES:
        return np.ascontiguousarray(samples[:len(samples) * 2 // 3])
    code = (_TO_BGR if colour else _TO_GREY).get(order)
    return samples if code is None else cv2.cvtColor(samples, code)


def image_message(image: np.ndarray, header: Message, types: MessageTypes,
                  encoding: str | None = None) -> Message:
    """
    Build a sensor_msgs/Image, rows without padding, little endian.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (H, W) or (H, W, C)
    header : std_msgs/Header
    types : MessageTypes
    encoding : str, optional
        By default mono8, mono16, bgr8, bgr16, bgra8 or bgra16, whichever fits the array.

    Raises
    ------
    ArgumentError
        If the array does not fit the encoding.

    """
    image = np.asarray(image)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    channels = image.shape[2] if image.ndim == 3 else 1
    bits = {'uint8': 8, 'uint16': 16}.get(image.dtype.name)
    if encoding is None:
        name = {1: 'mono', 3: 'bgr', 4: 'bgra'}.get(channels)
        encoding = f'{name}{bits}'
    layout = _LAYOUTS.get(encoding)
    if image.ndim not in (2, 3) or 0 in image.shape or layout is None or \
            layout.order in _TWO_PLANES or \
            layout.channels != channels or bits != 8 * int(layout.dtype[1]):
        raise ArgumentError(f'An array of shape {image.shape} and type {image.dtype} is no '
                            f'{encoding} image.')
    image = np.ascontiguousarray(image, dtype='<' + layout.dtype)
    height, width = image.shape[:2]
    return types.Image(header=header, height=height, width=width, encoding=encoding,
                       is_bigendian=0, step=image.nbytes // height,
                       data=image.reshape(-1).view(np.uint8))


def compressed_image_message(image: np.ndarray, header: Message, types: MessageTypes,
                             codec: str = 'jpeg', quality: int = 95) -> Message:
    """
    Build a sensor_msgs/CompressedImage.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W) or (H, W, 3)
        Grey or bgr.
    header : std_msgs/Header
    types : MessageTypes
    codec : {'jpeg', 'png'}
    quality : int
        Of jpeg, 1 to 100.

    Raises
    ------
    ArgumentError
        If the codec is unknown or cannot hold the array.

    """
    image = np.asarray(image)
    if codec not in ('jpeg', 'png') or image.dtype != np.uint8 or image.size == 0 or not (
            image.ndim == 2 or image.ndim == 3 and image.shape[2] == 3):
        raise ArgumentError(f'A {codec!r} message of an array of shape {image.shape} and type '
                            f'{image.dtype} is not possible; use jpeg or png with uint8 grey or '
                            'bgr.')
    options = [cv2.IMWRITE_JPEG_QUALITY, int(quality)] if codec == 'jpeg' else []
    done, data = cv2.imencode('.jpg' if codec == 'jpeg' else '.png', image, options)
    if not done:
        raise ArgumentError(f'OpenCV could not encode an image of shape {image.shape} as {codec}.')
    kind = 'mono8' if image.ndim == 2 else 'bgr8'
    return types.CompressedImage(header=header, format=f'{kind}; {codec} compressed {kind}',
                                 data=data.ravel())
