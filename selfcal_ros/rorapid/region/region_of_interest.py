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
"""The part of an image around the object, without lens distortion."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera

#: The region of interest is halved until its longer side is shorter than this, pixels.
_MAX_ROI_PX = 320


@dataclass(frozen=True)
class Region:
    """
    Attributes of the part of the image around the object, at the scale of work.

    Attributes
    ----------
    image : ndarray, shape (h, w), uint8
    corner : ndarray, shape (2,)
        Pixel of the whole image at the centre of its first pixel.
    scale : float
        Pixels of the region per pixel of the image: 1, 1/2, 1/4 ...

    """

    image: np.ndarray
    corner: np.ndarray
    scale: float

    def halved(self) -> Region:
        """Return the same part at half the scale."""
        rows, columns = (side // 2 for side in self.image.shape)
        part = cv2.resize(self.image[:2 * rows, :2 * columns], (columns, rows),
                          interpolation=cv2.INTER_AREA)
        return Region(part, self.corner + 0.5 / self.scale, 0.5 * self.scale)

    def inside(self, pixels: np.ndarray) -> np.ndarray:
        """Map pixels of the image to pixels of the region."""
        reduced: np.ndarray = (pixels - self.corner) * self.scale
        return reduced

    def outside(self, pixels: np.ndarray) -> np.ndarray:
        """Map pixels of the region to pixels of the image."""
        whole: np.ndarray = pixels / self.scale + self.corner
        return whole


class Undistorter:
    """
    Takes the lens distortion out of parts of images.

    Parameters
    ----------
    camera : Camera

    Attributes
    ----------
    pinhole : Camera
        The camera of the undistorted parts: the same calibration matrix, no distortion.

    """

    def __init__(self, camera: Camera):
        """Wait for the size of the images."""
        self._camera = camera
        self.pinhole = Camera(camera.K, width=camera.width, height=camera.height)
        self._maps: list[np.ndarray] | None = None

    def part(self, image: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Cut rows and columns from low to high (x, y) out of the undistorted image."""
        if self._camera.is_pinhole:
            return image[low[1]:high[1], low[0]:high[0]]
        if self._maps is None or self._maps[0].shape != image.shape:
            x, y = np.meshgrid(np.arange(image.shape[1]), np.arange(image.shape[0]))
            place = self._camera.pixels(self.pinhole.normalised(np.stack([x, y], axis=-1)))
            self._maps = [np.ascontiguousarray(place[..., k], np.float32) for k in (0, 1)]
        x, y = (part[low[1]:high[1], low[0]:high[0]] for part in self._maps)
        return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def region_of_interest(image: np.ndarray, pixels: np.ndarray, margin_px: float, lens: Undistorter,
                       ) -> Region | None:
    """
    Cut the part of an image around given pixels, undistorted, and reduced while it is large.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8
    pixels : ndarray, shape (N, 2)
        Of the undistorted image.
    margin_px : float
    lens : Undistorter

    Returns
    -------
    Region or None
        None where it lies outside of the image.

    """
    height, width = image.shape
    low = np.floor(np.clip(pixels.min(axis=0) - margin_px, 0, (width, height))).astype(int)
    high = np.ceil(np.clip(pixels.max(axis=0) + margin_px, 0, (width, height))).astype(int)
    if (high - low).min() < 24:
        return None
    part, scale = lens.part(image, low, high), 1.0
    corner = low.astype(float)
    while max(part.shape) * scale > _MAX_ROI_PX:
        scale *= 0.5
    if scale < 1:
        step = int(round(1 / scale))
        rows, columns = (part.shape[0] // step) * step, (part.shape[1] // step) * step
        part = cv2.resize(part[:rows, :columns], (columns // step, rows // step),
                          interpolation=cv2.INTER_AREA)
        corner = corner + (step - 1) / 2
    return Region(np.ascontiguousarray(part), corner, scale)


def checked_image(image: ArrayLike, camera: Camera) -> np.ndarray:
    """
    Return an image, (H, W) or (H, W, 3) of uint8.

    Raises
    ------
    InputError
        If it is not of the camera's size, or neither grey nor BGR of 8 bits.

    """
    array: np.ndarray = np.asarray(image)
    if array.dtype != np.uint8 or array.ndim not in (2, 3) or (
            array.ndim == 3 and array.shape[2] != 3) or not array.size:
        raise InputError('The tracker takes grey or BGR images of 8 bits, not '
                         f'{array.dtype} of shape {array.shape}.')
    height, width = array.shape[:2]
    if camera.width and camera.height and (width, height) != (camera.width, camera.height):
        raise InputError(f'The image is {width}x{height} pixels, the camera '
                         f'{camera.width}x{camera.height}; they do not belong together.')
    return array
