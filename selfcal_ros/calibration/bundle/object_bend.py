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
The shape block of a board that is not flat: the offsets of its points from their plane.

A plate that was bent, by its fixing, its weight or the damp, is to first order a surface of second
degree. What is linear in it is a turn of the board, and belongs to the poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Heights off the plane: of a bow along, of a twist, and of a bow across.
BEND_NAMES = ('bow_x', 'twist', 'bow_y')


@dataclass(frozen=True)
class Bend:
    """
    What a board may look like, one row for every observation.

    Attributes
    ----------
    modes : ndarray, shape (N, 3)
        Height of the observed points by the unknowns `BEND_NAMES`.
    normal : ndarray, shape (3,)
        Along which the heights are, in the object's frame.
    sigma : float
        What is supposed of each unknown, in the unit of the object.

    """

    modes: np.ndarray
    normal: np.ndarray
    sigma: float

    def off(self, bend: np.ndarray) -> np.ndarray:
        """Return how far the points stand off the plane, (N, 3)."""
        away: np.ndarray = (self.modes @ bend)[:, None] * self.normal
        return away


def bend_modes(points: np.ndarray, thickness: float = 1e-6,
               ) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Describe how a plane object may bend.

    Parameters
    ----------
    points : ndarray, shape (P, 3)
    thickness : float
        An object thicker than this share of its extent is no plane.

    Returns
    -------
    modes : ndarray, shape (P, 3)
        Heights of all points by `BEND_NAMES`. Each mode spans one unit of height over the
        points, so that the unknowns are lengths.
    normal : ndarray, shape (3,)
        None in place of both for a solid, and where the points do not show a bend.

    """
    centred = points - points.mean(axis=0)
    _, extent, axes = np.linalg.svd(centred, full_matrices=False)
    if len(points) < 9 or not extent[2] <= thickness * extent[0] or not (
            extent[1] > 1e-3 * extent[0]):
        return None
    normal = axes[2] * (np.sign(axes[2][np.argmax(np.abs(axes[2]))]) or 1.0)
    # along the object's own axes, as far as they lie in the plane
    along = np.eye(3)[np.argmin(np.abs(normal))]
    along = along - normal * (along @ normal)
    along /= np.linalg.norm(along)
    u, v = centred @ along, centred @ np.cross(normal, along)
    modes = np.column_stack([u**2, u * v, v**2])
    # a pose takes what is linear in them
    plane = np.column_stack([np.ones(len(points)), u, v])
    modes -= plane @ np.linalg.lstsq(plane, modes, rcond=None)[0]
    span = np.ptp(modes, axis=0)
    if not (span > 1e-9 * extent[0]**2).all():
        return None
    return modes / span, normal
