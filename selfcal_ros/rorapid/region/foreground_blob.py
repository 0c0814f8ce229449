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
What stands out from a plain background: where an object may be that was never seen.

The background is a smooth surface of grey levels through the border of the image. What differs
from it in one piece stands out. A background full of things is no such surface, and nothing is
said.
"""

from __future__ import annotations

import cv2
import numpy as np

from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.rorapid.region.background_change import closed, pieces_of

#: Width of the border, share of the smaller side; rounds of the fit, and what is left out of it.
_BORDER, _ROUNDS, _LEAVE_OUT = 0.06, 4, 3.0
#: A pixel differs by so many robust sigmas, and grey levels at the least. A background that leaves
#: more grey levels than this is not plain.
_SIGMAS, _LEAST, _PLAIN = 6.0, 6.0, 6.0
#: The surface is fitted on every so many pixels.
_STEP = 4


def foreground_blobs(image: np.ndarray) -> list[np.ndarray]:
    """
    Find what stands out from a plain background.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8

    Returns
    -------
    list of ndarray, shape (H, W), uint8
        Masks (255) of the largest pieces, none of which touches the border of the image, and
        without holes.

    """
    height, width = image.shape
    wide = max(2, int(_BORDER * min(height, width)))
    y, x = np.mgrid[:height:_STEP, :width:_STEP]
    border = (x < wide) | (y < wide) | (x >= width - wide) | (y >= height - wide)
    grey = image[::_STEP, ::_STEP][border].astype(float)
    terms = _terms(x, y, width, height)
    weight = np.ones(len(grey))
    scatter = 0.0
    for _ in range(_ROUNDS):
        surface = np.linalg.lstsq(terms[border] * weight[:, None], grey * weight, rcond=None)[0]
        left = np.abs(grey - terms[border] @ surface)
        scatter = robust_sigma(left)
        weight = (left <= _LEAVE_OUT * max(scatter, 1.0)).astype(float)
    if scatter > _PLAIN:
        return []
    plain = cv2.resize((terms @ surface).astype(np.float32), (width, height))
    differs: np.ndarray = (np.abs(image - plain) > max(_LEAST, _SIGMAS * scatter)).astype(np.uint8)
    return [_filled(piece) for piece in pieces_of(closed(differs))]


def _terms(x: np.ndarray, y: np.ndarray, width: int, height: int) -> np.ndarray:
    """Second-order terms of places in an image, (..., 6)."""
    u, v = 2 * x / width - 1, 2 * y / height - 1
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


def _filled(mask: np.ndarray) -> np.ndarray:
    """Fill the holes: a side of the object may be as grey as the background."""
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(mask, outlines, -1, 255, cv2.FILLED)
