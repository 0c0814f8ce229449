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
"""Motion models: what they allow, and learning the plane of motion."""

import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.projection.motion_models import completed, motion_basis, PlaneLearner

AXIS = np.array([0.3, -0.8, -0.52])
AXIS = AXIS / np.linalg.norm(AXIS)


@pytest.mark.parametrize('motion, size, columns', (
    ('general', 6, 6), ('general', 7, 7), ('general', 8, 8), ('translation', 6, 3),
    ('translation', 7, 4), ('translation', 8, 2), ('planar', 6, 3), ('planar', 7, 4)))
def test_bases_are_orthonormal(motion, size, columns):
    basis = motion_basis(motion, size, AXIS)
    assert basis.shape == (size, columns)
    assert np.allclose(basis.T @ basis, np.eye(columns))
    whole = completed(basis)
    assert np.allclose(whole.T @ whole, np.eye(size))
    assert np.allclose(whole[:, :columns], basis)


def test_planar_motion_turns_about_the_axis_and_moves_across_it():
    basis = motion_basis('planar', 6, AXIS)
    assert np.allclose(np.abs(basis[:3, 0] @ AXIS), 1)
    assert np.allclose(AXIS @ basis[3:6, 1:], 0)
    assert np.allclose(basis[:3, 1:], 0)


def test_impossible_motions_are_refused():
    with pytest.raises(ArgumentError):
        motion_basis('planar', 6)
    with pytest.raises(ArgumentError):
        motion_basis('planar', 8, AXIS)


def poses(rng, noise, turning=True, straight=False):
    basis = motion_basis('planar', 6, AXIS)
    for k in range(60):
        angle = 0.02 * k if turning else 0.0
        way = basis[3:6, 1] * 0.004 * k
        if not straight:
            way = way + basis[3:6, 2] * 0.05 * np.sin(0.2 * k)
        yield (rotation_matrix(noise * rng.normal(size=3)) @ rotation_matrix(angle * AXIS),
               np.array([0.1, 0, 0.9]) + way + noise * 0.5 * rng.normal(size=3))


def learned(**kwargs):
    learner = PlaneLearner()
    covariance = np.diag([1e-3**2] * 3 + [0.5e-3**2] * 3)
    for rotation, translation in poses(np.random.default_rng(4), 1e-3, **kwargs):
        learner.add(rotation, translation, covariance)
    return learner.plane()


@pytest.mark.parametrize('kwargs', ({}, {'turning': False}, {'straight': True}))
def test_the_plane_is_learned_from_a_general_track(kwargs):
    plane = learned(**kwargs)
    error = np.arccos(min(abs(plane.axis @ AXIS), 1.0))
    assert error < np.deg2rad(0.5)
    assert error < 4 * plane.sigma_rad < 0.1


def test_a_straight_track_leaves_the_plane_open():
    assert not np.isfinite(learned(turning=False, straight=True).sigma_rad)


def test_too_few_poses_leave_the_plane_open():
    assert not np.isfinite(PlaneLearner().plane().sigma_rad)
