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
"""Images as small JPEGs, so that a page stays one that can be sent."""

from __future__ import annotations

import cv2
import numpy as np

#: Qualities that are tried until a picture is small enough.
QUALITIES = (80, 65, 50, 35)
#: Below this an image shows nothing any more, pixels.
LEAST_SIDE_PX = 160


def small_jpeg(image: np.ndarray, longer_side_px: int, most_bytes: int) -> bytes:
    """
    Reduce and compress an image until it fits.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W) or (H, W, 3)
    longer_side_px : int
        The image is reduced to this, never enlarged.
    most_bytes : int

    Returns
    -------
    bytes
        Empty if the image cannot be compressed.

    """
    image = reduced(image, longer_side_px)
    for quality in QUALITIES:
        done, data = cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if not done:
            return b''
        if data.size <= most_bytes:
            return data.tobytes()
    if longer_side_px <= LEAST_SIDE_PX:
        return data.tobytes()
    # noise does not compress
    return small_jpeg(image, max(longer_side_px * 2 // 3, LEAST_SIDE_PX), most_bytes)


def reduced(image: np.ndarray, longer_side_px: int) -> np.ndarray:
    """Reduce an image to a length of its longer side; a smaller one stays as it is."""
    scale = longer_side_px / max(image.shape[:2])
    if scale >= 1:
        return image
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
