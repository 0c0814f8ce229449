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
"""A Tsai grid to render: two orthogonal planes of dark squares (thesis figure 3.1a)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.render import PYRAMID_LEVELS, Scene, Surface

DARK, LIGHT = 30.0, 200.0
_FINER = 4


def grid_scene(columns: int, rows: int, square_m: float, gap_m: float, margin_m: float,
               texel_m: float = 0.00125) -> Scene:
    """
    Two planes that meet in the z axis, in the frame of `features.tsai_grid.TsaiGrid`.

    Parameters
    ----------
    columns, rows : int
        Squares across and along the fold, on each plane.
    square_m, gap_m, margin_m : float
        Side of a square, gap between squares, distance of the first edge from the fold.
    texel_m : float
        Side of a texel.

    Returns
    -------
    Scene
        Seen from inside and from outside.

    """
    step = 2 ** (PYRAMID_LEVELS - 1)
    pitch = square_m + gap_m
    # light ground as wide as the margin around the squares
    sides = [max(2, int(np.ceil((n * pitch - gap_m + 2 * margin_m) / texel_m / step))) * step
             for n in (columns, rows)]
    covered = []
    for count, n in zip(sides, (columns, rows)):
        at = (np.arange(count * _FINER) + 0.5) / _FINER * texel_m - margin_m
        covered.append((at >= 0) & (at < n * pitch - gap_m) & (at % pitch < square_m))
    dark = covered[1][:, None] & covered[0]
    texture = np.where(dark, DARK, LIGHT)
    texture = texture.reshape(sides[1], _FINER, sides[0], _FINER).mean(axis=(1, 3))
    width, height = np.array(sides) * texel_m
    surfaces = []
    for axis in (np.array([1.0, 0, 0]), np.array([0, 1.0, 0])):
        foot, up = np.array([0, 0, -margin_m]), np.array([0, 0, height])
        surfaces += [Surface(foot, width * axis, up, texture),
                     Surface(foot + width * axis, -width * axis, up, texture[:, ::-1])]
    return Scene(surfaces)


def view_of_grid(points: np.ndarray, distance_m: float,
                 turn_rad: Sequence[float] = (0.0, 0.0, 0.0),
                 shift_m: tuple[float, float] = (0.0, 0.0), inside: bool = True) -> np.ndarray:
    """
    Pose of a camera that looks into the fold, or at it from outside.

    Parameters
    ----------
    points : ndarray, shape (P, 3)
        Of the grid; their middle comes to the optical axis, but for the shift.
    distance_m : float
    turn_rad : array_like, shape (3,)
        Angle-axis vector by which the grid is then turned about its middle, camera frame.
    shift_m : (float, float)
        Right and down.
    inside : bool

    Returns
    -------
    ndarray, shape (3, 4)
        Camera from grid.

    """
    s = np.sqrt(0.5)
    base = np.array([[-s, s, 0], [0, 0, -1], [-s, -s, 0]])
    if not inside:
        base = base * np.array([[-1.0], [1.0], [-1.0]])
    R = rotation_matrix(np.asarray(turn_rad, float)) @ base
    return np.column_stack([R, np.array([*shift_m, distance_m]) - R @ points.mean(axis=0)])
