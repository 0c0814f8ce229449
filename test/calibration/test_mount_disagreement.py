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

from bench.mounts import mount_worlds as worlds
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from selfcal_ros.calibration.mount import MountFacts
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


@pytest.mark.long
@pytest.mark.parametrize('kind', ['hand', 'drive'])
@pytest.mark.parametrize('seed', range(2))
def test_inverse_poses_are_told_and_right_ones_are_not_suspected(kind, seed):
    calibration, poses = robot(kind, seed)
    refused = mount_camera(calibration, inverse(poses)).mount
    assert not refused and refused.kind == 'body_poses_inverse' and str(VIEWS) in str(refused)
    assert mount_camera(calibration, poses).mount


@pytest.mark.long
@pytest.mark.parametrize('kind, apart', [('drive', 2.0), ('hand', -3.3)])
def test_clocks_seconds_apart_are_named_and_right_once_that_is_stated(kind, apart):
    """Of a drive two seconds off, x and the scale came out 4 to 5 sigmas off in silence."""
    rng = np.random.default_rng(5)
    move, images = getattr(worlds, kind), 0.5 + 0.5 * np.arange(VIEWS)
    own = np.arange(0, 13.5, 0.05)
    world = worlds.World(*move(images), worlds.mount_of(rng), kind == 'drive')
    calibration = worlds.calibrated(rng, world)
    instants = {'stamps_ns': np.round(own * 1e9).astype(int)}
    poses = (worlds.odometry(rng, *move(own), (0.01, 0.003, 0.01), **instants)
             if kind == 'drive' else worlds.measured(rng, *move(own), 1e-3, 1e-3, **instants))
    stamps = {k: int(round((t + apart) * 1e9)) for k, t in enumerate(images)}
    refused = mount_camera(calibration, poses, stamps).mount
    assert not refused and refused.kind == 'body_clocks_apart'
    assert refused.values['offset_s'] == pytest.approx(apart, abs=0.1)
    assert f'time_offset={refused.values["offset_s"]:.2f}:0.2' in refused.advice
    stated = MountFacts(time_offset=(refused.values['offset_s'], 0.2))
    mount = mount_camera(calibration, poses, stamps, stated).mount
    assert abs(mount.time_offset_s - apart) < 3.5 * mount.sigma['time_offset'] < 0.2


def test_a_body_that_only_turns_is_told_so():
    # the fixed point of a seed whose noise asks for a scale below zero
    kinds = set()
    for seed in range(6):
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


def shifted(poses):
    """Return each pose with the image after its own."""
    return replace(poses, rotation=np.roll(poses.rotation, 1, axis=0),
                   position=np.roll(poses.position, 1, axis=0))


def permuted(poses):
    """Return poses whose quaternions x, y, z, w were read as w, x, y, z."""
    w, x, y, z = Rotation.from_matrix(poses.rotation).as_quat().T
    return replace(poses, rotation=Rotation.from_quat(np.column_stack([x, y, z, w])).as_matrix())


def mirrored(poses):
    """Return poses in a left-handed frame, but for their turns."""
    return replace(poses, position=poses.position * [1, -1, 1])


def angles(poses):
    """Return poses whose roll, pitch and yaw were read as rotation vectors."""
    own = Rotation.from_matrix(poses.rotation).as_euler('xyz')
    return replace(poses, rotation=Rotation.from_rotvec(own).as_matrix())


@pytest.mark.long
@pytest.mark.parametrize('spoil, kind, told', [
    (angles, 'body_angles_as_vectors', 'seem to be roll, pitch and yaw'),
    (shifted, 'body_poses_shifted', 'image before'),
    (permuted, 'body_quaternions_permuted', 'order x, y, z, w, under the names w, x, y, z'),
    (mirrored, 'body_positions_mirrored', 'y has the wrong sign')])
def test_a_mistake_that_can_be_undone_is_named(spoil, kind, told):
    for seed in range(3):
        # arms move from image to image by chance
        rng = np.random.default_rng([seed, 5])
        turns, places = (size * rng.uniform(-1, 1, (VIEWS, 3)) for size in (0.35, 0.3))
        world = worlds.World(rotation_matrix(turns), places, worlds.mount_of(rng), False)
        calibration = worlds.calibrated(rng, world)
        poses = worlds.measured(rng, world.rotation, world.position, 1e-3, 1e-3, **FRAMES)
        assert mount_camera(calibration, poses).mount
        refused = mount_camera(calibration, spoil(poses)).mount
        assert not refused and refused.kind == kind and told in refused.reason


@pytest.mark.parametrize('seed', range(2))
def test_a_stated_sigma_that_is_ten_times_too_small_is_named(seed):
    calibration, poses = robot('hand', seed)
    true = replace(poses, sigma_position_m=1e-3, sigma_rotation_rad=1e-3)
    assert mount_camera(calibration, true).mount.outlier_count == 0
    small = replace(poses, sigma_position_m=1e-4, sigma_rotation_rad=1e-3)
    refused = mount_camera(calibration, small).mount
    assert not refused and refused.kind == 'robot_sigma_too_small'
    stated, = refused.values['stated']
    shown, = refused.values['shown']
    assert stated == '0.1 mm' and float(shown.split()[0]) == pytest.approx(1.0, rel=0.4)


def test_mirrors_of_a_plane_are_told_together():
    """Odometry whose y points to the right was said to have x and y swapped, by chance."""
    rng = np.random.default_rng(2)
    path = worlds.drive(0.5 * np.arange(22))
    world = worlds.World(*path, worlds.mount_of(rng), True)
    poses = worlds.odometry(rng, *path, (0.004, 0.001, 0.01), frames=np.arange(22))
    mount = mount_camera(worlds.calibrated(rng, world), mirrored(poses)).mount
    assert not mount and mount.kind == 'body_positions_mirrored'
    for how in ('y has the wrong sign', 'x and y are swapped'):
        assert how in str(mount)
