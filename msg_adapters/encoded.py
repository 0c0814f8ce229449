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
announce gigapixels; both are found in the header before it decodes.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from selfcal_ros.errors import DamagedImage, InputError
from selfcal_ros.values.image_headers import check_image


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
    check_image(data if isinstance(data, bytes) else raw.tobytes())
    flags = cv2.IMREAD_ANYCOLOR if colour else cv2.IMREAD_GRAYSCALE
    try:
        image = cv2.imdecode(raw, flags | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    except (cv2.error, MemoryError):
        image = None
    if image is None or image.size == 0:
        raise DamagedImage('The image cannot be decoded: it is damaged, or no jpeg, png, bmp, '
                           'tiff, webp or pgm image.')
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f'Images of type {image.dtype} are not supported; use 8 or 16 bits.')
    return image
