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
from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros.calibration.bundle.hidden_depths import hidden_depths, with_hidden_depths
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.robust_fit import Observations
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.synthetic.pause_scenes import pauses


@pytest.fixture(scope='module')
def standing():
    """Return a drive that pauses, at the truth: state, blocks, directions, and ways of points."""
    scene = pauses(np.random.default_rng(15))
    tracks = scene.tracks.select(~scene.outliers)
    seen = Observations.of(tracks, tracks.frames)
    R, t = np.split(scene.cam_from_world[tracks.frames], [3], axis=2)
    points = np.column_stack([scene.points[seen.track], np.ones(len(seen.track))])
    state = SceneState(Lens.of(scene.camera), AxisPath.of_poses(np.eye(3), np.dstack([R, t])),
                       points / np.linalg.norm(points, axis=1)[:, None])
    blocks = PointBlocks(seen.point, seen.view)
    directions = np.einsum('nji,nj->ni', R[seen.view], scene.camera.rays(seen.xy))
    centres = state.path.centres()[seen.view]
    way = np.array([np.ptp(centres[seen.point == k], axis=0).max()
                    for k in range(len(seen.track))])
    return state, blocks, directions, way


def test_points_that_only_a_camera_at_one_place_sees_have_hidden_depths(standing):
    state, blocks, _, way = standing
    hidden = hidden_depths(state, blocks, 0.2)
    assert (way < 1e-9).any()
    assert hidden[way < 1e-9].all()
    assert not hidden[way > 0.1].any()


def test_a_point_that_noise_puts_beside_the_camera_is_found(standing):
    state, blocks, _, way = standing
    nudged = replace(state, points=state.points.copy())
    still = np.flatnonzero(way < 1e-9)
    centres = state.path.centres()[blocks.view[blocks.first[still]]]
    beside = centres + 1e-4 * np.array([1.0, -1.0, 1.0])
    nudged.points[still] = np.column_stack([beside, np.ones(len(still))])
    assert hidden_depths(nudged, blocks, 0.2)[still].all()


def test_a_camera_that_hardly_moves_at_all_is_no_matter_of_hidden_depths(standing):
    state, blocks, *_ = standing
    assert not hidden_depths(state, blocks, 1e6).any()


def test_hidden_depths_are_at_infinity_and_stay_there(standing):
    state, blocks, directions, way = standing
    hidden = way < 1e-9
    far = with_hidden_depths(state, blocks, hidden, directions)
    assert (far.points[hidden, 3] == 0).all()
    assert (far.points[~hidden] == state.points[~hidden]).all()
    # they move sideways alone, and so remain where they were seen
    steps = np.einsum('pij,pj->pi', far.tangents, np.ones((len(way), 3)))
    assert (steps[hidden, 3] == 0).all() and (steps[~hidden, 3] != 0).any()
    placed = far.placed(blocks)[hidden[blocks.point]]
    placed /= np.linalg.norm(placed, axis=1)[:, None]
    rays = np.einsum('nij,nj->ni', state.path.rotations()[blocks.view], directions)
    assert np.median(np.linalg.norm(placed - rays[hidden[blocks.point]], axis=1)) < 1e-3


def test_a_point_whose_depth_shows_again_stands_before_its_cameras(standing):
    state, blocks, directions, way = standing
    hidden = way < 1e-9
    far = with_hidden_depths(state, blocks, hidden, directions)
    near = with_hidden_depths(far, blocks, np.zeros_like(hidden), directions)
    assert (near.points[:, 3] != 0).all()
    ahead = np.einsum('ni,ni->n', near.points[blocks.point][:, :3] / near.points[
        blocks.point][:, 3:] - state.path.centres()[blocks.view], directions)
    assert (ahead[hidden[blocks.point]] > 0).all()
