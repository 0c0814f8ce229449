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
"""Drives that come back to where they have been: most vehicles go round."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic.paths import planar_poses
from selfcal_ros.synthetic.scenes import observe, PointSequence

#: Points of the floor and above it, how far they are seen, and how often they are found.
POINTS, FARTHEST_M, FOUND = 2500, 9.0, 0.7
#: Height of the camera, and its place ahead of the vehicle's centre.
HEIGHT_M, AHEAD_M = 1.1, 0.35


def laps(rng: np.random.Generator, noise_px: float = 0.3) -> PointSequence:
    """
    Drive round once or more, through a hall of points that are found again on every lap.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the path: 24 to 69 views, 300 to 900 degrees of turns, 0.15 to 0.5 m a view. Draws
        focal length, principal point, distortion and pitch of the camera, and the points, too.
    noise_px : float

    Returns
    -------
    PointSequence

    """
    views, turn_rad = int(rng.integers(24, 70)), np.radians(rng.uniform(300, 900))
    step_m = rng.uniform(0.15, 0.5)
    way = np.linspace(0, 1, views)
    heading = turn_rad * way + rng.uniform(0, 0.6) * np.sin(2 * np.pi * rng.uniform(1, 3) * way)
    xy = step_m * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    f = rng.uniform(330, 900)
    cx, cy = np.array([320, 240]) + rng.normal(0, 8, 2)
    k1 = rng.uniform(-0.15, 0.02)
    camera = Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], (k1, 0.02), 640, 480)
    poses = planar_poses(xy, heading, HEIGHT_M, AHEAD_M, rng.uniform(5, 25))
    points, away = hall_around(rng, poses, xy, POINTS)
    seen = (away < FARTHEST_M) & (rng.random(away.shape) < FOUND)
    return observe(rng, camera, poses, points, noise_px, only_inside=True, seen=seen)


def hall_around(rng: np.random.Generator, poses: np.ndarray, xy: np.ndarray, count: int,
                ) -> tuple[np.ndarray, np.ndarray]:
    """
    Draw points on the floor, half of them, and up to 3 m above it, 5 m beyond a path.

    Parameters
    ----------
    rng : numpy.random.Generator
    poses : ndarray, shape (V, 3, 4)
        `cam_from_world`.
    xy : ndarray, shape (V, 2)
        Places of the vehicle on the floor, metres.
    count : int

    Returns
    -------
    points : ndarray, shape (count, 3)
    away : ndarray, shape (V, count)
        Distance of every point from every camera.

    """
    low, high = np.append(xy.min(axis=0) - 5, 0), np.append(xy.max(axis=0) + 5, 3)
    points = rng.uniform(low, high, (count, 3))
    points[:count // 2, 2] = 0
    away: np.ndarray = np.linalg.norm(
        points @ np.swapaxes(poses[:, :, :3], 1, 2) + poses[:, None, :, 3], axis=2)
    return points, away
