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
"""Points with known coordinates, such as those of a board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import InputError
from selfcal_ros.values.whole_numbers import whole_numbers

#: Coordinates from here on are as good as infinite.
FARTHEST = 1e12


@dataclass(frozen=True)
class KnownObject:
    """
    Points with known coordinates.

    Parameters
    ----------
    identity : array_like of int, shape (P,)
        What `Tracks.track` calls each point.
    points : array_like, shape (P, 3)
        Coordinates in a right-handed frame of the object, metres (any unit will do for the
        calibration; the poses come out in it).

    Raises
    ------
    InputError
        If shapes differ, a coordinate is not finite, or an identity occurs twice.

    Examples
    --------
    The inner corners of a chessboard of 7x5, squares of 40 mm:

    >>> from selfcal_ros import KnownObject
    >>> corners = [(0.04 * x, 0.04 * y, 0.0) for y in range(5) for x in range(7)]
    >>> len(KnownObject(range(35), corners))
    35

    """

    identity: np.ndarray
    points: np.ndarray

    if TYPE_CHECKING:
        # what may be given; the fields say what is kept
        def __init__(self, identity: ArrayLike, points: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        """Check the points and sort them by identity."""
        identity = whole_numbers(self.identity, 'identities of a known object')
        points = np.asarray(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) != len(identity):
            raise InputError('A known object needs identities (P,) and points (P, 3) of one '
                             f'length; got {identity.shape} and {points.shape}.')
        usable = (np.abs(points) < FARTHEST).all(axis=1)
        if not usable.all():
            bad = int(np.flatnonzero(~usable)[0])
            raise InputError(f'Object point {identity[bad]} is not finite; correct or remove it.')
        order = np.argsort(identity, kind='stable')
        identity, points = identity[order], points[order]
        twice = np.flatnonzero(np.diff(identity) == 0)
        if len(twice):
            raise InputError(f'Object point {identity[twice[0]]} occurs twice; keep one.')
        object.__setattr__(self, 'identity', identity)
        object.__setattr__(self, 'points', points)

    def __len__(self) -> int:
        """Count the points."""
        return len(self.identity)
