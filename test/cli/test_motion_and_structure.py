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

from pathlib import Path

import numpy as np
import pytest

from selfcal_ros.cli import main as command
from selfcal_ros.cli.motion_text import axis_spread
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.camera_yaml import read_camera_yaml
from selfcal_ros.synthetic.special_scenes import general_motion, pure_rotation

BAG = Path(__file__).resolve().parents[2] / 'bags' / 'arm_move'
SIZE = ['--image-size', '640', '480', '--distortion', 'none']


def vertices(path):
    """Read position and colour of each vertex."""
    header, _, body = Path(path).read_bytes().partition(b'end_header\n')
    colours = [(name, 'u1') for name in ('red', 'green', 'blue')] if b'red' in header else []
    return np.frombuffer(body, [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), *colours])


def test_the_moves_of_an_arm_are_told_from_a_drive_and_their_scene_is_written(capsys):
    assert command.main(['calibrate', str(BAG), '--ply', 'scene.ply']) == 0
    said = capsys.readouterr().out
    assert 'Motion: general, found from the images: the views turn by up to 20' in said
    assert 'no planar motion explains the images' in said
    camera, _ = read_camera_yaml('camera.yaml')
    assert abs(camera.K[0, 0] - 520) < 0.001 * 520
    assert np.abs(camera.K[:2, 2] - (328, 235)).max() < 1
    assert np.abs(camera.distortion[:2] - (-0.12, 0.05)).max() < 0.005
    points = vertices('scene.ply')
    assert len(points) > 800 and (points['x'] > 0).all()
    # grey images, and texture in them
    assert (points['red'] == points['blue']).all() and np.ptp(points['red']) > 50
    assert 'scene.ply' in said


def test_a_stated_motion_is_said_to_be_stated(capsys):
    scene = general_motion(np.random.default_rng(2))
    scene.tracks.to_csv('tracks.csv')
    status = command.main(['calibrate', 'tracks.csv', '--motion', 'general', '--ply', 's.ply',
                           *SIZE])
    said = capsys.readouterr().out
    assert status == 0, said
    assert 'Motion: general, as stated' in said
    assert vertices('s.ply').dtype.names == ('x', 'y', 'z')


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
    assert command.main(['calibrate', 'tracks.csv', *SIZE]) == 0
    assert 'rotation' in capsys.readouterr().out


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
