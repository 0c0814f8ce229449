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
"""Rotations against their definitions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.rotation import (align_z, angle_sigmas, left_jacobian, pad,
                                           rotation_matrix, rotation_vector, swing_twist,
                                           twist_matrix)


@pytest.fixture
def vectors():
    """Rotation vectors of all sizes, zero and almost pi among them."""
    rng = np.random.default_rng(4)
    directions = rng.standard_normal((9, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    angles = np.array([0, 1e-9, 1e-5, 1e-3, 0.3, 1.7, 3.0, np.pi - 1e-6, np.pi])
    return directions * angles[:, None]


def test_cross_matrix_is_the_cross_product():
    a, b = np.array([1.0, -2, 3]), np.array([0.5, 4, -1])

    np.testing.assert_allclose(cross_matrix(a) @ b, np.cross(a, b))


def test_matrices_agree_with_scipy(vectors):
    np.testing.assert_allclose(rotation_matrix(vectors),
                               Rotation.from_rotvec(vectors).as_matrix(), atol=1e-14)


def test_vector_of_matrix_of_vector(vectors):
    back = rotation_matrix(rotation_vector(rotation_matrix(vectors)))

    np.testing.assert_allclose(back, rotation_matrix(vectors), atol=1e-9)
    np.testing.assert_allclose(rotation_vector(rotation_matrix(vectors[:-1])), vectors[:-1],
                               atol=1e-8)


def test_left_jacobian_is_the_derivative(vectors):
    step = 1e-6 * np.array([0.3, -0.5, 0.8])
    for v in vectors[2:]:
        moved = rotation_matrix(v + step)
        predicted = rotation_matrix(left_jacobian(v) @ step) @ rotation_matrix(v)

        np.testing.assert_allclose(moved, predicted, atol=1e-11)


def test_swing_and_twist_compose_again(vectors):
    R = rotation_matrix(vectors)
    twist, swing = swing_twist(R)

    np.testing.assert_allclose(rotation_matrix(pad(swing)) @ twist_matrix(twist), R, atol=1e-9)


def test_align_z_takes_z_to_the_direction():
    R = align_z([3.0, -1.0, 0.2])

    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    np.testing.assert_allclose(R[:, 2], np.array([3.0, -1, 0.2]) / np.linalg.norm([3, 1, 0.2]))


@pytest.mark.parametrize('pitch', [0.3, -1.35])
def test_sigmas_of_angles_are_those_that_small_turns_make(pitch):
    rng = np.random.default_rng(4)
    # intrinsic turns about z, y, x: Rz(yaw) Ry(pitch) Rx(roll)
    truth = Rotation.from_euler('ZYX', [-0.8, pitch, 0.2])
    root = 1e-4 * rng.standard_normal((3, 3))
    small = Rotation.from_rotvec(rng.standard_normal((4000, 3)) @ root.T)
    seen = np.std((small * truth).as_euler('ZYX'), axis=0)[::-1]
    np.testing.assert_allclose(angle_sigmas(pitch, -0.8, root @ root.T), seen, rtol=0.05)
