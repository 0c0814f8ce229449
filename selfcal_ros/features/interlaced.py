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
Interlaced images: the odd rows are of another instant than the even ones.

Analogue cameras send them so, and what digitises them puts both fields into one image. Where the
camera moves, rows then differ more from their neighbours than from those beyond.
"""

from __future__ import annotations

import numpy as np

#: How much more a row differs from the next than from the one beyond. Whatever is seen at once
#: has 0.5 to 0.7, and nothing but noise has 1.
_COMB = 1.1
#: Columns that are enough to tell.
_COLUMNS = 200
#: Grey levels by which rows differ at least: less is flat.
_LEAST = 0.5


def is_interlaced(image: np.ndarray) -> bool:
    """
    Tell whether the rows of an image (H, W), uint8, are of two instants.

    Of a camera that stands, or moves by less than a pixel between them, none shows.
    """
    some = image[:, ::max(image.shape[1] // _COLUMNS, 1)].astype(np.int16)
    if len(some) < 3:
        return False
    beyond = float(np.abs(some[2:] - some[:-2]).mean())
    return bool(np.abs(np.diff(some, axis=0)).mean() > _COMB * max(beyond, _LEAST))


def of_even_rows(image: np.ndarray) -> np.ndarray:
    """Return an image (H, W) or (H, W, 3), its odd rows the mean of the even ones beside them."""
    shown = image.copy()
    between = shown[1:-1:2]
    between[...] = (image[:-2:2].astype(np.uint16) + image[2::2] + 1) // 2
    if len(image) % 2 == 0:
        shown[-1] = image[-2]
    return shown
