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
"""A vehicle that drives one circle, or counts its turns the wrong way round: what is told."""

from dataclasses import replace

from bench.mounts import mount_worlds as worlds
import numpy as np
import pytest
from selfcal_ros.calibration.mount import mount_angles, MountFacts
from selfcal_ros.calibration.mounting.mounting import mount_camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.mounts.words import axis_sentence, mount_rows

ERRORS = (0.004, 0.001, 0.01)


def _circle(seconds, turning=0.45, speed=0.54):
    heading = turning * seconds
    place = speed / turning * np.stack([np.sin(heading), 1 - np.cos(heading), 0 * heading], axis=1)
    return rotation_matrix(heading[:, None] * [0.0, 0.0, 1.0]), place


def _on_a_circle(seed, timed):
    rng = np.random.default_rng(seed)
    images = 0.6 + 0.15 * np.arange(18)
    world = worlds.World(*_circle(images - 0.037 * timed), worlds.mount_of(rng), True)
    own = np.arange(0, 4, 0.02)
    poses = (worlds.odometry(rng, *_circle(own), ERRORS,
                             stamps_ns=np.round(own * 1e9).astype(int)) if timed else
             worlds.odometry(rng, *_circle(images), ERRORS, frames=np.arange(len(images))))
    stamps = {k: int(round(t * 1e9)) for k, t in enumerate(images)} if timed else None
    return world, mount_camera(worlds.calibrated(rng, world), poses, stamps).mount


@pytest.mark.long
def test_a_circle_shows_roll_and_pitch_in_numbers_and_asks_for_another_radius():
    for seed in range(2):
        world, mount = _on_a_circle(seed, False)
        assert mount.status['yaw'] == mount.status['scale'] == 'unobservable'
        truth = dict(zip(('roll', 'pitch', 'yaw'), mount_angles(world.T_body_camera[:3, :3])))
        for name in ('roll', 'pitch'):
            assert mount.status[name] == 'estimated'
            assert abs(mount.angles[name] - truth[name]) < 4 * mount.angles_sigma[name] < 0.02
        assert np.isnan(mount.angles['yaw'])
        for name in ('x', 'y', 'yaw', 'scale'):
            assert 'another radius' in mount.missing[name]
        assert 'height' in mount.missing['z']
        rows = {row.name: row for row in mount_rows(mount)}
        assert rows['pitch'].value and rows['pitch'].sigma and not rows['yaw'].value
        assert 'of base_link is (' in axis_sentence(mount)


@pytest.mark.long
def test_an_even_turn_does_not_tell_the_offset_of_the_clocks_by_its_noise():
    """One circle at one speed gave 0.43 s with a sigma of 0.03 s where 0.037 s were true."""
    _, mount = _on_a_circle(4, True)
    assert mount.status['time_offset'] == 'unobservable'
    assert np.isnan(mount.time_offset_s) and np.isinf(mount.sigma['time_offset'])
    assert 'offset of the clocks' in mount.missing['time_offset']


def test_an_angle_that_has_no_value_of_its_own_points_to_the_axis():
    world, mount = _on_a_circle(0, False)
    slanted = replace(mount, axis=replace(mount.axis, axis=np.array([1.0, 0.0, 0.0])))
    rows = {row.name: row for row in mount_rows(slanted)}
    assert not rows['pitch'].value and 'axis' in rows['pitch'].why


@pytest.mark.long
@pytest.mark.parametrize('facts, sign, told', [
    (MountFacts(), 1, False), (MountFacts(), -1, True),
    (MountFacts(roll=(np.pi, 0.1)), -1, False)])
def test_odometry_that_counts_turns_clockwise_is_told(facts, sign, told):
    rng = np.random.default_rng(2)
    frames = np.arange(22)
    R, p = worlds.drive(0.5 * frames)
    world = worlds.World(R, p, worlds.mount_of(rng), True)
    mirror = np.diag([1.0, sign, 1.0])
    poses = worlds.odometry(rng, mirror @ R @ mirror, p @ mirror, ERRORS, frames=frames)
    result = mount_camera(worlds.calibrated(rng, world), poses, facts=facts)
    found = [one for one in result.findings if one.kind == 'mount_upside_down']
    assert bool(found) == told
    if told:
        assert abs(found[0].values['roll_deg']) > 90
        assert 'turns to the left' in found[0].sentence
