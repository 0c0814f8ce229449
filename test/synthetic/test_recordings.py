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
"""The synthetic recordings: their motion, their truth, and the bags made of them."""

import importlib.util
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError
from selfcal_ros.synthetic import recordings

BAGS = Path(__file__).resolve().parents[2] / 'bags'
SMALL = (160, 120)


@pytest.fixture(scope='module')
def recipes():
    """Return the module bags/make_recordings.py."""
    spec = importlib.util.spec_from_file_location('make_recordings', BAGS / 'make_recordings.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _centres(poses):
    return -np.einsum('vji,vj->vi', poses[:, :, :3], poses[:, :, 3])


def _messages(name):
    """Yield (topic, stamp, message) of a bag."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import get_typestore, Stores
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(BAGS / name) as reader:
        for connection, stamp, data in reader.messages():
            yield connection.topic, stamp, store.deserialize_cdr(data, connection.msgtype)


def _turns_rad(poses):
    """Angle of the rotation between adjacent views."""
    steps = np.einsum('vij,vkj->vik', poses[1:, :, :3], poses[:-1, :, :3])
    return np.arccos(np.clip((np.trace(steps, axis1=1, axis2=2) - 1) / 2, -1, 1))


def test_drive_is_planar_with_the_stated_mounting():
    poses = recordings.agv_drive(24, size=SMALL, pitch_deg=20, roll_deg=3).cam_from_world
    R = poses[:, :, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (24, 1, 1)),
                               atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(np.ones(24))
    np.testing.assert_allclose(_centres(poses)[:, 2], 1.1)
    # the vertical in the camera is the same in every view, and tells pitch and roll
    down = -R[:, :, 2]
    np.testing.assert_allclose(down, np.broadcast_to(down[0], down.shape), atol=1e-12)
    assert np.rad2deg(np.arcsin(down[0, 2])) == pytest.approx(20)
    assert abs(np.rad2deg(np.arctan2(down[0, 0], down[0, 1]))) == pytest.approx(3)
    assert np.rad2deg(_turns_rad(poses).sum()) > 110


def test_path_does_not_depend_on_the_number_of_views():
    few, many = (recordings.drive_path(count) for count in (24, 70))
    np.testing.assert_allclose(few[0], many[0][::3], atol=1e-6)
    np.testing.assert_allclose(few[1], many[1][::3], atol=1e-6)
    heading = np.rad2deg(many[1])
    assert heading[-1] - heading[0] == pytest.approx(10, abs=1e-6)
    assert heading.max() - heading[0] > 60
    length = np.linalg.norm(np.diff(recordings.drive_path(2000)[0], axis=0), axis=1).sum()
    assert length == pytest.approx(3.2, rel=1e-4)


def test_drive_is_seen_everywhere_and_at_many_depths():
    recording = recordings.agv_drive(5, size=SMALL)
    renderer = recording.renderer()
    for pose in recording.cam_from_world:
        depth = renderer.depth(pose)
        assert np.isfinite(depth).all()
        near, far = np.percentile(depth, [5, 95])
        assert near < 2.5 and far > 4.0


def test_frames_depend_on_seed_and_number_alone():
    recording = recordings.agv_drive(6, size=SMALL)
    renderer = recording.renderer()
    stream = [image for image, _ in recording.frames()]
    again = recordings.agv_drive(6, size=SMALL)
    np.testing.assert_array_equal(again.frame(4), stream[4])
    assert (recording.frame(3, renderer) != stream[4]).mean() > 0.5
    clean = recordings.agv_drive(6, size=SMALL, noise_sigma=0).frame(4)
    assert (stream[4].astype(float) - clean).std() == pytest.approx(1.0, abs=0.15)
    assert stream[0].shape == (120, 160) and stream[0].dtype == np.uint8


def test_arm_translates_then_turns():
    recording = recordings.arm_move(24, size=SMALL)
    labels = np.array(recording.labels)
    poses = recording.cam_from_world
    moves = poses[labels == 'translation']
    np.testing.assert_allclose(moves[:, :, :3], np.tile(moves[0, :, :3], (8, 1, 1)), atol=1e-12)
    # not along one line, nor in one plane
    assert np.linalg.svd(np.diff(_centres(moves), axis=0))[1].min() > 0.05
    turns = poses[labels == 'rotation', :, :3]
    relative = np.einsum('vij,vkj->vik', turns, np.tile(poses[0, :, :3], (8, 1, 1)))
    axes = np.stack([relative[:, 2, 1] - relative[:, 1, 2], relative[:, 0, 2]
                     - relative[:, 2, 0], relative[:, 1, 0] - relative[:, 0, 1]], axis=1)
    assert np.linalg.matrix_rank(axes, tol=0.1) == 3
    assert (labels == 'general').sum() == 8


def test_turntable_turns_about_one_axis_and_its_background_stays():
    recording = recordings.turntable(4, size=SMALL, noise_sigma=0, dirt=True)
    assert np.rad2deg(_turns_rad(recording.cam_from_world)) == pytest.approx(10 * np.ones(3))
    distance = np.linalg.norm(_centres(recording.cam_from_world)[:, :2], axis=1)
    assert distance == pytest.approx(distance[0] * np.ones(4))
    images = [image.astype(int) for image, _ in recording.frames()]
    same = images[0] == images[1]
    assert same[:30].all() and not same.all()
    bare = recordings.turntable(4, size=SMALL, background=False, noise_sigma=0).frame(0)
    assert (bare == 0).mean() > 0.3


def test_too_few_views_are_refused():
    for make in (recordings.agv_drive, recordings.turntable, recordings.arm_move):
        with pytest.raises(ArgumentError):
            make(1)


def test_image_folder_holds_frames_and_truth(tmp_path):
    recording = recordings.agv_drive(2, size=SMALL, distortion=recordings.REALISTIC_DISTORTION)
    folder = recordings.write_image_folder(recording, tmp_path / 'drive')
    assert sorted(p.name for p in folder.iterdir()) == ['0000.png', '0001.png', 'truth.json']
    image = cv2.imread(str(folder / '0001.png'), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(image, recording.frame(1))
    truth = json.loads((folder / 'truth.json').read_text())
    np.testing.assert_allclose(truth['K'], recording.camera.K)
    assert truth['distortion'][:2] == [-0.12, 0.05]
    np.testing.assert_allclose(truth['cam_from_world'], recording.cam_from_world, atol=1e-11)


@pytest.mark.long
@pytest.mark.parametrize('name', ['agv_drive', 'arm_move'])
def test_bag_holds_what_the_recipe_makes(name, recipes):
    recording = recipes.RECIPES[name]()
    truth = json.loads((BAGS / f'{name}.truth.json').read_text())
    assert truth == json.loads(json.dumps(recording.truth()))
    messages = list(_messages(name))
    assert {topic for topic, _, _ in messages} == {'/camera/image_raw/compressed'}
    stamps = [m.header.stamp.sec * 10 ** 9 + m.header.stamp.nanosec for _, _, m in messages]
    assert stamps == [stamp for _, stamp, _ in messages] == truth['stamps_ns']
    assert {m.header.frame_id for _, _, m in messages} == {'camera_optical_frame'}
    renderer = recording.renderer()
    for index in (0, len(messages) // 2):
        image = cv2.imdecode(messages[index][2].data, cv2.IMREAD_GRAYSCALE)
        assert image.shape == (truth['height'], truth['width']) == (480, 640)
        loss = image.astype(float) - recording.frame(index, renderer)
        assert loss.std() < 3 and abs(loss.mean()) < 0.2


def test_bags_stay_small(recipes):
    sizes = [file.stat().st_size for name in recipes.RECIPES
             for file in (BAGS / name).iterdir()]
    assert sum(sizes) < 8e6


def test_recipe_writes_a_readable_bag_and_replaces_an_old_one(recipes, tmp_path, monkeypatch):
    small = recordings.agv_drive(2, size=SMALL)
    monkeypatch.setitem(recipes.RECIPES, 'agv_drive', lambda: small)
    for _ in range(2):
        recipes.main(['agv_drive', '--output', str(tmp_path)])
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        'agv_drive', 'agv_drive.odometry.csv', 'agv_drive.truth.json']
    from rosbags.rosbag2 import Reader
    with Reader(tmp_path / 'agv_drive') as reader:
        assert reader.message_count == 2
