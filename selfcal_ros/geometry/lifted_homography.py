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
"""What a homography leaves of matches seen through a lens of the division model."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.division import DivisionModel

#: Distance of a point that its homography sends nowhere, half diagonals.
_NOWHERE = 2.0


def lifted_homography_cost(model: DivisionModel, xy_a: np.ndarray, xy_b: np.ndarray) -> float:
    """
    Sum of squared transfer distances in both images of the linear homography.

    Parameters
    ----------
    model : DivisionModel
    xy_a, xy_b : ndarray, shape (m, 2)
        Matches in pixels, at least four.

    Returns
    -------
    float
        Square pixels.

    """
    a, b = (_directions(model.lifted(xy)) for xy in (xy_a, xy_b))
    # b x H a = 0: for unit b the squares of these are |H a|² - (b · H a)²
    along = (b[:, :, None] * a[:, None, :]).reshape(-1, 9)
    squares = np.kron(np.eye(3), a.T @ a) - along.T @ along
    H = np.linalg.eigh(squares)[1][:, 0].reshape(3, 3)
    adjugate = np.stack([np.cross(H[:, 1], H[:, 2]), np.cross(H[:, 2], H[:, 0]),
                         np.cross(H[:, 0], H[:, 1])])
    cost = 0.0
    for matrix, source, target, xy in ((H, a, b, xy_b), (adjugate, b, a, xy_a)):
        moved = source @ matrix.T
        # beyond 90 degrees the sign of a lifted point tells it from its opposite
        moved *= np.sign(np.median((moved * target).sum(axis=1))) or 1.0
        gap = (np.asarray(xy, float) - model.pixels(moved)) / model.half_diagonal_px
        gap = np.where(np.isfinite(gap), np.clip(gap, -_NOWHERE, _NOWHERE), _NOWHERE)
        cost += float((gap ** 2).sum())
    return cost * model.half_diagonal_px ** 2


def _directions(points: np.ndarray) -> np.ndarray:
    """Points (m, 3) of unit length."""
    unit: np.ndarray = points / np.linalg.norm(points, axis=1, keepdims=True)
    return unit
