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
"""A rig on a robot: the mount of its first camera, and metres without a stated length."""

from functools import cache, cached_property
import json

from bench.mounts.mount_worlds import odometry
import numpy as np
import pytest
from selfcal_ros import calibrate_rig, CameraFacts
from selfcal_ros.calibration.mount import mount_rotation, NAMES
from selfcal_ros.calibration.mounting.mounting import mount_camera
from selfcal_ros.calibration.rigs.on_robot import on_robot
from selfcal_ros.cli.main import main
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_vector
from selfcal_ros.synthetic.rig_scenes import driven_path, hand_path, rig_scene
from selfcal_ros.values.body_poses import BodyPoses

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
VIEWS = 24


class Robot:
    """A rig, the robot that carries it, and where the first camera sits on that."""

    def __init__(self, kind, overlap, seed):
        rng = np.random.default_rng(seed)
        path = driven_path(VIEWS) if kind == 'drive' else hand_path(rng, 14)
        self.scene = rig_scene(rng, path, overlap, points=250)
        self.mount = np.eye(4)
        self.mount[:3, :3] = mount_rotation(0, np.radians(20), np.radians(3))
        self.mount[:3, 3] = 0.3, 0.1, 0.6
        cameras = np.broadcast_to(np.eye(4), (len(path), 4, 4)).copy()
        cameras[:, :3] = path
        body = np.linalg.inv(cameras) @ np.linalg.inv(self.mount)
        frames = np.arange(len(path))
        self.poses = odometry(rng, body[:, :3, :3], body[:, :3, 3], (0.01, 0.002, 0.003),
                              frames=frames) if kind == 'drive' else BodyPoses(
            body[:, :3, :3], body[:, :3, 3] + 1e-3 * rng.standard_normal((len(path), 3)),
            frames=frames)
        self.overlap = overlap

    @cached_property
    def rig(self):
        return calibrate_rig(self.scene.tracks, shared_tracks=self.overlap, facts=FACTS)

    @cached_property
    def found(self):
        return on_robot(self.rig, mount_camera(self.rig.cameras['left'], self.poses))

    def errors(self):
        """Of the mount, and of the second camera, over their sigmas."""
        mount, pose = self.found.cameras['left'].mount, self.found.poses['right']
        T = self.scene.T_rig_camera['right']
        turns = (rotation_vector(a[:3, :3] @ b[:3, :3].T) for a, b in (
            (mount.T_body_camera, self.mount), (pose.T_rig_camera, T)))
        return (np.r_[mount.T_body_camera[:3, 3] - self.mount[:3, 3], next(turns)]
                / [mount.sigma[name] for name in NAMES[:6]],
                np.r_[pose.T_rig_camera[:3, 3] - T[:3, 3], next(turns)]
                / list(pose.sigma.values()))


# a rig is calibrated once for all tests that ask for it
robot_of = cache(Robot)


@pytest.mark.long
def test_an_arm_gives_a_rig_its_place_and_metres():
    robot = robot_of('hand', True, 3)
    found = robot.found
    assert found.unit == 'm' and np.isclose(found.scale, robot.scene.step_m, rtol=0.01)
    for errors in robot.errors():
        assert np.abs(errors).max() < 3.5
    pose = found.poses['right']
    assert np.isclose(pose.baseline, robot.scene.baseline_m, atol=0.006)
    # one covariance, of all, in metres, and it has what the scale may be off
    rows = [found.parameter_names.index(f'right.{name}') for name in 'xyz']
    assert np.allclose(found.covariance[np.ix_(rows, rows)], pose.covariance[:3, :3])
    metres = found.scale / robot.rig.scale
    before = metres * np.array([robot.rig.poses['right'].sigma[name] for name in 'xyz'])
    assert (np.array([pose.sigma[name] for name in 'xyz']) >= before).all()
    # the path is in metres, too
    path = found.reconstruction.cam_from_world
    centres = np.einsum('vji,vj->vi', path[:, :, :3], -path[:, :, 3])
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    assert np.isclose(np.sqrt(np.mean(steps**2)), robot.scene.step_m, rtol=0.01)


@pytest.mark.long
def test_odometry_gives_metres_and_no_height():
    robot = robot_of('drive', False, 5)
    found, T = robot.found, robot.scene.T_rig_camera['right']
    mount, pose = found.cameras['left'].mount, found.poses['right']
    assert found.unit == 'm' and mount.status['z'] == 'unobservable'
    for errors in robot.errors():
        assert np.abs(errors[np.isfinite(errors)]).max() < 3.5
    assert pose.status['y'] == 'unobservable' and len(pose.places) == 2
    for one in pose.places:
        assert abs(one.direction @ T[:3, 3] - one.value) < 3.5 * one.sigma


@pytest.mark.long
@pytest.mark.parametrize('off', [1.0, 1.05])
def test_a_baseline_that_the_robot_contradicts_is_told(off):
    robot = robot_of('hand', True, 3)
    rig = calibrate_rig(robot.scene.tracks, shared_tracks=True, facts=FACTS,
                        baseline=(off * robot.scene.baseline_m, 0.0005))
    found = on_robot(rig, mount_camera(rig.cameras['left'], robot.poses))
    told = [one for one in found.findings if one.kind == 'rig_metres_differ']
    assert len(told) == (off > 1)
    if told:
        assert told[0].values['scale']['value'] == pytest.approx(1 / off, rel=0.01)


def test_a_robot_that_says_nothing_leaves_the_rig_as_it_was():
    robot = robot_of('hand', True, 3)
    still = BodyPoses(np.broadcast_to(np.eye(3), (14, 3, 3)).copy(), np.zeros((14, 3)),
                      frames=np.arange(14))
    found = on_robot(robot.rig, mount_camera(robot.rig.cameras['left'], still))
    assert found.unit == 'path' and isinstance(found.cameras['left'].mount, NoEstimate)
    assert np.array_equal(found.covariance, robot.rig.covariance)


@pytest.mark.long
@pytest.mark.parametrize('stated', [False, True])
def test_the_command_takes_a_robot_beside_several_cameras(tmp_path, capsys, stated):
    robot = robot_of('drive', False, 5)
    for name, tracks in robot.scene.tracks.items():
        tracks.to_csv(tmp_path / f'{name}.csv')
    rows = ['frame,x,y,theta'] + [
        f'{k},{p[0]},{p[1]},{np.arctan2(R[1, 0], R[0, 0])}'
        for k, (R, p) in enumerate(zip(robot.poses.rotation, robot.poses.position))]
    (tmp_path / 'poses.csv').write_text('\n'.join(rows) + '\n', encoding='utf-8')
    urdf = tmp_path / 'left.urdf'
    status = main(['calibrate', str(tmp_path / 'left.csv'), str(tmp_path / 'right.csv'),
                   '--cameras', 'left,right', '--lens', 'none', '--image-size', '640', '480',
                   '--robot', str(tmp_path / 'poses.csv'), '--mount-output', str(urdf),
                   '--output', str(tmp_path / 'camera.yaml'), '--json',
                   str(tmp_path / 'result.json'),
                   *(['--mount-fact', 'z=0.6:0.01'] if stated else [])])
    said, content = capsys.readouterr(), json.loads((tmp_path / 'result.json').read_text('utf-8'))
    # a file that was asked for is missing where z is open
    assert status == (0 if stated else 1)
    assert content['unit'] == 'm' and content['mount']['frame'] == 'base_link'
    assert 'The camera on base_link' in said.out and ' mm' in said.out
    # without all six numbers there is no transform, and why is said
    assert urdf.exists() == stated and ('z of the mount' in said.err) != stated
