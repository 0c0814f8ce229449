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
"""Drives in which the vehicle stands for a while, or turns on the spot."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.synthetic.lap_scenes import hall_around
from selfcal_ros.synthetic.paths import planar_poses
from selfcal_ros.synthetic.scenes import observe, PointSequence
from selfcal_ros.synthetic.special_scenes import with_outliers

#: Points of the floor and above it, and how far they are seen.
POINTS, FARTHEST_M = 6000, 9.0
#: Views in which a point is followed on average, three at least, and gross errors.
FOLLOWED, GROSS_SHARE = 8, 0.01
#: Height of the camera, and its place ahead of the axle: on it, or by so much.
HEIGHT_M, AHEAD_M = 0.7, (0.0, 0.01, 0.05, 0.3)


def pauses(rng: np.random.Generator, noise_px: float = 0.2) -> PointSequence:
    """
    Drive, stand or turn on the spot, and drive on; points are followed for some views.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the path of 26 to 44 views, of which a fifth to a half are in the pause. Half of the
        drives turn by 50 to 180 degrees there. Draws camera, points and tracks, too.
    noise_px : float

    Returns
    -------
    PointSequence

    """
    views = int(rng.integers(26, 45))
    way = np.linspace(0, 1, views)
    pause = rng.uniform(0.2, 0.5)
    begin = rng.uniform(0.2, 0.8) * (1 - pause)
    on_the_spot = np.clip((way - begin) / pause, 0, 1)
    driven = (way - pause * on_the_spot) / (1 - pause)
    turn_rad = np.radians(rng.uniform(50, 180)) * rng.choice([-1, 0, 0, 1])
    heading = turn_rad * on_the_spot + rng.uniform(0.3, 0.8) * np.sin(
        2 * np.pi * (driven + rng.uniform(0, 1)))
    step = np.diff(driven, prepend=0)[:, None] * rng.uniform(2.5, 5)
    xy = np.cumsum(step * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    cx, cy = np.array([320, 240]) + rng.normal(0, 8, 2)
    f, k1 = rng.uniform(400, 750), rng.uniform(-0.2, 0.0)
    camera = Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], (k1, 0.5 * k1 * k1), 640, 480)
    poses = planar_poses(xy, heading, HEIGHT_M, rng.choice(AHEAD_M), rng.uniform(8, 25))
    points, away = hall_around(rng, poses, xy, POINTS)
    first = rng.integers(-FOLLOWED, views, POINTS)
    last = first + np.maximum(3, rng.geometric(1 / FOLLOWED, POINTS))
    view = np.arange(views)[:, None]
    seen = (away < FARTHEST_M) & (view >= first) & (view < last)
    scene = observe(rng, camera, poses, points, noise_px, only_inside=True, seen=seen)
    return with_outliers(scene, rng, GROSS_SHARE)
