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
"""`selfcal calibrate --robot`: where the camera sits, in words and files; wrong options."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from selfcal_ros.calibration.mount import mount_rotation
from selfcal_ros.errors import ArgumentError
from selfcal_ros.report.mounts import transform_files
from selfcal_ros.report.mounts.transform_reading import read_transform
from selfcal_ros.synthetic.scenes import observe, sequence_si
from test_support.command_line import selfcal, SIZE

#: Metres in a unit of the synthetic scene.
UNIT_M = 0.5


@pytest.fixture(scope='module')
def arm(tmp_path_factory):
    """Write tracks of a moving camera and the poses of the arm; return both and the truth."""
    rng = np.random.default_rng(5)
    still = sequence_si(rng, 0.0, points=rng.uniform(-1, 1, (120, 3)))
    turns = Rotation.from_rotvec(rng.uniform(-0.25, 0.25, (14, 3))).as_matrix()
    places = np.array([0, 0, 4.0]) + rng.uniform(-0.4, 0.4, (14, 3))
    rotation = turns @ still.cam_from_world[0, :, :3]
    scene = observe(rng, still.camera, np.concatenate([rotation, places[:, :, None]], axis=2),
                    still.points, 0.1)
    folder = tmp_path_factory.mktemp('arm')
    scene.tracks.to_csv(folder / 'tracks.csv')
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = mount_rotation(0.1, -0.4, 0.7), (0.06, -0.02, 0.11)
    cameras = np.broadcast_to(np.eye(4), (len(scene.cam_from_world), 4, 4)).copy()
    cameras[:, :3] = scene.cam_from_world
    cameras = np.linalg.inv(cameras)
    cameras[:, :3, 3] *= UNIT_M
    body = cameras @ np.linalg.inv(mount)
    place = body[:, :3, 3] + rng.normal(0, 3e-4, (len(body), 3))
    wrong = Rotation.from_rotvec(rng.normal(0, 3e-4, (len(body), 3)))
    turn = (wrong * Rotation.from_matrix(body[:, :3, :3])).as_rotvec()
    lines = ['frame,tx,ty,tz,rx,ry,rz', *(
        ','.join([str(k), *map(str, row)])
        for k, row in enumerate(np.column_stack([place, turn]).tolist()))]
    (folder / 'poses.csv').write_text('\n'.join(lines) + '\n', encoding='utf-8')
    return folder, mount, cameras


def test_an_arm_tells_where_its_camera_sits(arm, capsys):
    folder, truth, cameras = arm
    assert selfcal('calibrate', folder / 'tracks.csv', *SIZE, '--robot', folder / 'poses.csv',
                   '--robot-frame', 'tool0', '--json', 'a.json', '--mount-output', 'a.urdf',
                   '--camera-frame', 'eye', '--poses', 'a.tum') == 0
    out = capsys.readouterr().out
    assert 'The camera on tool0' in out and 'each pose belongs to its image' in out
    told = json.loads(open('a.json', encoding='utf-8').read())['mount']
    found = np.array(told['T_body_camera'])
    sigma = np.array([told['sigma'][name] for name in ('x', 'y', 'z')])
    assert (np.abs(found - truth)[:3, 3] < 4 * sigma).all() and sigma.max() < 2e-3
    turned = Rotation.from_matrix(found[:3, :3] @ truth[:3, :3].T).magnitude()
    assert turned < 4 * np.linalg.norm([told['sigma'][name] for name in ('roll', 'pitch', 'yaw')])
    assert set(told['status'].values()) == {'estimated', 'held'}
    _, urdf = read_transform('a.urdf')
    assert (urdf.parent, urdf.child) == ('tool0', 'eye') and np.allclose(urdf.matrix, found)
    # the path is as long as that of the arm's camera
    rows = np.loadtxt('a.tum')
    ways = [np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
            for places in (rows[:, 1:4], cameras[rows[:, 0].astype(int), :3, 3])]
    assert ways[0] == pytest.approx(ways[1], rel=0.01)


def test_a_mount_that_cannot_be_written_is_no_success(arm, capsys, monkeypatch):
    def refuse(*_):
        raise ArgumentError('z of the mount is not observable; measure it.')

    monkeypatch.setattr(transform_files, 'stored_mount', refuse)
    assert selfcal('calibrate', arm[0] / 'tracks.csv', *SIZE, '--robot', arm[0] / 'poses.csv',
                   '--mount-output', 'a.urdf', '-q') == 1
    assert capsys.readouterr().err == ('a.urdf was not written: z of the mount is not observable; '
                                       'measure it.\n')
    assert sorted(path.name for path in Path().iterdir()) == ['camera.yaml']


@pytest.mark.parametrize('options, words', [
    (['--robot', 'none.csv'], 'none.csv'),
    (['--robot', '/odom'], 'is no bag, so it has no topic /odom'),
    (['--robot', '/tf:odom'], '/tf:FIXED:BODY'),
    (['--robot-unit', '0.001'], 'needs the poses of a robot'),
    (['--mount-output', 'a.urdf'], '--mount-output needs'),
    (['--robot', 'POSES', '--mount-fact', 'height=0.5'], 'NAME=VALUE:SIGMA'),
    (['--robot', 'POSES', '--mount-fact', 'z=0.5', '--mount-fact', 'z=1'], 'z twice'),
    (['--robot', 'POSES', '--mount-fact', 'z=0.5:-1'], 'sigma'),
    (['--robot', 'POSES', '--mount-fact', 'z=520'], 'state metres up to 100'),
    (['--robot', 'POSES', '--mount-fact', 'yaw=3600'], 'degrees from -360 to 360'),
    (['--robot', 'POSES', '--mount-fact', 'scale=1e-9'], 'from 0.001 to 1000'),
    (['--robot', 'POSES', '--mount-fact', 'scale=1e9'], 'from 0.001 to 1000'),
    (['--robot', 'POSES', '--mount-fact', 'time_offset=1e300'], 'state seconds up to 1e10'),
    (['--robot', 'POSES', '--robot-sigma', '0.1'], '0.001:0.05'),
    (['--robot', 'POSES', '--robot-unit', '-1'], '--robot-unit'),
    (['--robot', 'POSES', '--mount-output', 'a.txt'], '.urdf'),
    (['--robot', 'POSES', '--camera-frame', 'a b', '--mount-output', 'a.urdf'], 'name of a'),
    (['--robot', 'POSES', '--motion', 'repeated'], 'equal objects')])
def test_wrong_options_are_a_sentence(arm, capsys, options, words):
    folder = arm[0]
    given = [str(folder / 'poses.csv') if one == 'POSES' else one for one in options]
    assert selfcal('calibrate', folder / 'tracks.csv', *SIZE, *given) == 2
    assert words in capsys.readouterr().err
