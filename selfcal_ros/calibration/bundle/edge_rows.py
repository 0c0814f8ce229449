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
Edges of an object that moves while the lines of an image are read one after the other.

How the object moves at each image is known from its poses in those beside it, so what is unknown
is one number: the line delay. The displacement of an edge is linear in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class EdgeRows:
    """
    How far edges move until their line is read.

    Attributes
    ----------
    line_delay_s : float
        The edgels are where the edges were when the middle line was read, if lines follow each
        other so fast.
    slope : ndarray, shape (N, 2)
        Displacement of each edge when its line is read, pixels for every second of line delay.
    lines : {'rows', 'columns'}
        What is read one after the other.
    interval_s : float
        Between two images, in the median.

    """

    line_delay_s: float
    slope: np.ndarray
    lines: Literal['rows', 'columns']
    interval_s: float

    def select(self, mask: np.ndarray) -> EdgeRows:
        """Return those of some edgels."""
        return replace(self, slope=self.slope[mask])

    def back(self, xy: np.ndarray, line_delay_s: float) -> np.ndarray:
        """Move edgels (N, 2) to where they were when the middle line was read, pixels."""
        moved: np.ndarray = xy - (line_delay_s - self.line_delay_s) * self.slope
        return moved
