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
Positions at an instant between two images: where a camera has a clock of its own.

A track moves smoothly over a few images. So its position at the instant is that of the polynomial
through its positions in the nearest image and in those beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.features.klt import flow


@dataclass(frozen=True)
class ImagesBeside:
    """
    The images of a camera around an instant, of which it has none itself.

    Attributes
    ----------
    late_s : float
        How long after the instant the nearest image was taken; below zero, before it.
    others : tuple of (float, ndarray of uint8, shape (H, W))
        The images before and after that one, at most one of each: how late, and the image.

    """

    late_s: float
    others: tuple[tuple[float, np.ndarray], ...]


def at_instant(image: np.ndarray, beside: ImagesBeside, xy: np.ndarray,
               ) -> tuple[np.ndarray, np.ndarray]:
    """
    Move positions in an image to where they were at an instant.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W)
        The nearest to the instant.
    beside : ImagesBeside
    xy : ndarray, shape (N, 2)
        Pixels in it.

    Returns
    -------
    xy : ndarray, shape (N, 2)
    good : ndarray of bool, shape (N,)
        Whether the point was followed beyond the instant, so that it lies between two positions.

    """
    late_s = np.array([beside.late_s, *(late for late, _ in beside.others)])
    moved = np.zeros((len(late_s), len(xy), 2))
    followed = np.ones((len(late_s), len(xy)), bool)
    for k, (_, other) in enumerate(beside.others, 1):
        there, followed[k] = flow(image, other, xy)
        moved[k] = there - xy
    found, good = np.array(xy, float), np.zeros(len(xy), bool)
    for seen in np.unique(followed, axis=1).T:
        rows = (followed == seen[:, None]).all(axis=0)
        good[rows] = np.ptp(np.sign(late_s[seen])) == 2
        found[rows] += np.einsum('k,knj->nj', _weights(late_s[seen]), moved[seen][:, rows])
    return found, good


def _weights(late_s: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the weights (K,) of values at K times for the value at zero, after Lagrange."""
    late_s = np.asarray(late_s)
    apart = late_s[None] - late_s[:, None] + np.eye(len(late_s))
    ratio = late_s / apart
    np.fill_diagonal(ratio, 1.0)
    weights: np.ndarray = ratio.prod(axis=1)
    return weights
