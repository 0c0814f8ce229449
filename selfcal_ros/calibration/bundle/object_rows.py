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
Motion of an object before the camera while each image is read, row by row.

A board in a hand does not hold still. Its points are known, so that a single image shows how it
moved meanwhile. Each view has six unknowns for that, Gaussian about a mean that need not be zero
(`ViewEffects`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.clock import line_of
from selfcal_ros.calibration.bundle.own_rows import ROW_NAMES
from selfcal_ros.calibration.bundle.shutter import read_at
from selfcal_ros.calibration.bundle.view_effects import ViewEffects
from selfcal_ros.geometry.rotation import left_jacobian, rotation_matrix


@dataclass(frozen=True)
class ObjectRows:
    """
    How images are read, and what is supposed of the motion meanwhile.

    Attributes
    ----------
    sigma : float
        Standard deviation of turns (rad) and moves (shares of the distance) from the first line
        to the last.
    lines : int
        Rows of the image, or columns.
    axis : int
        The pixel coordinate that tells the line: 1 of rows, 0 of columns.

    """

    sigma: float
    lines: int
    axis: int = 1

    @property
    def effects(self) -> ViewEffects:
        """What is supposed of the unknowns."""
        return ViewEffects(ROW_NAMES, self.sigma)

    def delays(self, projected: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """
        Return when points are read, (N,): -1/2 is the first line and 1/2 the last.

        That of the line that they project to, unless they project far from what is measured.
        """
        return line_of(read_at(projected, xy, self.lines), self.lines, self.axis)


@dataclass(frozen=True)
class MovedPoints:
    """
    Points of an object when they are read.

    Attributes
    ----------
    turned : ndarray, shape (N, 3)
        Turned into the frame of the view and on with the motion; not yet moved.
    turn : ndarray, shape (N, 3)
        Rotation vector since the middle line, rad.
    R : ndarray, shape (N, 3, 3)
        The same.
    by_values : ndarray, shape (N, 6)
        What turn and move are multiples of.
    move : ndarray, shape (N, 3)

    """

    turned: np.ndarray
    turn: np.ndarray
    R: np.ndarray
    by_values: np.ndarray
    move: np.ndarray

    @classmethod
    def of(cls, turned: np.ndarray, delay: np.ndarray, motion: np.ndarray,
           distance: np.ndarray) -> MovedPoints:
        """
        Move points until they are read.

        Parameters
        ----------
        turned : ndarray, shape (N, 3)
            In the frame of the view, not yet moved.
        delay : ndarray, shape (N,)
        motion : ndarray, shape (N, 6)
            Of the view of each.
        distance : ndarray, shape (N,)

        """
        by_values = delay[:, None] * np.repeat(
            np.column_stack([np.ones(len(delay)), distance]), 3, axis=1)
        moved = by_values * motion
        R = rotation_matrix(moved[:, :3])
        return cls(np.einsum('nij,nj->ni', R, turned), moved[:, :3], R, by_values, moved[:, 3:])

    def by_motion(self, J: np.ndarray) -> np.ndarray:
        """Differentiate by the motion, (N, m, 6), from derivatives (N, m, 3) by the points."""
        by_turn = np.cross(self.turned[:, None], J) @ left_jacobian(self.turn)
        slopes: np.ndarray = np.concatenate([by_turn, J], axis=2) * self.by_values[:, None]
        return slopes

    def by_place(self, J: np.ndarray, there: np.ndarray) -> np.ndarray:
        """Differentiate by where the object is, (N, m, 3): moves are shares of its distance."""
        square = np.sum(there**2, axis=1, keepdims=True)
        farther = np.einsum('nmi,ni->nm', J, self.move)
        slopes: np.ndarray = J + farther[:, :, None] * (there / square)[:, None]
        return slopes
