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
"""Fewer tracks where a recording has more positions than a camera needs."""

from __future__ import annotations

import numpy as np

#: Positions that are enough for any camera: sigma of the focal length is some 0.002 % then, less
#: than what a lens does beyond its model. 140 photographs of 1400 positions each have as many.
ENOUGH_POSITIONS = 200_000


def without_surplus(image: np.ndarray, track: np.ndarray, most: int,
                    rng: np.random.Generator) -> np.ndarray:
    """
    Choose whole tracks such that all images keep about as many positions.

    The images choose in turn, each time one of the tracks that they see, at random.

    Parameters
    ----------
    image, track : ndarray of int, shape (N,)
        Of every position.
    most : int
        About so many positions are kept. Fewer are kept all.
    rng : numpy.random.Generator
        Source of the order.

    Returns
    -------
    ndarray of bool, shape (N,)

    """
    if len(track) <= most:
        return np.ones(len(track), bool)
    image = np.unique(image, return_inverse=True)[1]
    _, track, length = np.unique(track, return_inverse=True, return_counts=True)
    order = np.lexsort((rng.random(len(length))[track], image))
    turn = np.empty(len(track), int)
    turn[order] = np.arange(len(track)) - np.searchsorted(image[order], image[order])
    first = np.full(len(length), len(track))
    np.minimum.at(first, track, turn)
    by_turn = np.argsort(first, kind='stable')
    chosen = np.zeros(len(length), bool)
    chosen[by_turn[np.cumsum(length[by_turn]) <= most]] = True
    kept: np.ndarray = chosen[track]
    return kept
