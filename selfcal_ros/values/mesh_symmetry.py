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
"""Turns that change nothing of a body of revolution: its surface only slides along itself."""

from __future__ import annotations

import numpy as np

#: A surface slides along itself where it moves along its normals by less than this, rms and at
#: the most, in units of its rms distance from its middle, per radian.
_SLIDES, _SLIDES_MOST = 0.02, 0.2
#: A motion is a turn where this share of it is one; the rest moves the middle onto the axis.
_TURN = 0.7


def free_turns(points: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """
    Turns that leave a surface where it is.

    Parameters
    ----------
    points, normals : ndarray, shape (N, 3)
        Places on the surface, and its unit normals there.
    areas : ndarray, shape (N,)
        How much of the surface each stands for.

    Returns
    -------
    ndarray, shape (k, 6)
        (theta, Delta): a turn by the vector theta about the origin and a shift by Delta, metres
        per radian; theta of length 1. One row for a body of revolution, three for a ball, none
        else.

    """
    none = np.zeros((0, 6))
    weight = areas / areas.sum()
    size = float(np.sqrt(weight @ (points**2).sum(axis=1)))
    slips = np.column_stack([np.cross(points / size, normals), normals])
    values, vectors = np.linalg.eigh((slips * weight[:, None]).T @ slips)
    motions = vectors[:, values < _SLIDES**2].T
    turn = np.linalg.norm(motions[:, :3], axis=1)
    if len(motions) not in (1, 3) or not (turn > _TURN).all():
        return none
    motions = motions / turn[:, None]
    if np.abs(slips @ motions.T).max() > _SLIDES_MOST:
        return none
    found: np.ndarray = motions * np.r_[1, 1, 1, size, size, size]
    return found
