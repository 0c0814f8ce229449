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
"""What a match has in common with those next to it: how the image moves and turns there."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

#: Neighbours that a match is compared with.
_NEIGHBOURS = 8
#: Neighbours that turn or grow less between two images move alike without a correction.
_SMALL_TURN = 0.3


def agrees_with_neighbours(xy_a: np.ndarray, xy_b: np.ndarray, agreeing: int = 2) -> np.ndarray:
    """
    Tell which matches move like some of those next to them; on a line chance has its way.

    Parameters
    ----------
    xy_a, xy_b : ndarray, shape (N, 2)
        Pixels.
    agreeing : int
        So many neighbours have to agree.

    Returns
    -------
    ndarray of bool, shape (N,)

    """
    if len(xy_a) <= _NEIGHBOURS:
        return np.ones(len(xy_a), bool)
    distance, near = cKDTree(xy_a).query(xy_a, _NEIGHBOURS + 1)
    to_a, to_b = (xy[near[:, 1:]] - xy[:, None] for xy in (xy_a, xy_b))
    along, across = (np.median(part) for part in _ratios(to_a, to_b))
    if np.hypot(along - 1, across) > _SMALL_TURN:  # rolled about its axis, or much closer
        to_a = to_a @ np.array([[along, across], [-across, along]])
    away = to_b - to_a
    differs = np.hypot(away[..., 0], away[..., 1])
    agrees: np.ndarray = np.count_nonzero(differs < 5 + 0.4 * distance[:, 1:], axis=1) >= agreeing
    return agrees


def _ratios(to_a: np.ndarray, to_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real and imaginary part of to_b / to_a, taken as complex numbers, (..., 2) to (...)."""
    # sums of two columns: over an axis of two numbers they take several times as long
    (x, y), (u, v) = (to_a[..., 0], to_a[..., 1]), (to_b[..., 0], to_b[..., 1])
    square = np.maximum(x * x + y * y, 1e-9)
    return (x * u + y * v) / square, (x * v - y * u) / square


def local_turns(image: np.ndarray, xy: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """
    Find how much the image turned about every observation since its reference.

    Parameters
    ----------
    image : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
        Pixels.
    reference : ndarray of int, shape (N,)
        Row of the reference observation of the same point.

    Returns
    -------
    ndarray, shape (N, 2, 2)
        Rotations; the unit matrix where the turn is small or neighbours are few.

    """
    turns = np.tile(np.eye(2), (len(image), 1, 1))
    pair = image[reference] * (image.max(initial=0) + 1) + image
    order = np.argsort(pair, kind='stable')
    for rows in np.split(order, np.flatnonzero(np.diff(pair[order])) + 1):
        if len(rows) <= _NEIGHBOURS or image[rows[0]] == image[reference[rows[0]]]:
            continue
        before, here = xy[reference[rows]], xy[rows]
        near = cKDTree(before).query(before, _NEIGHBOURS + 1)[1][:, 1:]
        along, across = (np.median(part, axis=1) for part in _ratios(
            before[near] - before[:, None], here[near] - here[:, None]))
        angle = np.arctan2(across, along)
        angle[np.abs(angle) < _SMALL_TURN] = 0
        cos, sin = np.cos(angle), np.sin(angle)
        turns[rows] = np.moveaxis(np.array([[cos, -sin], [sin, cos]]), -1, 0)
    return turns
