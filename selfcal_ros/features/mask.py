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
"""Which pixels of an image may be used: white (not zero) is usable, as in OpenCV."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from selfcal_ros.errors import InputError
from selfcal_ros.values.foreign_files import read_limited
from selfcal_ros.values.image_headers import check_image

#: Half a patch of registration, and the pixel that smoothing reaches further.
PATCH_PX = 8.0
#: A blob of standard deviation 1 px is described and registered within so many pixels.
_BLOB_REACH = 4.0
#: Beyond that, patches are no larger; see `linking.refine`.
_LARGEST_REACH_PX = 32.0
#: A mask is two colours; no sensible one is longer.
_LARGEST_MASK_BYTES = 100_000_000
#: Of a photograph, more than this share is of so many greys, none nearly black or white.
_PHOTOGRAPH, _LEVELS, _NEARLY = 0.5, 32, 10
_JPEG = b'\xff\xd8'


class ImageMask:
    """
    The usable pixels of all images of a camera.

    Parameters
    ----------
    usable : ndarray, shape (H, W)
        Not zero where the image may be used.
    name : str
        What to call it before a user.

    Attributes
    ----------
    usable : ndarray of bool, shape (H, W)
    size : (int, int)
        Width and height in pixels.

    Raises
    ------
    InputError
        If no pixel is usable.

    """

    def __init__(self, usable: np.ndarray, name: str = 'The mask'):
        self.usable = np.asarray(usable) != 0
        self.name = name
        self.size = (self.usable.shape[1], self.usable.shape[0])
        if not self.usable.any():
            raise InputError(f'{name} is black all over, so no pixel may be used; paint what is '
                             'usable white.')
        # the chessboard distance: a square patch of this half side touches what is masked
        self._clear_px = np.full(self.usable.shape, np.inf, np.float32) if self.usable.all() \
            else cv2.distanceTransform(self.usable.astype(np.uint8), cv2.DIST_C, 3)

    def __and__(self, other: ImageMask | None) -> ImageMask:
        """Leave what both leave; None leaves all."""
        if other is None:
            return self
        other.check(self.usable.shape)
        return ImageMask(self.usable & other.usable, f'{self.name} with {other.name}')

    @property
    def share(self) -> float:
        """Share of the pixels that is usable."""
        return float(self.usable.mean())

    def check(self, shape: tuple[int, ...]) -> None:
        """
        Refuse images of another shape (H, W).

        Raises
        ------
        InputError
            If the size differs.

        """
        if shape[:2] != self.usable.shape:
            raise InputError(f'{self.name} is {self.size[0]}x{self.size[1]} pixels, but the '
                             f'images are {shape[1]}x{shape[0]}; make it as large as they are.')

    def inside(self, margin_px: float = PATCH_PX) -> np.ndarray:
        """Tell for every pixel whether a patch around it is usable, bool (H, W)."""
        inside: np.ndarray = self._clear_px > margin_px
        return inside

    def allows(self, xy: np.ndarray, margin_px: np.ndarray | float = PATCH_PX) -> np.ndarray:
        """
        Tell for points whether a patch around them is usable.

        Parameters
        ----------
        xy : ndarray, shape (N, 2)
            Pixels; what lies outside of the image is not usable.
        margin_px : float or ndarray, shape (N,)
            Half the side of the patch.

        Returns
        -------
        ndarray of bool, shape (N,)

        """
        at = np.round(xy).astype(int)
        within = ((at >= 0) & (at < self.size)).all(axis=1)
        column, row = np.clip(at, 0, np.array(self.size) - 1).T
        allowed: np.ndarray = within & (self._clear_px[row, column] > margin_px)
        return allowed

    def allows_blobs(self, xy: np.ndarray, size_px: np.ndarray) -> np.ndarray:
        """Tell the same for blobs of standard deviations size_px (N,): coarse ones reach far."""
        return self.allows(xy, np.clip(_BLOB_REACH * size_px, PATCH_PX, _LARGEST_REACH_PX))

    def painted(self, image: np.ndarray) -> np.ndarray:
        """Return a grey image (H, W) in which what is masked has the median grey value."""
        self.check(image.shape)
        painted = image.copy()
        painted[~self.usable] = np.median(image[self.usable])
        return painted


def read_mask(path: str | Path) -> ImageMask:
    """
    Read a mask from an image file.

    White is usable and black is not. What is neither is usable, too, except in a JPEG, whose
    black is never quite black: there it must be lighter than half.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    ImageMask

    Raises
    ------
    InputError
        If the file is no image, a photograph, or black all over.

    """
    data = read_limited(path, _LARGEST_MASK_BYTES, 'The mask')
    try:
        check_image(data)
        # in the orientation of the sensor, as the images are read; alpha does not matter
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR
                             | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    except (InputError, cv2.error, MemoryError):
        image = None
    if image is None:
        raise InputError(f'The mask {path} is no image that can be read; give a PNG that is white '
                         'where the camera image may be used, and black elsewhere.')
    brightest = image.max(axis=2)
    levels = brightest // (1 if image.dtype == np.uint8 else 256)
    grey = (levels > _NEARLY) & (levels < 255 - _NEARLY)
    if grey.mean() > _PHOTOGRAPH and len(np.unique(levels)) > _LEVELS:
        raise InputError(f'The mask {path} is a photograph; give a PNG that is white where the '
                         'camera image may be used, and black elsewhere.')
    return ImageMask(brightest > (127 if data.startswith(_JPEG) else 0), f'The mask {path}')
