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
"""`selfcal calibrate`: which motion, and why; the structure as PLY."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from selfcal_ros.cli import main as command
from selfcal_ros.cli.motion_text import axis_spread
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.camera_yaml import read_camera_yaml
from selfcal_ros.synthetic.special_scenes import general_motion, pure_rotation
from test_support.command_line import selfcal

BAG = Path(__file__).resolve().parents[2] / 'bags' / 'arm_move'
SIZE = ['--image-size', '640', '480', '--distortion', 'none']


def vertices(path):
    """Read the vertices, those of the points and those of cameras, and the edges."""
    header, _, body = Path(path).read_bytes().partition(b'end_header\n')
    counts = [int(line.split()[2]) for line in header.split(b'\n') if line.startswith(b'element')]
    colours = [(name, 'u1') for name in ('red', 'green', 'blue')] if b'red' in header else []
    found = np.frombuffer(body, [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), *colours,
                                 ('track', '<i4'), ('sigma', '<f4')], counts[0])
    edges = np.frombuffer(body[found.nbytes:], '<i4').reshape(counts[1], 2)
    return found[found['track'] >= 0], found[found['track'] < 0], edges


def off_the_truth(rows, truth):
    """Return the errors of places and turns (rad) of `stamp t q`, after the best similarity."""
    stamps = (1e9 * rows[:, 0]).round(-3)
    views = [int(np.argmin(np.abs(np.array(truth['stamps_ns']) - stamp))) for stamp in stamps]
    true = np.array(truth['cam_from_world'])[views]
    R = np.swapaxes(true[:, :, :3], 1, 2)
    places = -np.einsum('vij,vj->vi', R, true[:, :, 3])
    turned = Rotation.from_quat(rows[:, 4:]).as_matrix()
    a, b = (X - X.mean(axis=0) for X in (places, rows[:, 1:4]))
    u, s, v = np.linalg.svd(b.T @ a)
    W = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    scale = s.sum() / np.sum(a**2)
    return (np.linalg.norm(b - scale * a @ W.T, axis=1),
            Rotation.from_matrix(np.swapaxes(turned, 1, 2) @ W @ R).magnitude())


@pytest.mark.long
def test_the_moves_of_an_arm_are_told_from_a_drive_and_their_scene_is_written(capsys):
    assert command.main(['calibrate', str(BAG), '--ply', 'scene.ply', '--poses', 'path.tum',
                         '--colmap', 'model', '--transforms', 'transforms.json']) == 0
    said = capsys.readouterr().out
    assert 'Motion: general, found from the images: the views turn by up to 20' in said
    assert 'no planar motion explains the images' in said
    camera, _ = read_camera_yaml('camera.yaml')
    assert abs(camera.K[0, 0] - 520) < 0.001 * 520
    assert np.abs(camera.K[:2, 2] - (328, 235)).max() < 1
    assert np.abs(camera.distortion[:2] - (-0.12, 0.05)).max() < 0.005
    points, cameras, edges = vertices('scene.ply')
    assert len(points) > 800 and (points['x'] > 0).all()
    # grey images, and texture in them
    assert (points['red'] == points['blue']).all() and np.ptp(points['red']) > 50
    assert ('Written: camera.yaml, path.tum, scene.ply, model, transforms.json, sparse_pc.ply, '
            'images.') in said
    # the path, of which a step is 1, against the truth
    rows = np.loadtxt('path.tum')
    assert len(rows) == len(cameras) / 5 == len(edges) / 8 and np.ptp(rows[:, 1:4]) > 2
    places, turns = off_the_truth(rows, json.loads(
        BAG.with_suffix('.truth.json').read_text(encoding='utf-8')))
    assert places.max() < 0.02 and turns.max() < 1e-3
    assert np.allclose(cameras['x'][::5], rows[:, 1], atol=1e-4)
    # every image that is named is there
    names = [line.split()[9] for line in Path('model/images.txt').read_text(
        encoding='utf-8').splitlines() if line.endswith('.png')]
    frames = json.loads(Path('transforms.json').read_text(encoding='utf-8'))['frames']
    assert len(names) == len(frames) == len(rows)
    for name, frame in zip(names, frames):
        assert frame['file_path'] == f'images/{name}'
        assert Path('model', 'images', name).read_bytes() == Path('images', name).read_bytes()
    assert cv2.imread('images/frame_000000.png').shape == (480, 640, 3)
    assert Path('sparse_pc.ply').read_bytes().count(b'element vertex') == 1
    # images of somebody else's are not replaced without a word
    Path('other/images').mkdir(parents=True)
    Path('other/images/frame_000007.png').touch()
    for what in (['--colmap', 'other'], ['--transforms', 'other/transforms.json']):
        assert selfcal('calibrate', BAG, '--output', 'again.yaml', *what) == 2
        assert 'holds images already, such as frame_000007' in capsys.readouterr().err


def test_a_stated_motion_is_said_to_be_stated(capsys):
    scene = general_motion(np.random.default_rng(2))
    scene.tracks.to_csv('tracks.csv')
    status = command.main(['calibrate', 'tracks.csv', '--motion', 'general', '--ply', 's.ply',
                           '--poses', 'path.csv', '--colmap', 'model', *SIZE])
    said = capsys.readouterr().out
    assert status == 0, said
    assert 'Motion: general, as stated' in said
    assert vertices('s.ply')[0].dtype.names == ('x', 'y', 'z', 'track', 'sigma')
    # a table has no clock and no images
    lines = [line.split(',') for line in Path('path.csv').read_text(encoding='utf-8').splitlines()
             if not line.startswith('#')]
    assert lines[0][:3] == ['frame', 'stamp_ns', 'tx'] and lines[2][:2] == ['1', '']
    covariance = np.array(lines[2][9:], float).reshape(6, 6)
    assert (np.linalg.eigvalsh(covariance) > 0).all() and covariance[0, 0] < 0.1**2
    assert sorted(entry.name for entry in Path('model').iterdir()) == [
        'cameras.txt', 'images.txt', 'points3D.txt']


def test_translated_views_that_are_not_there_are_missed(capsys):
    general_motion(np.random.default_rng(2)).tracks.to_csv('tracks.csv')
    assert command.main(['calibrate', 'tracks.csv', '--motion', 'translation', *SIZE]) == 1
    assert 'No two views are related by pure translation' in capsys.readouterr().out


def test_a_camera_that_only_rotates_is_refused_as_planar_and_leaves_no_structure(capsys):
    pure_rotation(np.random.default_rng(2), views=5).tracks.to_csv('tracks.csv')
    assert command.main(['calibrate', 'tracks.csv', '--motion', 'planar', '--ply', 's.ply',
                         *SIZE]) == 1
    assert 'only rotated' in capsys.readouterr().out
    assert not Path('s.ply').exists()


def test_a_camera_that_only_rotates_is_calibrated_as_such(capsys):
    pure_rotation(np.random.default_rng(2), views=5).tracks.to_csv('tracks.csv')
    assert command.main(['calibrate', 'tracks.csv', '--ply', 's.ply', '--colmap', 'model',
                         '--poses', 'path.txt', *SIZE]) == 1
    heard = capsys.readouterr()
    assert 'rotation' in heard.out and Path('camera.yaml').exists()
    # it turned, and that is known; it saw no depth, and two files are missing
    assert heard.err.count('was not written: the camera only turned') == 2
    assert not Path('s.ply').exists() and not Path('model').exists()
    rows = np.loadtxt('path.txt')
    assert not rows[:, 1:4].any() and np.ptp(rows[:, 4:]) > 0.01


@pytest.mark.parametrize('arguments, words', [
    (['--poses', 'path'], 'add --poses-format'),
    (['--poses-format', 'euroc'], 'needs --poses'),
    (['--poses', 'tracks.csv'], 'is the input tracks.csv'),
    (['--poses', 'a.tum', '--json', 'a.tum'], 'same name'),
    (['--transforms', 't.json'], 'has none; leave it out'),
    (['--colmap', 'tracks.csv'], 'takes the name of a folder'),
    (['--colmap', 'tracks.csv/model'], 'tracks.csv is a file'),
    (['--colmap', 'm', '--skew', 'free'], 'no place for skew'),
    (['--colmap', 'm', '--motion', 'rotation'], 'a camera that only rotates sees none'),
    (['--colmap', 'm', '--motion', 'repeated'], 'are in one'),
])
def test_what_cannot_come_out_is_said_before_the_work(capsys, arguments, words):
    Path('tracks.csv').write_text('frame,track,x,y\n0,0,1,1\n', encoding='utf-8')
    assert selfcal('calibrate', 'tracks.csv', *arguments) == 2
    heard = capsys.readouterr()
    assert words in heard.err and heard.err.count('\n') == 1 and not heard.out
    assert [entry.name for entry in Path().iterdir()] == ['tracks.csv']


def test_spread_of_axes_is_that_of_the_rotations():
    angles = np.radians([0, 10, 20, 30])
    about_z = rotation_matrix(angles[:, None] * (0, 0, 1))
    still = np.zeros((4, 3, 1))
    turned, off = axis_spread(np.concatenate([about_z, still], axis=2))
    assert turned == pytest.approx(np.radians(30)) and off < 1e-12
    # the frames of camera and world are anybody's
    change = rotation_matrix(np.array([0.3, -1, 0.5]))
    turned, off = axis_spread(np.concatenate([change @ about_z @ change, still], axis=2))
    assert turned == pytest.approx(np.radians(30)) and off < 1e-12
    both = rotation_matrix(np.radians([[0, 0, 0], [10, 0, 0], [0, 10, 0]]))
    _, off = axis_spread(np.concatenate([both, still[:3]], axis=2))
    assert off == pytest.approx(np.radians(10) / np.sqrt(3))
