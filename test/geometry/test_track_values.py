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
"""Values that others are made of refuse what they cannot be."""

import numpy as np
import pytest
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.values.body_poses import BodyPoses
from selfcal_ros.values.tracks import Tracks


def test_neighbours_that_are_not_of_the_observations_are_refused():
    rows = [0, 1], [7, 7], [(10.0, 20), (12, 20)]
    for shape in ((5, 2, 3), (2, 3), (1, 2, 3)):
        with pytest.raises(InputError, match='Neighbours of 2 observations'):
            Tracks(*rows, neighbours=np.zeros(shape))
    given = np.zeros((2, 2, 3))
    kept = Tracks(*rows, neighbours=given).neighbours
    assert not kept.flags.writeable and given.flags.writeable


def test_cameras_are_compared_by_their_values():
    K = np.array([[520.0, 0, 320], [0, 520, 240], [0, 0, 1]])
    one, same = Camera(K, [-0.1], 640, 480), Camera(K.copy(), [-0.1, 0, 0, 0, 0], 640, 480)
    assert one == same and len({one, same}) == 1
    for other in (Camera(K, [-0.1], 640, 481), Camera(K, [-0.2], 640, 480),
                  Camera(K + np.diag([1, 0, 0]), [-0.1], 640, 480), None):
        assert one != other


@pytest.mark.parametrize('wrong', [
    {'aspect_ratio': '1'}, {'skew': 'x'}, {'principal_point': 5}, {'principal_point': 'ab'},
    {'aspect_ratio_sigma': None}, {'line_delay_s': 'x'}, {'skew': float('nan')}])
def test_facts_that_are_no_numbers_are_refused(wrong):
    with pytest.raises(ArgumentError):
        CameraFacts(**wrong)


@pytest.mark.parametrize('size', [-5, 3.7, 'wide', float('inf')])
def test_a_width_that_is_none_is_refused(size):
    with pytest.raises(ArgumentError, match='whole number of pixels'):
        Camera([[500, 0, 0], [0, 500, 0], [0, 0, 1]], width=size)


def test_no_pose_is_no_path_of_a_body():
    with pytest.raises(InputError, match='no pose'):
        BodyPoses(np.zeros((0, 3, 3)), np.zeros((0, 3)), frames=np.zeros(0, int))


def test_a_path_of_one_view_has_a_step_of_one():
    path = AxisPath(np.eye(3), np.zeros(1), np.zeros((1, 2)), np.zeros((1, 3)))
    assert path.step_length() == 1.0
