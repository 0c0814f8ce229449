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
What cameras, drivers and weather do to images: each function takes all images of a recording.

Where that moves the true camera, `true_matrix` follows. Images are grey, uint8, shape (480, 640).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from selfcal_ros.synthetic.render import quantise

#: Rows of black above and below a letterboxed image.
BORDER = 60


def as_they_are(images, rng):
    """Change nothing."""
    return images


def compressed(images, rng, quality):
    """Compress as JPEG."""
    return [cv2.imdecode(cv2.imencode('.jpg', one, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 0)
            for one in images]


def noisy(images, rng, sigma):
    """Add noise of a high gain."""
    return [quantise(one, rng, sigma) for one in images]


def shaken(images, rng, longest_px):
    """Blur each image along a direction of its own."""
    shown = []
    for one in images:
        length, angle = rng.uniform(1, longest_px), rng.uniform(0, np.pi)
        kernel = np.zeros((21, 21), np.float32)
        for along in np.linspace(-length / 2, length / 2, 41):
            x, y = 10 + along * np.cos(angle), 10 + along * np.sin(angle)
            i, j = int(x), int(y)
            weights = np.outer([j + 1 - y, y - j], [i + 1 - x, x - i])
            kernel[j:j + 2, i:i + 2] += weights
        shown.append(cv2.filter2D(one, -1, kernel / kernel.sum()))
    return shown


def flickering(images, rng):
    """Change exposure and gamma from image to image."""
    return [quantise(255 * (one / 255)**rng.uniform(0.6, 1.6) * rng.uniform(0.6, 1.5), rng, 0.5)
            for one in images]


def sharpened(images, rng):
    """Sharpen as a webcam does."""
    return [cv2.addWeighted(one, 2.5, cv2.GaussianBlur(one, (0, 0), 1.5), -1.5, 0)
            for one in images]


def equalised(images, rng):
    """Raise the contrast locally."""
    local = cv2.createCLAHE(4, (8, 8))
    return [local.apply(one) for one in images]


def enlarged(images, rng):
    """Enlarge images of half the size."""
    size = images[0].shape[::-1]
    half = size[0] // 2, size[1] // 2
    return [cv2.resize(cv2.resize(one, half, interpolation=cv2.INTER_AREA), size)
            for one in images]


def demosaiced(images, rng):
    """See through a Bayer pattern, under warm light."""
    gain = np.ones(images[0].shape)
    gain[::2, ::2], gain[1::2, 1::2] = 0.7, 0.8
    shown = []
    for one in images:
        colour = cv2.cvtColor(quantise(one * gain, rng, 1.0), cv2.COLOR_BayerBG2BGR).astype(float)
        colour /= [0.8, 1, 0.7]
        shown.append(cv2.cvtColor(colour.clip(0, 255).astype(np.uint8), cv2.COLOR_BGR2GRAY))
    return shown


def dark(images, rng):
    """Use an eighth of the grey levels."""
    return [cv2.convertScaleAbs(one, alpha=0.12, beta=3) for one in images]


def by_a_lamp(images, rng):
    """Light the scene by a lamp on the robot, at night."""
    y, x = np.mgrid[:images[0].shape[0], :images[0].shape[1]]
    light = np.exp(-((x - 320)**2 + (y - 330)**2) / (2 * 150**2))
    return [quantise(one * light, rng, 3.0) for one in images]


def thermal(images, rng):
    """See ten kelvins in 16 bits, a hundredth of a kelvin each, while it gets warmer."""
    return [(29300 + (one / 255 - 0.5) * 1000 + 300 * k / len(images)
             + rng.normal(0, 5, one.shape)).round().astype(np.uint16)
            for k, one in enumerate(images)]


def interlaced(images, rng):
    """Take the odd rows from the next image."""
    shown = [one.copy() for one in images[:-1]]
    for one, following in zip(shown, images[1:]):
        one[1::2] = following[1::2]
    return shown


def letterboxed(images, rng):
    """Put black above and below."""
    return [cv2.copyMakeBorder(one, BORDER, BORDER, 0, 0, cv2.BORDER_CONSTANT) for one in images]


def with_body(images, rng):
    """See a part of the robot's own body."""
    texture = cv2.resize(rng.uniform(20, 160, (48, 24)).astype(np.float32),
                         images[0].shape[::-1], interpolation=cv2.INTER_NEAREST)
    hidden = np.zeros(images[0].shape, np.uint8)
    cv2.fillPoly(hidden, [np.array([[60, 480], [130, 372], [510, 366], [590, 480]])], 1)
    return [quantise(np.where(hidden, texture, one), rng, 1.0) for one in images]


def with_display(images, rng):
    """Write the time and a mark into the images."""
    shown = []
    for k, one in enumerate(images):
        one = cv2.rectangle(one.copy(), (0, 452), (330, 479), 0, -1)
        cv2.putText(one, f'2026-11-28 12:{k // 60:02d}:{k % 60:02d}.{37 * k % 100:02d}',
                    (6, 472), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 1, cv2.LINE_AA)
        shown.append(cv2.drawMarker(one, (320, 240), 255, cv2.MARKER_CROSS, 40))
    return shown


def through_drops(images, rng):
    """See through drops of rain on the lens."""
    y, x = np.mgrid[:images[0].shape[0], :images[0].shape[1]].astype(np.float32)
    seen = np.stack([x, y])
    for middle, radius in zip(rng.uniform(0, [[640], [480]], (2, 14)).T, rng.uniform(12, 45, 14)):
        middle = middle[:, None, None].astype(np.float32)
        inside = np.hypot(*(np.stack([x, y]) - middle)) < radius
        seen = np.where(inside, middle - 1.5 * (np.stack([x, y]) - middle), seen)
    return [cv2.remap(one, seen[0], seen[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
            for one in images]


def with_person(images, rng):
    """Let somebody walk through, again and again."""
    texture = cv2.resize(rng.uniform(10, 245, (24, 10)).astype(np.float32), (130, 330),
                         interpolation=cv2.INTER_NEAREST)
    shown = []
    for k, one in enumerate(images):
        one, at = one.copy(), int(-60 + 700 * (1.7 * k / len(images) % 1))
        first, last = max(at, 0), min(at + 130, one.shape[1])
        if last > first:
            one[120:450, first:last] = texture[:, first - at:last - at]
        shown.append(quantise(one, rng, 1.0))
    return shown


def stabilised(images, rng, sigma_px):
    """Shift each image by itself."""
    shifts = rng.normal(0, sigma_px, (len(images), 2))
    return [cv2.warpAffine(one, np.column_stack([np.eye(2), shift]), one.shape[::-1],
                           flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
            for one, shift in zip(images, shifts)]


def mirrored(images, rng):
    """See by a mirror."""
    return [np.ascontiguousarray(one[:, ::-1]) for one in images]


def partly_lost(images, rng):
    """Lose a sixth of the images to black or white."""
    shown = [one.copy() for one in images]
    for k in rng.choice(len(shown), len(shown) // 6, replace=False):
        shown[k][:] = rng.choice([0, 255])
    return shown


TROUBLES: dict[str, Callable] = {
    'none': as_they_are, 'JPEG, quality 25': partial(compressed, quality=25),
    'JPEG, quality 10': partial(compressed, quality=10),
    'noise of 8 grey levels': partial(noisy, sigma=8.0),
    'shaken by up to 5 px': partial(shaken, longest_px=5.0),
    'exposure flickers': flickering, 'sharpened': sharpened, 'local contrast': equalised,
    'enlarged from half the size': enlarged, 'Bayer pattern': demosaiced,
    'an eighth of the grey levels': dark, 'by a lamp at night': by_a_lamp,
    'thermal, 16 bits': thermal, 'interlaced': interlaced, 'letterboxed': letterboxed,
    'own body in view': with_body, 'time written in': with_display,
    'drops on the lens': through_drops, 'somebody walks by': with_person,
    'mirrored': mirrored, 'a sixth lost': partly_lost,
    'stabilised by 4 px': partial(stabilised, sigma_px=4.0)}


def true_matrix(name: str, K: np.ndarray, width: int) -> np.ndarray:
    """Return the calibration matrix of the images with a trouble."""
    K = K.copy()
    if name == 'letterboxed':
        K[1, 2] += BORDER
    if name == 'mirrored':
        K[0, 2] = width - 1 - K[0, 2]
    return K
