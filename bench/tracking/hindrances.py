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
"""What gets in the way of a tracker: things drawn over the images of a recorded sequence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

#: The first images stay as they are: every tracker begins on a clean one.
CLEAN_IMAGES = 5
#: Where everything is hidden.
HIDDEN_FROM = 60
#: Period of the moving bar, images.
BAR_PERIOD = 80
#: Pickets of the fence, pixels: width and distance.
PICKET_PX, GAP_PX = 8, 24


@dataclass(frozen=True)
class Hindrance:
    """
    One way to make a sequence harder.

    Attributes
    ----------
    name : str
    apply : callable
        (image, number, box, rng) -> image; box is (left, top, right, bottom) of the object.
    every : int
        Only every so many images are shown.
    least : float
        Share of images within 5 px that is required; 0: none.
    visp : float or None
        What ViSP's edge tracker reaches with its example settings (measured elsewhere).

    """

    name: str
    apply: Callable
    every: int = 1
    least: float = 0.0
    visp: float | None = None


def _paint(image, left, top, right, bottom, seed):
    """Cover a rectangle with grey cloth: texture that is not the object's."""
    height, width = image.shape
    left, right = np.clip([round(left), round(right)], 0, width)
    top, bottom = np.clip([round(top), round(bottom)], 0, height)
    if right > left and bottom > top:
        cloth = np.random.default_rng(seed).normal(95, 25, (height, width)).astype(np.float32)
        cloth = 95 + 3 * (cv2.GaussianBlur(cloth, (0, 0), 2.5) - 95)
        image[top:bottom, left:right] = np.clip(cloth, 0, 255)[top:bottom, left:right]
    return image


def nothing(image, number, box, rng):
    """Leave the image as it is."""
    return image


def bar(share: float) -> Callable:
    """Return a bar from top to bottom over a share of the object, moving over it and back."""
    def apply(image, number, box, rng):
        if number < CLEAN_IMAGES:
            return image
        width = share * (box[2] - box[0])
        at = abs((number / BAR_PERIOD) % 2 - 1)
        left = box[0] + (1 - at) * (box[2] - box[0] - width)
        return _paint(image.copy(), left, 0, left + width, image.shape[0], 1)
    return apply


def lower_half(image, number, box, rng):
    """Hide the lower half of the object."""
    if number < CLEAN_IMAGES:
        return image
    return _paint(image.copy(), box[0] - 20, (box[1] + box[3]) / 2, box[2] + 20, box[3] + 20, 2)


def fence(image, number, box, rng):
    """Put a fence in front of everything."""
    if number < CLEAN_IMAGES:
        return image
    image = image.copy()
    for left in range(0, image.shape[1], GAP_PX):
        _paint(image, left, 0, left + PICKET_PX, image.shape[0], 3)
    return image


def all_hidden(count: int) -> Callable:
    """Return what hides the whole object in some images."""
    def apply(image, number, box, rng):
        if not HIDDEN_FROM <= number < HIDDEN_FROM + count:
            return image
        return _paint(image.copy(), box[0] - 30, box[1] - 30, box[2] + 30, box[3] + 30, 4)
    return apply


def noise(sigma: float) -> Callable:
    """Return what adds Gaussian noise."""
    def apply(image, number, box, rng):
        if number < CLEAN_IMAGES:
            return image
        return np.clip(np.rint(image + rng.normal(0, sigma, image.shape)), 0, 255).astype(np.uint8)
    return apply


def blur(sigma_px: float) -> Callable:
    """Return what takes the image out of focus."""
    return lambda image, number, box, rng: (
        image if number < CLEAN_IMAGES else cv2.GaussianBlur(image, (0, 0), sigma_px))


HINDRANCES = (
    Hindrance('clean', nothing, least=1.0),
    Hindrance('bar over 25 %', bar(0.25), least=0.9, visp=0.61),
    Hindrance('bar over 50 %', bar(0.5), least=0.9, visp=0.23),
    Hindrance('bar over 75 %', bar(0.75)),
    Hindrance('lower half hidden', lower_half, least=0.9, visp=0.26),
    Hindrance('fence', fence, visp=0.13),
    Hindrance('all hidden for 5 images', all_hidden(5), least=0.9, visp=0.35),
    Hindrance('all hidden for 15 images', all_hidden(15)),
    Hindrance('noise, sigma 15', noise(15.0)),
    Hindrance('blur, sigma 3 px', blur(3.0)),
    Hindrance('every 2nd image', nothing, 2),
    Hindrance('every 3rd image', nothing, 3, visp=0.83),
    Hindrance('every 4th image', nothing, 4, least=0.9, visp=0.25),
    Hindrance('every 6th image', nothing, 6, visp=0.23),
)
