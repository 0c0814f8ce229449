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
"""Several cameras of one object, from files: transforms, instants, the command line."""

from dataclasses import replace
from functools import lru_cache
import json
import weakref

import cv2
import numpy as np
import pytest

from selfcal_ros.cli.main import main
from selfcal_ros.errors import InputError
from selfcal_ros.pipeline.rig_session import RigSession
from selfcal_ros.pipeline.simultaneous import (
    MOST_WAITING, SAME_NS, simultaneous, StampGroups)
from selfcal_ros.pipeline.sources import open_source
from selfcal_ros.report.camera_files.kalibr_chain import kalibr_text
from selfcal_ros.report.camera_files.rig_reading import read_rig, ROUGH_M
from selfcal_ros.report.camera_yaml import write_camera_yaml
from selfcal_ros.report.poses_csv import read_poses
from selfcal_ros.rorapid.model import write_model
from selfcal_ros.synthetic.objects import perturbed, pose_errors
from selfcal_ros.synthetic.several_cameras import object_before_cameras, turned_camera
from selfcal_ros.values.camera_rig import placed_beside, PlacedCamera

VIEWS = 10


@lru_cache(maxsize=None)
def scene():
    recordings, cameras = object_before_cameras(VIEWS, 'l_block', seed=51, supersampling=2)
    return recordings, cameras, [[image for image, _ in one.frames()] for one in recordings]


def chain(path, cameras, **extra):
    text = ''
    for k, one in enumerate(cameras):
        text += kalibr_text(one.camera, topic=f'/rig/side{k}/image_raw').replace(
            'cam0:', f'cam{k}:', 1)
        if k and not extra.get('alone'):
            T = np.linalg.inv(one.T_rig_camera) @ cameras[k - 1].T_rig_camera
            rows = ''.join(f'  - [{", ".join(f"{x:.12g}" for x in row)}]\n' for row in T)
            text += f'  T_cn_cnm1:\n{rows}'
    path.write_text(text)
    return path


@pytest.fixture
def command(tmp_path):
    recordings, cameras, images = scene()
    for side, some in zip(('left', 'right'), images):
        (tmp_path / side).mkdir()
        for k, image in enumerate(some):
            if side == 'left' or k != 4:
                cv2.imwrite(str(tmp_path / side / f'{k:03d}.png'), image)
    truth = recordings[0]
    R, t = perturbed(truth.rotations[0], truth.translations[0], np.random.default_rng(2), 0.03,
                     0.002)
    init = ' '.join(f'{x:.6f}' for x in (*t, *cv2.Rodrigues(R)[0].ravel()))
    return ['track', str(tmp_path / 'left'), str(tmp_path / 'right'), '--cameras', 'cam0,cam1',
            '--rig', str(chain(tmp_path / 'camchain.yaml', cameras)), '--init', init, '--model',
            str(write_model(truth.model, tmp_path / 'l.yaml')), '--output',
            str(tmp_path / 'poses.csv'), '--overlay', str(tmp_path / 'out.avi')]


@pytest.mark.long
def test_the_command_line_gives_one_pose_of_two_folders(command, tmp_path, capsys):
    truth = scene()[0][0]
    assert main(command) == 0
    told = capsys.readouterr().out
    assert f'Tracked in {VIEWS} of {VIEWS} images' in told
    assert f'The object was seen by cam0 in {VIEWS}, cam1 in {VIEWS - 1}.' in told
    assert 'one camera cannot' not in told
    poses = read_poses(tmp_path / 'poses.csv')
    angle, share = pose_errors(poses['rotation'], poses['translation'], truth.rotations,
                               truth.translations)
    assert np.rad2deg(angle.max()) < 0.3 and share.max() < 0.003
    for name, count in (('cam0', VIEWS), ('cam1', VIEWS - 1)):
        assert int(cv2.VideoCapture(str(tmp_path / f'out_{name}.avi')).get(
            cv2.CAP_PROP_FRAME_COUNT)) == count


def test_a_wrong_transform_is_told_in_the_outcome(command, tmp_path, capsys):
    _, cameras, _ = scene()
    chain(tmp_path / 'camchain.yaml', [cameras[0], turned_camera(cameras[1], 2.0)])
    assert main(command) == 0
    told = capsys.readouterr().out
    assert 'degraded' in told and 'sees the object elsewhere' in told


@pytest.mark.parametrize('change, sentence', (
    (('--cameras', 'cam0,cam7'), 'has no cameras cam7; it has cam0 (/rig/side0/image_raw), cam1'),
    (('--cameras', 'cam0'), '--cameras takes the names of two or more cameras'),
    (('--cameras', None), '--rig needs --cameras'),
    (('--rig', None), '--cameras needs --rig'),
    (('--topic', '/a'), '--topic is for a single camera'),
    (('--camera', 'CAMERA'), '--rig has the calibrations of all cameras'),
    (('--motion', 'translation'), 'need motion general, not translation'),
    (('--rig-sigma', '-1', '0'), '--rig-sigma takes degrees and metres'),
    (('--rig', 'CAMERA'), 'holds no rig')))
def test_what_does_not_fit_is_one_sentence(command, tmp_path, capsys, change, sentence):
    camera = write_camera_yaml(tmp_path / 'camera.yaml', scene()[1][0].camera, 'camera')
    name, *values = change
    if name in command:
        at = command.index(name)
        del command[at:at + 2]
    command += [] if values == [None] else [name, *(
        str(camera) if value == 'CAMERA' else value for value in values)]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert sentence in error and len(error.strip().splitlines()) == 1


def test_one_camera_still_takes_one_input(command, tmp_path, capsys):
    camera = write_camera_yaml(tmp_path / 'camera.yaml', scene()[1][0].camera, 'camera')
    at = command.index('--cameras')
    del command[at:at + 4]
    assert main(command) == 2 and 'Say how the camera is calibrated' in capsys.readouterr().err
    assert main([*command, '--camera', str(camera)]) == 2
    assert 'There are 2 INPUTs for one camera' in capsys.readouterr().err
    del command[2]
    assert main([*command, '--camera', str(camera)]) == 0


def test_transforms_are_read_alike_from_a_chain_and_from_result_json(tmp_path):
    _, cameras, _ = scene()
    read = read_rig(chain(tmp_path / 'camchain.yaml', cameras), ['cam0', 'side1'])
    assert [one.name for one in read] == ['cam0', 'side1']
    assert np.allclose(read[1].T_rig_camera, cameras[1].T_rig_camera, atol=1e-9)
    assert read[1].covariance[0, 0] == pytest.approx(ROUGH_M**2)
    swapped = read_rig(tmp_path / 'camchain.yaml', ['cam1', 'cam0'], sigma=(0.1, 0.001))
    assert np.allclose(swapped[1].T_rig_camera, np.linalg.inv(cameras[1].T_rig_camera))
    assert swapped[1].covariance[5, 5] == pytest.approx(np.deg2rad(0.1)**2)
    with pytest.raises(InputError, match='lacks T_cn_cnm1'):
        read_rig(chain(tmp_path / 'alone.yaml', cameras, alone=True))
    (tmp_path / 'one.json').write_text(json.dumps({'K': 1}))
    with pytest.raises(InputError, match='is of a single camera'):
        read_rig(tmp_path / 'one.json')


def test_errors_of_the_first_place_are_those_of_the_others():
    rng = np.random.default_rng(0)
    _, cameras, _ = scene()
    spread = np.diag(np.square([1e-3, 2e-3, 3e-3, 1e-3, 2e-3, 3e-3]))
    there = [PlacedCamera('a', cameras[0].camera, cameras[1].T_rig_camera, spread),
             PlacedCamera('b', cameras[0].camera, np.linalg.inv(cameras[1].T_rig_camera))]
    first, second = placed_beside(there)
    assert np.array_equal(first.T_rig_camera, np.eye(4)) and not first.covariance.any()
    drawn = []
    for draw in rng.multivariate_normal(np.zeros(6), spread, 4000):
        T = there[0].T_rig_camera.copy()
        T[:3, 3] += draw[:3]
        T[:3, :3] = cv2.Rodrigues(draw[3:])[0] @ T[:3, :3]
        moved = np.linalg.inv(T) @ there[1].T_rig_camera
        turn = cv2.Rodrigues(moved[:3, :3] @ second.T_rig_camera[:3, :3].T)[0].ravel()
        drawn.append(np.r_[moved[:3, 3] - second.T_rig_camera[:3, 3], turn])
    seen = np.cov(np.array(drawn).T)
    scale = np.sqrt(np.diag(second.covariance))
    assert np.abs((seen - second.covariance) / np.outer(scale, scale)).max() < 0.1


def test_instants_are_complete_or_waited_for_no_longer_than_an_image():
    groups = StampGroups(2)
    assert groups.add(0, 0, 'a0') == []
    assert groups.add(1, SAME_NS, 'b0') == [(0, ['a0', 'b0'])]
    # a late one is waited for, and one that was left out is known by the next
    assert groups.add(0, 33_000_000, 'a1') == [] and groups.add(0, 66_000_000, 'a2') == []
    assert groups.add(1, 34_000_000, 'b1') == [(33_000_000, ['a1', 'b1'])]
    assert groups.add(0, 99_000_000, 'a3') == []
    assert groups.add(1, 99_000_000, 'b3') == [(66_000_000, ['a2', None]),
                                               (99_000_000, ['a3', 'b3'])]
    # one that is gone is waited for by 0.1 s at the most, and then no longer
    done = [groups.add(0, 133_000_000 + k * 34_000_000, k) for k in range(8)]
    assert [len(one) for one in done] == [0, 0, 0, 1, 4, 1, 1, 1]
    assert not groups.late
    # and time may jump back
    assert groups.add(1, 0, 'b') == [] and groups.add(0, 0, 'a') == [(0, ['a', 'b'])]


def test_images_of_one_camera_whose_stamps_stand_still_are_not_gathered():
    groups, images = StampGroups(2), [np.zeros(1) for _ in range(3 * MOST_WAITING)]
    alive = [weakref.ref(one) for one in images]
    for k in range(len(images)):
        groups.add(0, 0, images[k])
        images[k] = None
    assert sum(one() is not None for one in alive) <= MOST_WAITING
    # with a clock it goes on, and the other camera is not waited for
    assert groups.add(0, 10**9, 'a')[-1] == (10**9, ['a', None])


def test_what_came_too_late_is_counted_and_dropped():
    groups = StampGroups(2)
    groups.add(0, 100_000_000, 'a')
    groups.add(0, 233_000_000, 'a')
    assert groups.add(1, 95_000_000, 'b') == [] and groups.add(1, 100_000_000, 'b') == []
    assert groups.late == 2


def test_folders_belong_together_by_name(command):
    left, right = command[1:3]
    with open_source(left) as one, open_source(right) as other:
        instants = list(simultaneous([one, other]))
    assert len(instants) == VIEWS and instants[4][1] is None
    assert all(a is None or b is None or a.name == b.name for a, b in instants)


@pytest.mark.parametrize('missing', [0, 9])
def test_folders_are_merged_in_the_order_of_numbers(tmp_path, missing):
    for folder, left_out in (('left', None), ('right', missing)):
        (tmp_path / folder).mkdir()
        for k in range(13):
            if k != left_out:
                cv2.imwrite(str(tmp_path / folder / f'frame{k}.png'), np.full((48, 64), k, 'u1'))
    with open_source(tmp_path / 'left') as one, open_source(tmp_path / 'right') as other:
        instants = list(simultaneous([one, other]))
    assert [a.name for a, _ in instants] == [f'frame{k}.png' for k in range(13)]
    assert [b and b.name for _, b in instants] == [
        None if k == missing else f'frame{k}.png' for k in range(13)]


def test_a_start_that_only_one_camera_sees_is_enough_and_sizes_are_checked():
    recordings, cameras, images = scene()
    truth = recordings[0]
    session = RigSession(truth.model, cameras)
    with pytest.raises(InputError, match='no start pose yet'):
        session.look([images[0][0], None])
    with pytest.raises(InputError, match='outside the image'):
        session.start(truth.rotations[0], truth.translations[0] + [0, 3.0, 0])
    session.start(truth.rotations[0], truth.translations[0])
    with pytest.raises(InputError, match='cam1: The image is 320x480'):
        session.look([images[0][0], images[1][0][:, :320]])
    assert session.look([images[0][0], None], 0).sees == (True, False)
    assert session.look([None, images[1][1]], 33_000_000).sees == (False, True)
    assert session.snapshot().images == 2 and session.newest.state.value == 'tracking'


def test_the_same_cameras_once_more_change_nothing():
    recordings, cameras, images = scene()
    truth = recordings[0]
    sessions = [RigSession(truth.model, cameras) for _ in range(2)]
    for session in sessions:
        session.start(truth.rotations[0], truth.translations[0])
    for k in range(6):
        if k in (3, 5):
            # as a transform of something else on /tf_static makes the node do
            copies = [replace(one, T_rig_camera=one.T_rig_camera.copy(),
                              covariance=one.covariance.copy()) for one in cameras]
            assert not sessions[1].set_cameras(copies)
        one, other = (session.look([some[k] for some in images], k * 33_000_000)
                      for session in sessions)
        assert np.array_equal(one.tracked.translation, other.tracked.translation)
        assert np.array_equal(one.tracked.covariance, other.tracked.covariance)
    moved = cameras[1].T_rig_camera.copy()
    moved[0, 3] += 1e-4
    assert sessions[1].set_cameras([cameras[0], replace(cameras[1], T_rig_camera=moved)])
    no_pose = replace(cameras[1], T_rig_camera=np.zeros((4, 4)))
    for _ in range(2):
        with pytest.raises(InputError, match='is no pose'):
            sessions[1].set_cameras([cameras[0], no_pose])
    assert np.array_equal(sessions[1].cameras[1].T_rig_camera, moved)
