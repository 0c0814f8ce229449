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
The grey in which an object differs most from what is around it.

A yellow part before a skin-coloured one has no edge in the usual grey. Of all weighted sums of the
three colours, Fisher's linear discriminant has the largest difference between object and
surroundings, in parts of their scatter. It takes the place of the usual grey where it is clearly
better; every other step is the same.
"""

from __future__ import annotations

import cv2
import numpy as np

#: Weights of blue, green and red in the usual grey (ITU-R BT.601).
_USUAL = np.array([0.114, 0.587, 0.299])
#: Pixels so near the outline belong to neither side; the surroundings reach so far.
_MIXED_PX, _FAR_PX = 3, 18
#: Least pixels on each side.
_LEAST = 50
#: Noise of a colour, grey levels.
_NOISE = 5.0
#: Squared difference over scatter, at the least, and over that of the usual grey. Weights stay
#: while they reach this share of the best: what was learned in them stays true.
_TELLS, _BETTER, _STAYS = 1.0, 2.0, 0.7


class ObjectColour:
    """The weights of the three colours; the usual ones until others are learned."""

    def __init__(self) -> None:
        """Start with the usual grey."""
        self._weights = _USUAL

    def forget(self) -> None:
        """Go back to the usual grey."""
        self._weights = _USUAL

    def grey(self, image: np.ndarray) -> np.ndarray:
        """
        Return an image in one grey.

        Parameters
        ----------
        image : ndarray, shape (H, W) or (H, W, 3), uint8
            Grey or BGR.

        Returns
        -------
        ndarray, shape (H, W), uint8

        """
        if image.ndim == 2:
            return np.ascontiguousarray(image)
        if self._weights is _USUAL:
            return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        # sums from below 0 to above 255 are laid out over the range of a byte
        low = np.minimum(self._weights, 0).sum()
        return cv2.transform(image, np.append(self._weights, -255 * low)[None])

    def learn(self, image: np.ndarray, mask: np.ndarray) -> None:
        """
        Find the weights that tell an object from its surroundings.

        Parameters
        ----------
        image : ndarray, shape (H, W) or (H, W, 3), uint8
            Nothing is learned from a grey one.
        mask : ndarray, shape (H, W), uint8
            Not 0 where the object is, roughly.

        """
        if image.ndim == 2:
            return
        x, y, width, height = cv2.boundingRect(mask)
        part = np.s_[max(y - _FAR_PX, 0):y + height + _FAR_PX,
                     max(x - _FAR_PX, 0):x + width + _FAR_PX]
        mask, colours = mask[part], image[part]
        inside = cv2.erode(mask, _disc(_MIXED_PX)) > 0
        around = (cv2.dilate(mask, _disc(_FAR_PX)) > 0) & ~(cv2.dilate(
            mask, _disc(_MIXED_PX)) > 0)
        if min(np.count_nonzero(inside), np.count_nonzero(around)) < _LEAST:
            return
        one, other = (colours[side].astype(float) for side in (inside, around))
        difference = one.mean(axis=0) - other.mean(axis=0)
        scatter = np.cov(one.T) + np.cov(other.T) + _NOISE**2 * np.eye(3)

        def tells(weights: np.ndarray) -> float:
            return float((weights @ difference)**2 / (weights @ scatter @ weights))

        best = np.linalg.solve(scatter, difference)
        if tells(best) < max(_TELLS, _BETTER * tells(_USUAL)):
            self._weights = _USUAL
        elif tells(self._weights) < _STAYS * tells(best):
            self._weights = best / np.abs(best).sum()


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
