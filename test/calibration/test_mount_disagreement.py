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
"""Poses of a body that no mount explains: the reason is said where one can be found."""

from dataclasses import replace

from bench import mount_worlds as worlds
import numpy as np
import pytest
from selfcal_ros.calibration.mounting.mounting import mount_camera
from selfcal_ros.geometry.rotation import rotation_matrix

VIEWS = 24
FRAMES = {'frames': np.arange(VIEWS)}


def inverse(poses):
    """Return the poses of the world in the body."""
    back = np.swapaxes(poses.rotation, 1, 2)
    return replace(poses, rotation=back,
                   position=-np.einsum('vij,vj->vi', back, poses.position))


def robot(kind, seed):
    """Return a calibration, and poses of the body that are as they should be."""
    rng, times = np.random.default_rng(seed), np.linspace(0, 12, VIEWS)
    path = worlds.hand(times) if kind == 'hand' else worlds.drive(times)
    world = worlds.World(*path, worlds.mount_of(rng), kind == 'drive')
    poses = (worlds.measured(rng, *path, 1e-3, 1e-3, **FRAMES) if kind == 'hand' else
             worlds.odometry(rng, *path, (0.01, 0.003, 0.01), **FRAMES))
    return worlds.calibrated(rng, world), poses


@pytest.mark.parametrize('kind', ['hand', 'drive'])
@pytest.mark.parametrize('seed', range(4))
def test_inverse_poses_are_told_and_right_ones_are_not_suspected(kind, seed):
    calibration, poses = robot(kind, seed)
    refused = mount_camera(calibration, inverse(poses)).mount
    assert not refused and refused.kind == 'body_poses_inverse' and str(VIEWS) in str(refused)
    assert mount_camera(calibration, poses).mount


def test_a_body_that_only_turns_is_told_so():
    # the fixed point of a seed whose noise asks for a scale below zero
    kinds = set()
    for seed in range(12):
        rng = np.random.default_rng(seed)
        turns = 0.3 * np.sin(np.outer(np.linspace(0, 1, VIEWS), rng.uniform(4, 9, 3))
                             + rng.uniform(0, 6, 3))
        path = rotation_matrix(turns), np.zeros((VIEWS, 3))
        world = worlds.World(*path, worlds.mount_of(rng), False)
        mount = mount_camera(worlds.calibrated(rng, world),
                             worlds.measured(rng, *path, 1e-3, 1e-3, **FRAMES)).mount
        if mount:
            assert mount.status['scale'] == 'unobservable'
        else:
            kinds.add(mount.kind)
            assert mount.values['moved_mm'] < 5
    assert kinds == {'body_only_turned'}


def test_poses_of_something_else_have_no_other_reason():
    calibration, _ = robot('hand', 1)
    _, others = robot('hand', 2)
    rng = np.random.default_rng(0)
    order = rng.permutation(VIEWS)
    mixed = replace(others, rotation=others.rotation[order], position=others.position[order])
    mount = mount_camera(calibration, mixed).mount
    assert not mount and mount.kind in ('no_mount_fits', 'body_turns_otherwise',
                                        'body_poses_wrong')
