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
The calibration grid of the thesis's chapter 4, seen by a camera that translates, then turns.

Two orthogonal Tsai grids of 16 squares each, 512 x 512 pixels, camera of table 3.2. The first
two views are related by a pure translation; every further view is rotated, and moved so that
the grid stays in the middle of the image (4.2.1). Positions are not printed in the thesis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.scenes import observe, PointSequence

#: Mean reprojection distance of the thesis's corners is 0.158 px (table 3.1); with Gaussian
#: noise that is √(π / 2) times the standard deviation of a coordinate.
CORNER_NOISE_PX = 0.126
#: Corners on a side of each plane: four squares with gaps as wide as they are.
CORNERS = 8
#: Distance of the first view from the grid's middle, and the side of a plane, in one unit.
DISTANCE, SIDE = 4.6, 1.65
#: Position of the second view against the first, in the camera's axes.
BASELINE = (0.45, 0.12, 0.4)


def grid_camera(skew: float = 0.0) -> Camera:
    """Camera of tables 3.2 and 4.1: αu 649, ζ 1.5, principal point (252, 256), 512 x 512."""
    K = np.array([[649, skew, 252], [0, 649 * 1.5, 256], [0, 0, 1]])
    return Camera(K, width=512, height=512)


def grid_points() -> np.ndarray:
    """
    Corners of both planes around the origin, the common edge along y, facing -z.

    Returns
    -------
    ndarray, shape (128, 3)
        First plane, then second; row-major from the edge outwards, then along it.

    """
    ticks = SIDE / (CORNERS - 1) * np.arange(CORNERS)
    out, along = (a.ravel() for a in np.meshgrid(ticks + 0.1, ticks - SIDE / 2, indexing='ij'))
    half = np.sqrt(0.5)
    planes = [np.column_stack([sign * half * out, along, half * out]) for sign in (-1, 1)]
    points = np.vstack(planes)
    return np.asarray(points - [0, 0, points[:, 2].mean()])


def grid_sequence(rng: np.random.Generator, rotations_deg: ArrayLike,
                  noise_px: float = CORNER_NOISE_PX, camera: Camera | None = None,
                  baseline: ArrayLike = BASELINE) -> PointSequence:
    """
    Two translated views and one view for each of the rotations.

    Parameters
    ----------
    rng : numpy.random.Generator
        For the noise, and for small random shifts of the rotated views.
    rotations_deg : array_like, shape (n, 3)
        Rotation vectors in the camera's axes, degrees.
    noise_px : float
    camera : Camera, optional
        `grid_camera()` by default.
    baseline : (float, float, float)
        Centre of view 1, in the axes of view 0.

    Returns
    -------
    PointSequence
        Views 0 and 1 are the translated pair; n further ones follow.

    """
    camera = grid_camera() if camera is None else camera
    rotations = rotation_matrix(np.radians(np.asarray(rotations_deg, float).reshape(-1, 3)))
    first = np.column_stack([np.eye(3), [0, 0, DISTANCE]])
    second = np.column_stack([np.eye(3), first[:, 3] - np.asarray(baseline, float)])
    # fixate: the grid's middle stays near the optical axis
    aim = np.array([0, 0, DISTANCE]) + rng.uniform(-1, 1, (len(rotations), 3)) * [0.1, 0.1, 0.3]
    turned = np.concatenate([rotations, aim[:, :, None]], axis=2)
    poses = np.concatenate([[first, second], turned])
    return observe(rng, camera, poses, grid_points(), noise_px)


def random_rotations(rng: np.random.Generator, count: int, size: str = '10') -> np.ndarray:
    """
    Rotations of one sequence of section 4.2.1, degrees, in the camera's axes.

    Parameters
    ----------
    rng : numpy.random.Generator
    count : int
        Rotated views; the signs of their rotations about x and y differ as far as possible.
    size : {'5', '10', 'x', 'y', 'z'}
        '5': 5 degrees about both x and y; '10': one of both 5 to 15, the other up to 15;
        'x', 'y', 'z': 5 to 15 about that axis alone.

    Returns
    -------
    ndarray, shape (count, 3)

    """
    if size in ('x', 'y', 'z'):
        angle = rng.uniform(5, 15, count) * rng.choice([-1, 1], count)
        return np.asarray(angle[:, None] * np.eye(3)['xyz'.index(size)])
    signs = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)])
    signs = signs[(rng.integers(4) + np.arange(count)) % 4]
    if size == '5':
        angles = np.full((count, 2), 5.0)
    else:
        angles = np.column_stack([rng.uniform(5, 15, count), rng.uniform(2, 15, count)])
        swap = rng.random(count) < 0.5
        angles[swap] = angles[swap][:, ::-1]
    # nothing is mounted without a slight roll
    return np.column_stack([signs * angles, rng.uniform(-1, 1, count)])
