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
"""Corners of a board that is waved before a camera whose rows are read one after the other."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.tracks import Tracks

CAMERA = Camera([[520, 0, 325], [0, 520, 237], [0, 0, 1]], [-0.1, 0.05, 0, 0], 640, 480)
#: How tilted the board is held, rad, and where it is, metres.
_TILT_RAD = np.array([0.35, 0.35, 0.3])
_NEAREST_M, _FARTHEST_M = np.array([[-0.15, -0.1, 0.35], [0.15, 0.1, 0.7]])


def waved_board(rng: np.random.Generator, board: KnownObject, readout_s: float,
                pace: float = 1.0, views: int = 20, noise_px: float = 0.1) -> Tracks:
    """
    Wave a board, and see its corners each in the row that it falls on.

    Parameters
    ----------
    rng : numpy.random.Generator
    board : KnownObject
        Some 0.2 m wide.
    readout_s : float
        In which all rows are read.
    pace : float
        1: 20 degrees and 0.1 m a second, standard deviations of each axis.
    views : int
        In which all corners are seen.
    noise_px : float

    Returns
    -------
    Tracks

    """
    X = board.points - board.points.mean(axis=0)
    seen: list[np.ndarray] = []
    size = np.array([CAMERA.width, CAMERA.height])
    while len(seen) < views:
        turned = X @ rotation_matrix(rng.normal(0, _TILT_RAD)).T
        there = rng.uniform(_NEAREST_M, _FARTHEST_M)
        spin, speed = pace * rng.normal(0, np.radians(20), 3), pace * rng.normal(0, 0.1, 3)
        xy = CAMERA.project(turned + there)
        for _ in range(8):
            after = readout_s * (xy[:, 1:] - (CAMERA.height - 1) / 2) / CAMERA.height
            later = np.einsum('nij,nj->ni', rotation_matrix(spin * after), turned)
            xy = CAMERA.project(later + there + speed * after)
        if ((xy > 2) & (xy < size - 3)).all():
            seen.append(xy + rng.normal(0, noise_px, xy.shape))
    return Tracks(np.repeat(np.arange(views), len(X)), np.tile(board.identity, views),
                  np.concatenate(seen), (CAMERA.width, CAMERA.height))
