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
"""What hides itself, and where it ends, on surfaces whose geometry is plain."""

import numpy as np
import pytest
from selfcal_ros.rorapid.visibility.depth_buffer import DepthBuffer


def square(half, depth, x=0.0):
    """Points all over a square across the optical axis, (3, N)."""
    at = np.linspace(-half, half, 150)
    u, v = np.meshgrid(at + x, at)
    return np.stack([u.ravel(), v.ravel(), np.full(u.size, depth)])


def test_a_small_square_hides_what_is_behind_it_and_nothing_else():
    buffer = DepthBuffer(np.concatenate([square(0.2, 2.0), square(0.05, 1.0)], axis=1))
    behind = np.array([[0.0, 0, 2], [0.08, 0.08, 2], [0.15, 0, 2], [-0.17, 0.17, 2]]).T
    assert buffer.hides(behind, 0.1).tolist() == [True, True, False, False]
    # the surface does not hide itself, nor what is nearer than it by less than the margin
    assert not buffer.hides(square(0.19, 2.0)[:, np.abs(square(0.19, 2.0)[:2]).max(axis=0) > 0.12],
                            0.1).any()
    assert not buffer.hides(behind, 1.1).any()


@pytest.mark.parametrize('shift', (0.0, 0.7))
def test_a_surface_ends_at_its_border_only(shift):
    buffer = DepthBuffer(square(0.2, 1.0, shift))
    rim = np.array([[0.2, 0, 1], [-0.2, 0.1, 1], [0.1, 0.2, 1], [0.0, -0.2, 1]]).T
    out = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]).T
    rim[0] += shift
    assert buffer.ends_beside(rim, out).all()
    assert not buffer.ends_beside(rim, -out).any()
    assert not buffer.ends_beside(0.5 * rim + 0.5 * np.array([[shift], [0], [1]]), out).any()


def test_a_rim_before_another_part_is_no_end():
    buffer = DepthBuffer(np.concatenate([square(0.2, 2.0), square(0.05, 1.0)], axis=1))
    rim, out = np.array([[0.05, 0, 1.0]]).T, np.array([[1.0, 0, 0]]).T
    assert not buffer.ends_beside(rim, out).any()


def test_another_part_behind_a_rim_is_told_from_the_background():
    buffer = DepthBuffer(np.concatenate([square(0.2, 2.0), square(0.05, 1.0)], axis=1))
    rim = np.array([[0.05, 0, 1.0], [0.0, -0.05, 1.0], [0.2, 0, 2.0]]).T
    out = np.array([[1.0, 0, 0], [0, -1, 0], [1, 0, 0]]).T
    assert buffer.farther_beside(rim, out, 0.1).tolist() == [True, True, False]
    assert not buffer.farther_beside(rim, out, 1.1).any()
    assert not buffer.farther_beside(rim, -out, 0.1).any()


def test_points_far_outside_see_the_background():
    buffer = DepthBuffer(square(0.2, 1.0))
    far = np.array([[50.0, -40, 1], [-1e6, 1e6, 1]]).T
    assert not buffer.hides(far, 0.0).any() and buffer.ends_beside(far, far).all()
