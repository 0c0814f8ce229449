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
"""Straight pieces of edges of one image, as OpenCV finds them."""

from __future__ import annotations

import cv2
import numpy as np

#: Of more pieces of lines in an image the longest are taken.
_MAX_LINES = 600


def line_segments(image: np.ndarray, least_length_px: float) -> np.ndarray:
    """
    Find straight pieces of edges.

    Parameters
    ----------
    image : ndarray, shape (H, W), uint8
    least_length_px : float
        Pieces that are not longer are left out.

    Returns
    -------
    ndarray, shape (N, 2, 2)
        Their ends in pixels, the longest first; 600 at the most.

    """
    found = cv2.createLineSegmentDetector().detect(image)[0]
    segments = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(float)
    lengths = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    longest = np.argsort(-lengths, kind='stable')[:_MAX_LINES]
    long: np.ndarray = segments[longest[lengths[longest] > least_length_px]]
    return long
