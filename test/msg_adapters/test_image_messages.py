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
"""Every image encoding against truth built by hand."""

import cv2
from msg_adapters.image import (compressed_image_message, image_message, image_to_bgr,
                                image_to_grey, ImageDecoder, SUPPORTED_ENCODINGS)
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError

HEIGHT, WIDTH = 12, 16


def build(types, header, encoding, rows, big_endian=False, padding=0, **changed):
    """Build a message from rows of bytes (H, row)."""
    rows = np.asarray(rows, np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    fields = {'header': header, 'height': len(rows), 'width': WIDTH, 'encoding': encoding,
              'is_bigendian': int(big_endian), 'step': rows.shape[1], 'data': rows.ravel()}
    return types.Image(**{**fields, **changed})


def ramp():
    """Return a smooth bgr image with three different channels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([10 + 5 * x, 200 - 6 * y, 40 + 3 * x + 4 * y], axis=-1).astype(np.uint8)


def luma(bgr):
    """BT.601 in exact arithmetic."""
    return bgr @ np.array([0.114, 0.587, 0.299])


@pytest.mark.parametrize('padding', [0, 5])
@pytest.mark.parametrize('encoding', ['mono8', '8UC1'])
def test_mono8_is_exact(types, header, encoding, padding):
    truth = ramp()[..., 0]
    msg = build(types, header, encoding, truth, padding=padding)
    grey = image_to_grey(msg)
    assert (grey == truth).all() and grey.dtype == np.uint8
    assert grey.flags.writeable and grey.flags.c_contiguous
    assert (image_to_bgr(msg) == truth[..., None]).all()


@pytest.mark.parametrize('padding', [0, 7])
@pytest.mark.parametrize('encoding', ['rgb8', 'bgr8', 'rgba8', 'bgra8', '8UC3', '8UC4'])
def test_colour(types, header, encoding, padding):
    bgr = ramp()
    order = {'rgb8': [2, 1, 0], 'bgr8': [0, 1, 2], 'rgba8': [2, 1, 0, 3], 'bgra8': [0, 1, 2, 3],
             '8UC3': [0, 1, 2], '8UC4': [0, 1, 2, 3]}[encoding]
    samples = np.dstack([bgr, np.full((HEIGHT, WIDTH), 7, np.uint8)])[..., order]
    msg = build(types, header, encoding, samples.reshape(HEIGHT, -1), padding=padding)
    assert (image_to_bgr(msg) == bgr).all()
    assert np.abs(image_to_grey(msg) - luma(bgr)).max() <= 1


@pytest.mark.parametrize('big_endian', [False, True])
@pytest.mark.parametrize('bits', [10, 12, 14, 16])
@pytest.mark.parametrize('encoding', ['mono16', '16UC1'])
def test_sixteen_bits_scale_by_the_depth(types, header, encoding, bits, big_endian):
    full = (1 << bits) - 1
    truth = np.linspace(0, full, HEIGHT * WIDTH).round().astype(np.uint16).reshape(HEIGHT, WIDTH)
    rows = truth.astype('>u2' if big_endian else '<u2').view(np.uint8)
    msg = build(types, header, encoding, rows, big_endian, padding=4)
    assert np.abs(image_to_grey(msg) - truth / full * 255).max() <= 0.5


@pytest.mark.parametrize('big_endian', [False, True])
@pytest.mark.parametrize('encoding', ['rgb16', 'bgr16', 'rgba16', 'bgra16', '16UC3', '16UC4'])
def test_sixteen_bit_colour(types, header, encoding, big_endian):
    bgr = ramp()
    order = [2, 1, 0] if encoding.startswith('rgb') else [0, 1, 2]
    order += [3] if 'a' in encoding or encoding.endswith('4') else []
    samples = np.dstack([bgr.astype(np.uint16) * 257, np.full((HEIGHT, WIDTH), 9)])[..., order]
    rows = samples.astype('>u2' if big_endian else '<u2').reshape(HEIGHT, -1).view(np.uint8)
    msg = build(types, header, encoding, rows, big_endian)
    assert (image_to_bgr(msg) == bgr).all()
    assert np.abs(image_to_grey(msg) - luma(bgr)).max() <= 1


@pytest.mark.parametrize('bits', [8, 16])
@pytest.mark.parametrize('pattern', ['rggb', 'bggr', 'gbrg', 'grbg'])
def test_bayer(types, header, pattern, bits):
    # linear ramps: demosaicing restores them exactly away from the border
    bgr = ramp()
    channel = np.array(['bgr'.index(c) for c in pattern]).reshape(2, 2)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    mosaic = np.take_along_axis(bgr, channel[y % 2, x % 2][..., None], axis=2)[..., 0]
    rows = mosaic if bits == 8 else (mosaic.astype('<u2') * 257).view(np.uint8)
    msg = build(types, header, f'bayer_{pattern}{bits}', rows)
    inner = (slice(2, -2), slice(2, -2))
    assert np.abs(image_to_bgr(msg)[inner].astype(int) - bgr[inner]).max() <= 1
    assert np.abs(image_to_grey(msg)[inner] - luma(bgr)[inner]).max() <= 1.5


@pytest.mark.parametrize('padding', [0, 6])
@pytest.mark.parametrize('encoding', ['yuv422', 'uyvy', 'yuv422_yuy2', 'yuyv'])
def test_yuv422(types, header, encoding, padding):
    y = ramp()[..., 0] + np.uint8(10)
    u, v = np.full((HEIGHT, WIDTH // 2), 90), np.full((HEIGHT, WIDTH // 2), 240)
    chroma = np.stack([u, v], axis=-1).reshape(HEIGHT, WIDTH)
    pair = (chroma, y) if encoding in ('yuv422', 'uyvy') else (y, chroma)
    msg = build(types, header, encoding, np.stack(pair, axis=-1).reshape(HEIGHT, -1),
                padding=padding)
    assert (image_to_grey(msg) == y).all()
    # BT.601, limited range
    c, d, e = 1.164 * (y.astype(float) - 16), 90 - 128, 240 - 128
    bgr = np.stack([c + 2.017 * d, c - 0.392 * d - 0.813 * e, c + 1.596 * e], axis=-1)
    assert np.abs(image_to_bgr(msg) - bgr.clip(0, 255)).max() <= 2


@pytest.mark.parametrize('padding', [0, 6])
@pytest.mark.parametrize('encoding', ['nv12', 'nv21'])
def test_two_planes(types, header, encoding, padding):
    y = ramp()[..., 0] + np.uint8(10)
    chroma = np.full((HEIGHT // 2, WIDTH // 2, 2), (90, 240) if encoding == 'nv12' else (240, 90))
    rows = np.concatenate([y, chroma.reshape(HEIGHT // 2, WIDTH)])
    msg = build(types, header, encoding, rows, padding=padding, height=HEIGHT)
    assert (image_to_grey(msg) == y).all()
    # BT.601, limited range
    c, d, e = 1.164 * (y.astype(float) - 16), 90 - 128, 240 - 128
    bgr = np.stack([c + 2.017 * d, c - 0.392 * d - 0.813 * e, c + 1.596 * e], axis=-1)
    assert np.abs(image_to_bgr(msg) - bgr.clip(0, 255)).max() <= 2
    with pytest.raises(ArgumentError, match='is no nv12 image'):
        image_message(y, header, types, 'nv12')


def test_all_supported_encodings_were_meant():
    tested = {'8UC', '16UC'}   # without channels: one
    tested |= {f'{n}UC{c}' for n in (8, 16) for c in (1, 3, 4)}
    tested |= {f'{o}{n}' for o in ('mono', 'rgb', 'bgr', 'rgba', 'bgra') for n in (8, 16)}
    tested |= {f'bayer_{p}{n}' for p in ('rggb', 'bggr', 'gbrg', 'grbg') for n in (8, 16)}
    tested |= {'yuv422', 'uyvy', 'yuv422_yuy2', 'yuyv', 'nv12', 'nv21'}
    assert tested == set(SUPPORTED_ENCODINGS)


def test_the_depth_of_a_stream_only_grows(types, header):
    def message(value):
        rows = np.full((HEIGHT, WIDTH), value, '<u2').view(np.uint8)
        return build(types, header, 'mono16', rows)

    decoder = ImageDecoder()
    assert decoder.grey(message(4095))[0, 0] == 255 and decoder.depth_bits == 12
    # a dark frame keeps the scale of the stream
    assert decoder.grey(message(100))[0, 0] == round(100 / 4095 * 255)
    assert decoder.grey(message(65535))[0, 0] == 255 and decoder.depth_bits == 16


@pytest.mark.parametrize('encoding', ['mono16', '16UC1'])
def test_a_thermal_camera_keeps_its_contrast(types, header, encoding):
    """Twenty kelvins of 655: by the depth all of it would be eight grey levels."""
    scene = np.linspace(29000, 31000, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)

    def shown(decoder, kelvins):
        values = (scene + 100 * kelvins).round().astype('<u2').view(np.uint8)
        return decoder.grey(build(types, header, encoding, values)).astype(float)

    decoder = ImageDecoder()
    first = shown(decoder, 0)
    assert np.ptp(first) > 150
    # warmer by a kelvin: brighter, in the same scale
    assert abs(np.median(shown(decoder, 1) - first) - np.ptp(first) / 20) < 1.5
    # much warmer: all is shown, and stays in that scale
    warmer = shown(decoder, 15)
    assert 80 < np.ptp(warmer) < np.ptp(first) and warmer.max() < 255
    assert np.median(shown(decoder, 0)) < np.median(first)


def test_colours_of_sixteen_bits_are_scaled_by_the_depth_alone(types, header):
    samples = np.dstack([np.linspace(500, 900, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)] * 3)
    rows = samples.round().astype('<u2').reshape(HEIGHT, -1).view(np.uint8)
    grey = image_to_grey(build(types, header, 'bgr16', rows))
    assert np.abs(grey - samples[..., 0] / 1023 * 255).max() <= 1


@pytest.mark.parametrize('encoding, dtype, shape', [
    ('mono8', np.uint8, (5, 7)), ('bgr8', np.uint8, (5, 7, 3)), ('bgra8', np.uint8, (5, 7, 4)),
    ('mono16', np.uint16, (5, 7)), ('bgr16', np.uint16, (5, 7, 3))])
def test_array_to_message(types, header, encoding, dtype, shape):
    image = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape, dtype, True)
    # a view that is not contiguous must not matter
    msg = image_message(np.repeat(image, 2, axis=1)[:, ::2], header, types)
    assert (msg.encoding, msg.height, msg.width) == (encoding, 5, 7)
    assert msg.step * 5 == len(msg.data) == image.nbytes
    assert bytes(msg.data) == image.tobytes()
    assert msg.header.stamp.nanosec == 123_456_789


def test_array_that_fits_no_message(types, header):
    for image in (np.zeros((4, 4)), np.zeros((4, 4, 2), np.uint8), np.zeros((0, 4), np.uint8)):
        with pytest.raises(ArgumentError):
            image_message(image, header, types)
    with pytest.raises(ArgumentError, match='bgr8'):
        image_message(np.zeros((4, 4), np.uint8), header, types, encoding='bgr8')


@pytest.mark.parametrize('codec, tolerance', [('png', 0), ('jpeg', 3)])
def test_compressed(types, header, codec, tolerance):
    bgr = ramp()
    msg = compressed_image_message(bgr, header, types, codec=codec)
    assert np.abs(image_to_bgr(msg).astype(int) - bgr).max() <= tolerance * 5
    assert np.abs(image_to_grey(msg) - luma(bgr)).max() <= max(tolerance, 1)
    grey = compressed_image_message(bgr[..., 0], header, types, codec=codec)
    assert np.abs(image_to_grey(grey).astype(int) - bgr[..., 0]).max() <= tolerance
    with pytest.raises(ArgumentError):
        compressed_image_message(bgr, header, types, codec='webp')


def test_compressed_sixteen_bits(types, header):
    truth = np.linspace(0, 4095, HEIGHT * WIDTH).astype(np.uint16).reshape(HEIGHT, WIDTH)
    data = cv2.imencode('.png', truth)[1].ravel()
    msg = types.CompressedImage(header=header, format='', data=data)
    assert np.abs(image_to_grey(msg) - truth / 4095 * 255).max() <= 0.5


@pytest.mark.parametrize('codec', ['.jpg', '.png'])
def test_damaged_compressed(types, header, codec):
    noise = np.random.default_rng(2).integers(0, 255, (64, 64), np.uint8)
    good = cv2.imencode(codec, noise)[1].ravel()

    def message(data):
        return types.CompressedImage(header=header, format='x', data=data)

    assert image_to_grey(message(good)).shape == (64, 64)
    for size in (0, 1, 3, 10, 25, 100, good.size // 2, good.size - 10):
        with pytest.raises(InputError):
            image_to_grey(message(good[:size]))
    with pytest.raises(InputError):
        image_to_grey(message(np.arange(100, dtype=np.uint8)))


def test_an_absurd_png_is_refused_before_it_is_decoded(types, header):
    png = cv2.imencode('.png', np.zeros((4, 4), np.uint8))[1].ravel()
    png[16:24] = np.frombuffer((30000).to_bytes(4, 'big') * 2, np.uint8)
    with pytest.raises(InputError, match='30000 x 30000'):
        image_to_grey(types.CompressedImage(header=header, format='png', data=png))


@pytest.mark.parametrize('changed, words', [
    ({'encoding': '32FC1'}, 'supported are .*mono8'),
    ({'encoding': ''}, 'supported are'),
    ({'encoding': 'a' * 5000}, 'supported are'),
    ({'step': WIDTH - 1}, 'step'),
    ({'step': 0}, 'step'),
    ({'step': 2 ** 32 - 1}, 'truncated'),
    ({'height': HEIGHT + 1}, 'truncated'),
    ({'height': 0}, 'impossible'),
    ({'width': 0}, 'impossible'),
    ({'height': 2 ** 32 - 1, 'width': 2 ** 32 - 1}, 'impossible'),
    ({'data': np.zeros(0, np.uint8)}, 'truncated'),
    ({'encoding': 'mono16'}, 'step'),
    ({'encoding': 'uyvy', 'width': 7}, 'even'),
    ({'encoding': 'nv12', 'height': HEIGHT - 1}, 'even width and height'),
    ({'encoding': 'nv21'}, 'truncated'),
    ({'encoding': 'bayer_rggb8', 'height': 2}, 'too small'),
])
def test_hostile_messages(types, header, changed, words):
    msg = build(types, header, rows=np.zeros((HEIGHT, WIDTH)), **{'encoding': 'mono8', **changed})
    with pytest.raises(InputError, match=words) as caught:
        image_to_grey(msg)
    assert len(str(caught.value)) < 900 and str(caught.value).endswith('.')


def test_small_images_and_a_last_row_without_padding(types, header):
    one = types.Image(header=header, height=1, width=1, encoding='mono8', step=1, data=b'\x2a')
    assert image_to_grey(one).tolist() == [[42]]
    rows = np.arange(4 * 10, dtype=np.uint8).reshape(4, 10)
    msg = types.Image(header=header, height=4, width=8, encoding='mono8', step=10,
                      data=rows.ravel()[:-2])
    assert (image_to_grey(msg) == rows[:, :8]).all()
