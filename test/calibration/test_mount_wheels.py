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
"""Mounts from wheels that slip and by clocks that differ: nothing wrong passes for the rule."""

from dataclasses import replace

from bench.mounts import mount_worlds as worlds
from bench.mounts.mounts import simulated
import numpy as np
import pytest
from selfcal_ros.calibration.mount import NAMES
from selfcal_ros.calibration.mounting.mounting import mount_camera
from selfcal_ros.geometry.rotation import rotation_matrix

SLIPS = 3
SLIP_M, SLIP_RAD = 0.05, 0.03


def in_sigmas(mount, world, calibration, late):
    """Errors of what was estimated."""
    use = [k for k, name in enumerate(NAMES) if mount.status[name] == 'estimated']
    errors = worlds.mount_errors(mount, world.T_body_camera,
                                 worlds.true_scale(world, calibration), late)
    return errors[use] / np.sqrt(np.diag(mount.covariance))[use]


@pytest.mark.long
def test_of_two_offsets_of_the_clocks_the_likelier_is_taken():
    # turns and ways are alike at a wrong offset, too, with larger errors of the wheels
    world, calibration, poses, stamps, late = simulated(
        'drive by time', np.random.default_rng([16, 15]))
    mount = mount_camera(calibration, poses, stamps).mount
    assert mount.status['time_offset'] == 'estimated'
    assert np.abs(in_sigmas(mount, world, calibration, late)).max() < 4.5


def test_slips_of_the_wheels_do_not_hide_one_another():
    rng = np.random.default_rng([17, 0])
    world, calibration, poses, _, late = simulated('drive', rng)
    rotation, position = poses.rotation.copy(), poses.position.copy()
    for at in rng.choice(np.arange(2, len(position) - 2), SLIPS, replace=False):
        turn = rotation_matrix(np.array([0, 0, SLIP_RAD]))
        moved = (position[at:] - position[at - 1]) @ turn.T + SLIP_M * rotation[at - 1, :, 0]
        position[at:], rotation[at:] = position[at - 1] + moved, turn @ rotation[at:]
    mount = mount_camera(calibration, replace(poses, rotation=rotation, position=position)).mount
    assert SLIPS <= mount.outlier_count <= SLIPS + 1
    assert np.abs(in_sigmas(mount, world, calibration, late)).max() < 4
