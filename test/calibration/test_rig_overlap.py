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
"""Cameras that move together: derivatives of the rig block, the start, truth and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import Camera, CameraFacts
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.calibration.rigs.rig_calibration import calibrate_rig
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.synthetic.rig_scenes import driven_path, hand_path
from selfcal_ros.synthetic.scenes import observe
from selfcal_ros.synthetic.special_scenes import placed_points

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
NOTHING = NotCalibrated.of(NoEstimate('no_parallax', parallax_ratio=1.0))


def _camera(f, cx, cy):
    return Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], (), 640, 480)


def _pose(turn, place):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_matrix(np.array(turn)), place
    return T


CAMERAS = {'front': _camera(520, 330, 250), 'side': _camera(430, 310, 235),
           'beside': _camera(470, 322, 244)}
POSES = {'front': np.eye(4), 'side': _pose([0, 1.5, 0], [0.3, 0.1, -0.4]),
         'beside': _pose([0.02, 1.55, -0.01], [0.25, 0.08, -0.29])}
LENGTH = float(np.linalg.norm(POSES['side'][:3, 3]))


def _tracks(rng, path):
    """Tracks of three cameras, of which the second and the third share points."""
    paths = {}
    for name, T in POSES.items():
        back = np.linalg.inv(T)
        paths[name] = back[:3, :3] @ path
        paths[name][:, :, 3] += back[:3, 3]
    tracks = {}
    for first, others in (('front', ['front']), ('side', ['side', 'beside'])):
        points, seen = placed_points(rng, CAMERAS[first], paths[first], 200, 8)
        for name in others:
            one = observe(rng, CAMERAS[name], paths[name], points, 0.3, only_inside=True,
                          seen=seen).tracks
            tracks[name] = replace(one, track=one.track + 10**5 * (first == 'side'))
    return tracks


def _turn(result, name):
    """Return the error of a rotation in its sigmas."""
    pose = result.poses[name]
    return (rotation_vector(pose.T_rig_camera[:3, :3] @ POSES[name][:3, :3].T)
            / [pose.sigma[one] for one in ('roll', 'pitch', 'yaw')])


@pytest.mark.long
def test_two_cameras_that_share_points_with_each_other_only_have_no_height_over_the_first():
    path = driven_path(20)
    centres = np.einsum('vji,vj->vi', path[:, :, :3], -path[:, :, 3])
    step = np.sqrt(np.mean(np.sum(np.diff(centres, axis=0)**2, axis=1)))
    result = calibrate_rig(_tracks(np.random.default_rng(0), path), shared_tracks=True,
                           facts=FACTS, alone={'beside': NOTHING}, baseline=(LENGTH, 0.0005))
    for name in ('side', 'beside'):
        pose = result.poses[name]
        assert pose.status['y'] == pose.status['z'] == 'unobservable' and pose.shared_points > 30
        for one in pose.places:
            assert abs(one.direction @ POSES[name][:3, 3] / step - one.value) < 3.5 * one.sigma
        assert np.abs(_turn(result, name)).max() < 3.5
    # a length that holds an open height is no scale
    assert result.unit == 'path'
    assert 'rig_baseline_of_no_use' in [one.kind for one in result.findings]


def test_a_camera_is_placed_by_points_of_one_that_the_path_has_placed():
    rng = np.random.default_rng(1)
    result = calibrate_rig(_tracks(rng, hand_path(rng, 12)), shared_tracks=True, facts=FACTS,
                           alone={'beside': NOTHING}, baseline=(LENGTH, 0.0005))
    assert result.unit == 'm'
    for name in ('side', 'beside'):
        pose = result.poses[name]
        off = pose.T_rig_camera[:3, 3] - POSES[name][:3, 3]
        assert np.abs(off / [pose.sigma[one] for one in 'xyz']).max() < 3.5
        assert np.abs(_turn(result, name)).max() < 3.5
