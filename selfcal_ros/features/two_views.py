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
Images that hold two views: a stereo camera that puts one beside the other, or above it.

No camera sees so, and no motion explains it. Two things tell. What one half shows is found in the
other, moved along the rows. And the image has a seam in its middle.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from selfcal_ros.features.first_images import FirstImages

#: Images of a recording that are asked, and how many lie from one to the next: an edge that
#: happens to be in the middle moves on.
IMAGES_ASKED, IMAGES_APART = 3, 10
#: Width to which a half is reduced, and side of the patches that are looked for, pixels.
_WIDTH, _SIDE = 256, 24
#: Standard deviation of a patch that is worth looking for, grey levels.
_TEXTURE = 6.0
#: How far a patch may lie from where it was, as shares of width and height of a half. The cameras
#: of both packings stand beside each other.
_ALONG, _ACROSS = 0.3, 0.05
#: Correlation of a patch that is found again, and the share of patches that must be.
_ALIKE, _SHARE = 0.85, 0.5
#: Patches in an image that say anything.
_LEAST_PATCHES = 12
#: How much more grey levels differ across a seam than between its neighbours.
_SEAM = 2.5
#: Lines on either side that a seam is held against.
_NEIGHBOURS = 8


def two_views(images: Sequence[np.ndarray]) -> str | None:
    """
    Tell whether every image holds two views of the same scene.

    Parameters
    ----------
    images : sequence of ndarray of uint8, shape (H, W)
        Some of a recording.

    Returns
    -------
    {'left and right', 'top and bottom'} or None
        The halves; None where some image is one view, or shows too little.

    """
    if images and all(map(_beside_each_other, images)):
        return 'left and right'
    return 'top and bottom' if images and all(map(_above_each_other, images)) else None


class TwoViewsWatch:
    """Asks some of the first images of a stream whether they hold two views."""

    def __init__(self) -> None:
        """Start before the first image."""
        self._first = FirstImages(IMAGES_ASKED, IMAGES_APART)

    def see(self, image: np.ndarray) -> str | None:
        """Take the next image; returns what `two_views` does, once, where there are two."""
        return two_views(self._first.take(image))


def _beside_each_other(image: np.ndarray) -> bool:
    """Tell whether the left and the right half are views of one scene, with a seam between."""
    middle = image.shape[1] // 2
    return (_has_seam(image, middle)
            and _found_share(image[:, :middle], image[:, -middle:]) > _SHARE)


def _above_each_other(image: np.ndarray) -> bool:
    """Tell whether the top and the bottom half are views of one scene, with a seam between."""
    middle = image.shape[0] // 2
    return (_has_seam(image.T, middle)
            and _found_share(image[:middle], image[-middle:]) > _SHARE)


def _has_seam(image: np.ndarray, middle: int) -> bool:
    """Tell whether grey levels differ more across the middle column than beside it."""
    if middle < _NEIGHBOURS:
        return False
    beside = image[:, middle - _NEIGHBOURS:middle + _NEIGHBOURS].astype(np.float32)
    steps = np.abs(np.diff(beside, axis=1)).mean(axis=0)
    across = steps[_NEIGHBOURS - 1]
    return bool(across > _SEAM * max(np.median(steps), 1.0))


def _found_share(half: np.ndarray, other: np.ndarray) -> float:
    """Share of the patches of a half that the other has at about the same height."""
    size = _WIDTH, int(np.clip(_WIDTH * half.shape[0] / half.shape[1], 2 * _SIDE, 2 * _WIDTH))
    half, other = (cv2.resize(np.ascontiguousarray(one), size, interpolation=cv2.INTER_AREA)
                   for one in (half, other))
    along, across = round(_ALONG * size[0]), max(round(_ACROSS * size[1]), 2)
    found = []
    for y in range(0, size[1] - _SIDE + 1, _SIDE):
        for x in range(0, size[0] - _SIDE + 1, _SIDE):
            patch = half[y:y + _SIDE, x:x + _SIDE]
            if patch.std() < _TEXTURE:
                continue
            rows = slice(max(y - across, 0), y + _SIDE + across)
            columns = slice(max(x - along, 0), x + _SIDE + along)
            found.append(cv2.matchTemplate(other[rows, columns], patch,
                                           cv2.TM_CCOEFF_NORMED).max() > _ALIKE)
    return float(np.mean(found)) if len(found) >= _LEAST_PATCHES else 0.0
