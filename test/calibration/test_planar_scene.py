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
"""Homographies of one plane: rotation, translation and normal come back."""

import numpy as np

from selfcal_ros.calibration.initialisation.planar_scene import separate
from selfcal_ros.geometry.rotation import rotation_matrix


def test_rotation_and_translation_come_back():
    rng = np.random.default_rng(4)
    normal = np.array([0.1, 0.5, 0.8])
    R = rotation_matrix(np.vstack([np.zeros(3), rng.normal(0, 0.2, (6, 3))]))
    t = np.vstack([np.zeros(3), rng.normal(0, 0.3, (6, 3))])
    H = (R + t[:, :, None] * normal) * rng.uniform(-2, 2, 7)[:, None, None]

    found_R, found_t = separate(H)

    np.testing.assert_allclose(found_R, R, atol=1e-9)
    np.testing.assert_allclose(found_t, t * np.linalg.norm(normal), atol=1e-9)


def test_a_camera_that_only_turned_has_no_translation():
    R = rotation_matrix(np.random.default_rng(1).normal(0, 0.2, (5, 3)))
    found_R, found_t = separate(R)

    np.testing.assert_allclose(found_R, R, atol=1e-6)
    np.testing.assert_allclose(found_t, 0, atol=1e-6)
