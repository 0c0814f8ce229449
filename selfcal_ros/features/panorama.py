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
Panoramas: images that go all the way round, so that their left and right edges meet.

No camera matrix describes them. What stands at one edge goes on at the other, detail by detail.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

#: Width of a panorama over its height, at least.
_WIDE = 1.5
#: Details are what a blur of so many rows takes away, and differ by so many grey levels at least.
_BLUR_ROWS, _LEAST_DETAIL = 8.0, 2.0
#: Correlation of the details at both edges.
_MEETS = 0.6


def are_panoramas(images: Sequence[np.ndarray]) -> bool:
    """
    Tell whether the left and right edges of every image (H, W), uint8, meet.

    Of some images of a recording; false where there are none.
    """
    return bool(images) and all(map(_goes_round, images))


def _goes_round(image: np.ndarray) -> bool:
    """Tell whether what stands at the left edge goes on at the right one."""
    height, width = image.shape
    if width < _WIDE * height:
        return False
    left, right = _details(image[:, :2]), _details(image[:, -2:])
    size = left.std() * right.std()
    return bool(min(left.std(), right.std()) > _LEAST_DETAIL
                and np.mean((left - left.mean()) * (right - right.mean())) > _MEETS * size)


def _details(columns: np.ndarray) -> np.ndarray:
    """Return the mean of some columns (H, k), less what varies slowly, without its ends."""
    mean = columns.mean(axis=1, dtype=np.float32)
    slow = cv2.GaussianBlur(mean[:, None], (0, 0), _BLUR_ROWS)[:, 0]
    end = min(round(3 * _BLUR_ROWS), len(mean) // 4)
    details: np.ndarray = (mean - slow)[end:len(mean) - end]
    return details
