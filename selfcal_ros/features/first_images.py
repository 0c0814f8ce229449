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
"""Some of the first images of a stream, for what is asked of them together."""

from __future__ import annotations

import numpy as np


class FirstImages:
    """
    Gathers images from the beginning of a stream, and anew where their size changes.

    Parameters
    ----------
    wanted : int
        So many are gathered.
    every : int
        Of so many images one is taken: neighbours in a video show nearly the same.

    Attributes
    ----------
    shape : tuple of int
        Of the newest image; empty before the first.

    """

    def __init__(self, wanted: int, every: int = 1):
        self._wanted, self._every, self._count = wanted, every, 0
        self._taken: list[np.ndarray] = []
        self.shape: tuple[int, ...] = ()

    def take(self, image: np.ndarray) -> list[np.ndarray]:
        """Offer the next image; returns all that were wanted, once, and else none."""
        if image.shape != self.shape:
            self.shape, self._taken, self._count = image.shape, [], 0
        self._count += 1
        if len(self._taken) >= self._wanted or (self._count - 1) % self._every:
            return []
        self._taken.append(image)
        if len(self._taken) < self._wanted:
            return []
        taken = self._taken
        # their count still tells that they have been taken
        self._taken = [image[:0]] * self._wanted
        return taken
