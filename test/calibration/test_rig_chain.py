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
"""Three cameras of which neighbours share points, and the outer two do not."""

import numpy as np
import pytest
from selfcal_ros import calibrate_rig, Camera, CameraFacts
from selfcal_ros.calibration.result import NotCalibrated
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.synthetic.rig_scenes import hand_path
from selfcal_ros.synthetic.scenes import observe
from selfcal_ros.synthetic.special_scenes import placed_points

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
CAMERAS = {name: Camera([[f, 0, cx], [0, f, cy], [0, 0, 1]], (), 640, 480)
           for name, f, cx, cy in (('left', 400, 330, 250), ('middle', 380, 310, 235),
                                   ('right', 420, 315, 245))}
TURNS = {'left': (0.0, 0.0, 0.0), 'middle': (0.02, 0.9, 0.01), 'right': (0.01, 1.8, -0.02)}
PLACES = {'left': (0.0, 0.0, 0.0), 'middle': (0.2, 0.02, -0.1), 'right': (0.3, -0.02, -0.4)}
NOT_ALONE = NotCalibrated.of(NoEstimate('no_parallax', parallax_ratio=1.0))


@pytest.fixture(scope='module')
def chain():
    """Tracks of three cameras that look 52 degrees apart, their poses, and the rms step."""
    rng = np.random.default_rng(0)
    path, poses, seen = hand_path(rng, 14), {}, []
    T = {name: np.eye(4) for name in CAMERAS}
    for name in CAMERAS:
        T[name][:3, :3], T[name][:3, 3] = rotation_matrix(np.array(TURNS[name])), PLACES[name]
        back = np.linalg.inv(T[name])
        poses[name] = back[:3, :3] @ path
        poses[name][:, :, 3] += back[:3, 3]
        seen.append(placed_points(rng, CAMERAS[name], poses[name], 250, 8))
    points, visible = (np.concatenate([one[k] for one in seen], axis=k) for k in (0, 1))
    tracks = {name: observe(rng, CAMERAS[name], poses[name], points, 0.3, only_inside=True,
                            seen=visible).tracks for name in CAMERAS}
    centres = np.einsum('vji,vj->vi', path[:, :, :3], -path[:, :, 3])
    step = np.sqrt(np.mean(np.sum(np.diff(centres, axis=0)**2, axis=1)))
    return tracks, T, step


@pytest.mark.long
@pytest.mark.parametrize('refusing', [(), ('middle', 'right'), ('left', 'middle')])
def test_a_chain_is_placed_link_by_link(chain, refusing):
    tracks, T, step = chain
    assert not set(tracks['left'].track) & set(tracks['right'].track)
    result = calibrate_rig(tracks, shared_tracks=True, facts=FACTS,
                           alone=dict.fromkeys(refusing, NOT_ALONE))
    assert result
    for name in ('middle', 'right'):
        pose = result.poses[name]
        off = np.r_[pose.T_rig_camera[:3, 3] - T[name][:3, 3] / step,
                    rotation_vector(pose.T_rig_camera[:3, :3] @ T[name][:3, :3].T)]
        assert np.abs(off / list(pose.sigma.values())).max() < 3.5
    for name, camera in CAMERAS.items():
        one = result.cameras[name]
        assert abs(one.camera.K[0, 0] - camera.K[0, 0]) < 3.5 * one.sigma['fx']
