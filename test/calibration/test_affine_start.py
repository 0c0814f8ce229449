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
"""A start from affine images: small, far scenes before a long lens."""

import numpy as np
import pytest
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.calibration.initialisation.affine_start import affine_starts
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.synthetic.few_view_scenes import cut_camera, equal_objects

VIEWS, POINTS = 6, 60
CAMERA = Camera([[1100.0, 0, 640], [0, 1100.0, 480], [0, 0, 1]], width=1280, height=960)
SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
TURNED = ((0, 0, 0), (10, -40, 5), (25, 35, 10), (-30, 20, 5))


def far_views(rng, seen=0.6):
    """Views of a far solid at several places of the image: rotations, blocks, and pixels."""
    R = rotation_matrix(rng.normal(scale=0.4, size=(VIEWS, 3)))
    solid = rng.uniform(-1, 1, (POINTS, 3))
    # a thousand times as far as large
    middle = CAMERA.rays(rng.uniform([100, 100], [1180, 860], (VIEWS, 2)))
    t = 1e3 * rng.uniform(0.8, 1.3, (VIEWS, 1)) * middle / middle[:, 2:]
    point, view = np.nonzero(rng.random((POINTS, VIEWS)) < seen)
    xy = CAMERA.project(np.einsum('nij,nj->ni', R[view], solid[point]) + t[view])
    return R, PointBlocks(np.unique(point, return_inverse=True)[1], view), xy


def away_deg(states, R):
    """How far the turns between views are from true ones, by the nearer of two starts."""
    return min(np.degrees(np.linalg.norm(rotation_vector(
        np.swapaxes(turns @ turns[0].T, 1, 2) @ R @ R[0].T), axis=1).max())
        for turns in (state.path.cam_from_world()[:, :, :3] for state in states))


@pytest.mark.parametrize('seed', range(4))
def test_views_of_a_far_solid_give_their_turns_though_each_misses_tracks(seed):
    R, blocks, xy = far_views(np.random.default_rng(seed))
    states = affine_starts(blocks, xy, CAMERA)
    assert away_deg(states, R) < 0.2
    # with depths reversed, the same images
    for state in states:
        seen = CAMERA.project(state.placed(blocks) @ state.path.mount.T)
        assert np.abs(seen - xy).max() < 0.02


def test_gross_errors_weigh_little():
    rng = np.random.default_rng(5)
    R, blocks, xy = far_views(rng, seen=1.0)
    wrong = rng.choice(len(xy), len(xy) // 20, replace=False)
    xy[wrong] += rng.choice([-1, 1], (len(wrong), 2))
    assert away_deg(affine_starts(blocks, xy, CAMERA), R) < 5


@pytest.mark.parametrize('views, shared', [(2, POINTS), (VIEWS, 5)], ids=['two views', 'five'])
def test_too_little_gives_no_start(views, shared):
    _, blocks, xy = far_views(np.random.default_rng(0), seen=1.0)
    kept = (blocks.view < views) & (blocks.point < shared)
    assert affine_starts(PointBlocks(blocks.point[kept], blocks.view[kept]), xy[kept],
                         CAMERA) == []


@pytest.mark.parametrize('name', ['one place', 'a place a view', 'same views', 'half'])
def test_images_that_tell_nothing_give_finite_starts_or_none(name):
    _, blocks, xy = far_views(np.random.default_rng(0), seen=1.0)
    same = xy[blocks.view == 0][blocks.point]
    seen = {'one place': np.full_like(xy, 400.0), 'same views': same,
            'a place a view': 100.0 * blocks.view[:, None] + [50, 60],
            'half': np.where(blocks.view[:, None] < 3, same, 400.0)}[name]
    for state in affine_starts(blocks, seen, CAMERA):
        assert np.isfinite(state.points).all() and np.isfinite(state.path.cam_from_world()).all()


@pytest.mark.long
@pytest.mark.parametrize('seed', [41, 42])
def test_small_far_objects_give_a_camera(seed):
    # each of them is 12 pixels wide
    truth = cut_camera(1100.0, 1.0, (20.0, -10.0), (1280, 960))
    tracks = equal_objects(np.random.default_rng(seed), truth, TURNED, farness=30.0)
    result = calibrate(tracks, motion='general', facts=SQUARE)
    away = (result.camera.parameters - truth.parameters)[[0, 2, 3]]
    assert np.abs(away / np.sqrt(np.diag(result.covariance)[[0, 2, 3]])).max() < 3
    assert result.sigma['fx'] < 0.08 * truth.K[0, 0]
