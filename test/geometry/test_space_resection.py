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
"""Camera matrices from points: exact without noise, and with the covariance that is true."""

import numpy as np
from selfcal_ros import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.geometry.space_resection import pose_of_rays

FISHEYE = Camera([[260, 0, 322], [0, 260, 236], [0, 0, 1]], (0.02, -0.01, 0.002, 0.0), 640, 480,
                 'equidistant')


def _seen(rng, turn, place, flat, noise_px=0.1):
    """Points, rays of a fisheye and the pose that they were seen from; one in five is wrong."""
    R = rotation_matrix(np.array(turn))
    seen = rng.uniform(-4, 4, (150, 3)) * [1, 1, 0.0 if flat else 0.5] + [0, 0, 4.5]
    xy = FISHEYE.project(seen) + noise_px * rng.normal(size=(150, 2))
    xy[::5] += rng.uniform(-80, 80, (30, 2))
    points = np.column_stack([(seen - place) @ R, np.ones(150)])
    points *= rng.choice([-1.0, 1.0], 150)[:, None] / np.linalg.norm(points, axis=1)[:, None]
    return points, FISHEYE.rays(xy), R


def test_the_pose_of_a_fisheye_is_found_among_wrong_points():
    for k, turn in enumerate(([0.1, -0.2, 0.05], [0.0, 2.4, 0.3], [1.0, 1.0, -1.0])):
        place = np.array([0.3, -0.2, 0.4])
        points, rays, R = _seen(np.random.default_rng(k), turn, place, flat=False)
        found = pose_of_rays(points, rays)
        assert np.linalg.norm(rotation_vector(found.pose[:, :3] @ R.T)) < 1e-3
        assert np.abs(found.pose[:, 3] - place).max() < 3e-3 and found.error_rad < 1e-3


def test_points_on_a_plane_show_a_pose_that_turns_little():
    # a wall leaves the linear start without an answer, five unknowns of the lens being too many
    points, rays, R = _seen(np.random.default_rng(3), [0.1, -0.2, 0.05], np.zeros(3), flat=True)
    found = pose_of_rays(points, rays)
    assert np.linalg.norm(rotation_vector(found.pose[:, :3] @ R.T)) < 1e-3


def test_three_points_and_pixels_without_rays_show_no_pose():
    points, rays, _ = _seen(np.random.default_rng(4), [0.1, 0, 0], np.zeros(3), flat=False)
    rays[3:] = np.nan
    assert not pose_of_rays(points, rays)
