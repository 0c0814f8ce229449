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
"""A first pose from clicks, and the files that start a tracker."""

import numpy as np
import pytest

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.rorapid.estimation.initial_pose import pose_from_clicks, read_init, read_pose_file

CAMERA = Camera([[540, 0, 330], [0, 530, 235], [0, 0, 1]], [-0.2, 0.05, 1e-3, 0], 640, 480)
BOX = np.array([[0, 0, 0], [0.165, 0, 0], [0.165, 0, -0.08], [0.165, 0.068, 0]])


def random_pose(rng):
    axis = rng.normal(size=3)
    rotation = rotation_matrix(axis / np.linalg.norm(axis) * rng.uniform(0, np.pi))
    return rotation, np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 1.0)])


@pytest.mark.long
@pytest.mark.parametrize('points', (BOX, np.vstack([BOX, [[0, 0.068, 0]]]),
                                    np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0],
                                              [0, 0.1, 0], [0.05, 0.02, 0]])))
def test_exact_clicks_give_the_pose_from_anywhere(points):
    rng = np.random.default_rng(1)
    right = 0
    for _ in range(10):
        rotation, translation = random_pose(rng)
        clicks = CAMERA.project(points @ rotation.T + translation)
        found, where, rms = pose_from_clicks(points, clicks, CAMERA)
        assert rms < 1e-4
        right += np.linalg.norm(rotation_vector(found @ rotation.T)) < 1e-4 and \
            np.linalg.norm(where - translation) < 1e-5
    # four points that do not lie on a plane may have a second exact pose
    assert right >= 9


def test_clicks_that_are_off_by_pixels_give_a_guess():
    rng = np.random.default_rng(2)
    rotation, translation = rotation_matrix([0.5, 0.7, -0.2]), np.array([0.02, 0.01, 0.5])
    points = np.vstack([BOX, [[0, 0.068, 0]]])
    clicks = CAMERA.project(points @ rotation.T + translation) + rng.normal(0, 2, (5, 2))
    found, where, rms = pose_from_clicks(points, clicks, CAMERA)
    assert rms < 4
    assert np.linalg.norm(rotation_vector(found @ rotation.T)) < 0.15
    assert np.linalg.norm(where - translation) < 0.04


@pytest.mark.parametrize('points, clicks', (
    (BOX[:2], np.zeros((2, 2))), (BOX, np.zeros((3, 2))), (BOX, np.full((4, 2), np.nan)),
    (BOX, np.full((4, 2), 100.0)), (np.outer(np.arange(4.0), [1, 2, 3]), np.eye(4)[:, :2] * 99)))
def test_impossible_clicks_are_refused(points, clicks):
    with pytest.raises(ArgumentError):
        pose_from_clicks(points, clicks, CAMERA)


def test_files(tmp_path):
    path = tmp_path / 'a.init'
    path.write_text('# clicks\n4  # number\n0 0 0 # one\n0.1 0 0\n0.1 0.1 0\n#0 9 9\n0 0.1 0 #\n')
    assert np.allclose(read_init(path), [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
    path = tmp_path / 'a.pos'
    path.write_text('0.1 0.2 0.5\n0.3\n0\n-0.1\n')
    rotation, translation = read_pose_file(path)
    assert np.allclose(translation, [0.1, 0.2, 0.5])
    assert np.allclose(rotation, rotation_matrix([0.3, 0, -0.1]))


@pytest.mark.parametrize('text', ('', '1 2 3', '1 2 3 4 5 six', '1 2 3 4 5 nan', '\x00\x01',
                                  '1 2 3 4 5 6 7'))
def test_broken_files_are_refused_in_a_sentence(tmp_path, text):
    path = tmp_path / 'broken'
    path.write_text(text)
    for read in (read_init, read_pose_file):
        with pytest.raises(InputError) as error:
            read(path)
        assert 'broken' in str(error.value)
    with pytest.raises(InputError):
        read_init(tmp_path / 'missing')
