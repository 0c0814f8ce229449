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
What comes into an empty scene: where a lost object may be, if the camera stands still.

While the object is lost the scene is remembered. What then differs from it in one piece has come
in. Where the camera moves everything differs, and nothing is said.
"""

from __future__ import annotations

import cv2
import numpy as np

from selfcal_ros.geometry.robust_scale import robust_sigma

#: Images of the scene before anything can be new; weight of a new image in the memory.
_IMAGES, _WEIGHT = 3, 0.05
#: A pixel differs by so many robust sigmas, and grey levels at the least. A noise of so many grey
#: levels is no noise: the camera moves.
_SIGMAS, _LEAST, _MOVING = 6.0, 5.0, 6.0
#: Size of a piece: pixels at the least, share of the image at the most; so many of them.
_SMALLEST_PX, _LARGEST, _PIECES = 150, 0.4, 2
#: Gaps that are closed, and specks that are taken away, pixels across.
_GAP, _SPECK = 7, 3


class BackgroundChange:
    """Remembers a scene without the object."""

    def __init__(self) -> None:
        """Start without a scene."""
        self.forget()

    def forget(self) -> None:
        """Forget the scene."""
        self._scene: np.ndarray | None = None
        self._images = 0

    def look(self, image: np.ndarray) -> list[np.ndarray]:
        """
        Compare an image with the scene, and take it in.

        Parameters
        ----------
        image : ndarray, shape (H, W), uint8

        Returns
        -------
        list of ndarray, shape (H, W), uint8
            Masks (255) of the largest pieces that are new, none of which touches the border.

        """
        if self._scene is None or self._scene.shape != image.shape:
            self._scene, self._images = image.astype(np.float32), 1
            return []
        change = cv2.absdiff(image, cv2.convertScaleAbs(self._scene))
        noise = robust_sigma(change[::2, ::2])
        if noise > _MOVING:
            self._scene, self._images = image.astype(np.float32), 1
            return []
        new: np.ndarray = (change > max(_LEAST, _SIGMAS * noise)).astype(np.uint8)
        weight = max(_WEIGHT, 1 / (self._images + 1))
        self._images += 1
        new = closed(new)
        cv2.accumulateWeighted(image, self._scene, weight, mask=1 - new)
        return [] if self._images <= _IMAGES else pieces_of(new)


def closed(mask: np.ndarray) -> np.ndarray:
    """Take specks away and close gaps, in a mask (H, W) of 0 and 1, uint8."""
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((_SPECK, _SPECK), np.uint8))
    return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((_GAP, _GAP), np.uint8))


def pieces_of(mask: np.ndarray) -> list[np.ndarray]:
    """
    Part a mask into its largest pieces.

    Parameters
    ----------
    mask : ndarray, shape (H, W), uint8
        0 and 1.

    Returns
    -------
    list of ndarray, shape (H, W), uint8
        Masks (255), none of which touches the border.

    """
    count, label, stats, _ = cv2.connectedComponentsWithStats(mask)
    left, top, width, height, area = stats[1:count].T
    good = (area > _SMALLEST_PX) & (area < _LARGEST * mask.size) & (left > 0) & (top > 0) & (
        left + width < mask.shape[1]) & (top + height < mask.shape[0])
    pieces = np.flatnonzero(good)
    pieces = pieces[np.argsort(-area[pieces])][:_PIECES]
    return [(label == piece + 1).astype(np.uint8) * 255 for piece in pieces]
