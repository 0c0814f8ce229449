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
Motion of each view while its rows are read, where no other view tells of it.

Photographs, and the few images of a drive, are far apart in time. Their poses do not tell how the
camera moved while one of them was read. So each has six unknowns of its own: how far it turns and
moves from the first row to the last, as shares of what is usual between two views. They are
Gaussian about a mean that need not be zero (`ViewEffects`): who looks once a step at a walk sees
the same part of a step each time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.view_effects import ViewEffects

#: Unknowns of each view: turn and move while the whole image is read, before the mount.
ROW_NAMES = ('row_turn_x', 'row_turn_y', 'row_turn_z', 'row_x', 'row_y', 'row_z')


@dataclass(frozen=True)
class OwnRows:
    """
    What each view's own motion does to its observations.

    Attributes
    ----------
    sigma : float
        Of `ViewEffects`.
    motion : ndarray, shape (V, 6)
        The values that displacements belong to.
    slope : ndarray, shape (N, 2, 6)
        Derivatives of the displacements by them, pixels.
    near : int
        Views that tell the line delay's motion at one of them, to which this is added.

    """

    sigma: float
    motion: np.ndarray
    slope: np.ndarray
    near: int

    @classmethod
    def supposed(cls, sigma: float, near: int) -> OwnRows:
        """Return what is supposed, of no observations yet."""
        return cls(sigma, np.zeros((0, len(ROW_NAMES))), np.zeros((0, 2, len(ROW_NAMES))), near)

    @property
    def effects(self) -> ViewEffects:
        """What is supposed of the unknowns."""
        return ViewEffects(ROW_NAMES, self.sigma)

    def of_others(self, count: int, views: int) -> OwnRows:
        """Return no motion of so many views, and no effect on so many observations."""
        return replace(self, motion=np.zeros((views, len(ROW_NAMES))),
                       slope=np.zeros((count, 2, len(ROW_NAMES))))

    def select(self, rows: np.ndarray) -> OwnRows:
        """Return those of some observations."""
        return replace(self, slope=self.slope[rows])

    def beyond(self, motion: np.ndarray | None, view: np.ndarray) -> np.ndarray:
        """Return what other values nearby displace observations (N, 2) of views (N,) by."""
        apart = -self.motion if motion is None else motion - self.motion[:len(motion)]
        displaced: np.ndarray = np.einsum('nik,nk->ni', self.slope, apart[view])
        return displaced
