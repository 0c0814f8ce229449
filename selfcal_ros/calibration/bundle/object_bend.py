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
The shape block of a board that is not as it was stated: not flat, or not printed to scale.

A plate that was bent, by its fixing, its weight or the damp, is to first order a surface of second
degree. What is linear in it is a turn of the board, and belongs to the poses. A printer feeds
paper by its own measure, so that a pattern is longer one way than the other, and may lean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Heights off the plane: of a bow along, of a twist, and of a bow across.
BEND_NAMES = ('bow_x', 'twist', 'bow_y')
#: Share by which the pattern is longer along than across, and the angle, radians, by which it
#: leans.
PRINT_NAMES = ('stretch', 'lean')
SHAPE_NAMES = (*BEND_NAMES, *PRINT_NAMES)


@dataclass(frozen=True)
class Bend:
    """
    What a board may look like, one row for every observation.

    Attributes
    ----------
    modes : ndarray, shape (N, 5, 3)
        How the observed points move by the unknowns `SHAPE_NAMES`, in the object's frame.
    sigma : ndarray, shape (5,)
        What is supposed of each unknown: lengths in the unit of the object, a share, an angle.

    """

    modes: np.ndarray
    sigma: np.ndarray

    def off(self, bend: np.ndarray) -> np.ndarray:
        """Return how far the points are from where they were stated, (N, 3)."""
        away: np.ndarray = np.einsum('nki,k->ni', self.modes, bend)
        return away


def bend_modes(points: np.ndarray, thickness: float = 1e-6,
               ) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Describe how a plane object may bend, and its pattern be off.

    Parameters
    ----------
    points : ndarray, shape (P, 3)
    thickness : float
        An object thicker than this share of its extent is no plane.

    Returns
    -------
    modes : ndarray, shape (P, 5, 3)
        How all points move by `SHAPE_NAMES`. Each bend spans one unit of height over the points,
        so that these unknowns are lengths.
    normal : ndarray, shape (3,)
        Along which the heights are, in the object's frame. None in place of both for a solid, and
        where the points do not show a bend.

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
    across = np.cross(normal, along)
    u, v = centred @ along, centred @ across
    heights = np.column_stack([u**2, u * v, v**2])
    # a pose takes what is linear in them
    plane = np.column_stack([np.ones(len(points)), u, v])
    heights -= plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]
    span = np.ptp(heights, axis=0)
    if not (span > 1e-9 * extent[0]**2).all():
        return None
    # half of each either way: the size, and a turn, are the pose's
    printed = 0.5 * np.stack([np.outer(u, along) - np.outer(v, across),
                              np.outer(v, along) + np.outer(u, across)], axis=1)
    return np.concatenate([(heights / span)[..., None] * normal, printed], axis=1), normal
