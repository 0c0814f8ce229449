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
"""Metric structure: known scenes come back up to the stated scale; the thesis's measures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import FocalCourse
from selfcal_ros.calibration.structure.metric_structure import (distance_error, metric_structure,
                                                                pattern_error, plane_angle,
                                                                to_affine, to_metric)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.synthetic.special_scenes import drive


def grid(rows=6, columns=8):
    """Return a flat grid of unit squares."""
    y, x = np.mgrid[:rows, :columns].astype(float)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def centres_of(poses):
    return -np.einsum('vji,vj->vi', poses[:, :, :3], poses[:, :, 3])


@pytest.fixture(scope='module')
def driven():
    sequence = drive(np.random.default_rng(5), noise_px=0.1, views=12, tracks=400)
    result = calibrate(sequence.tracks, facts=CameraFacts(1.0, 0.0, distortion='none'))
    assert result, result
    return sequence, result, metric_structure(result, sequence.tracks)


def test_structure_of_a_drive_is_the_scene_in_units_of_the_median_step(driven):
    sequence, _, structure = driven
    true = centres_of(sequence.cam_from_world)
    step = np.median(np.linalg.norm(np.diff(true, axis=0), axis=1))
    found = structure.centres
    assert np.median(np.linalg.norm(np.diff(found, axis=0), axis=1)) == pytest.approx(1)
    # all distances between points and to the cameras, without any alignment
    mine = np.vstack([found, structure.points])
    theirs = np.vstack([true, sequence.points[structure.tracks]]) / step
    apart = np.linalg.norm(mine[:, None] - mine[None], axis=-1)
    wanted = np.linalg.norm(theirs[:, None] - theirs[None], axis=-1)
    assert np.median(np.abs(apart - wanted)[wanted > 0] / wanted[wanted > 0]) < 0.005
    assert len(structure.points) + structure.left_out == len(driven[1].reconstruction.tracks)


def test_world_of_planar_motion_is_the_body_frame_of_the_first_view_and_upright(driven):
    _, _, structure = driven
    assert np.allclose(structure.centres[0], 0, atol=1e-12)
    assert np.abs(structure.centres[:, 2]).max() < 0.01
    down, forward = structure.cam_from_world[0, 1:, :3]
    assert down[2] < -0.8 and forward[0] > 0.8 and abs(forward[1]) < 1e-9
    assert np.allclose(structure.cam_from_world[0, :, :3] @ structure.cam_from_world[0, :, :3].T,
                       np.eye(3))


def test_what_a_point_is_known_to_is_true(driven):
    """With the true cameras, which the covariance takes as exact, errors are as large as said."""
    sequence, result, _ = driven
    tracks = sequence.tracks
    chosen = np.arange(0, 400, 5)

    def best(point):
        seen = np.flatnonzero(tracks.track == point)
        poses = sequence.cam_from_world[tracks.frame[seen]]

        def miss(X):
            return (sequence.camera.project(poses[:, :, :3] @ X + poses[:, :, 3])
                    - tracks.xy[seen]).ravel()

        return least_squares(miss, sequence.points[point]).x

    points = np.array([best(point) for point in chosen])
    views = np.unique(tracks.frame)
    shape = Reconstruction(views, sequence.cam_from_world[views], chosen,
                           np.column_stack([points, np.ones(len(points))]))
    exact = replace(result, camera=sequence.camera, reconstruction=shape, noise_sigma_px=0.1)
    structure = metric_structure(exact, tracks)
    assert len(structure.points) > 70
    back = structure.cam_from_world[0]
    unit = np.linalg.norm(centres_of(structure.cam_from_world)[-1]) / np.linalg.norm(
        centres_of(sequence.cam_from_world)[-1] - centres_of(sequence.cam_from_world)[0])
    true = sequence.points[structure.tracks] @ sequence.cam_from_world[0, :, :3].T
    true = ((true + sequence.cam_from_world[0, :, 3]) * unit - back[:, 3]) @ back[:, :3]
    error = structure.points - true
    chi2 = np.einsum('pi,pij,pj->p', error, np.linalg.inv(structure.covariance), error)
    # chi-square with three degrees of freedom; its mean of some 80 spreads by 0.27
    assert np.mean(chi2) == pytest.approx(3, abs=0.9)


def test_images_of_another_size_tell_as_much_as_their_noise(driven):
    # half as large, with half the noise: sigmas were half as large, too
    sequence, result, structure = driven
    tracks, centre = sequence.tracks, result.camera.K[:2, 2]
    views = np.asarray(result.reconstruction.frames)
    course = FocalCourse(views, np.full(len(views), 0.5 * result.camera.K[0, 0]),
                         np.zeros(len(views)))
    small = metric_structure(
        replace(result, focal=course, noise_sigma_px=0.5 * result.noise_sigma_px),
        replace(tracks, xy=centre + 0.5 * (tracks.xy - centre)))
    np.testing.assert_array_equal(small.tracks, structure.tracks)
    np.testing.assert_allclose(small.covariance, structure.covariance, rtol=1e-6)


def test_a_stricter_bound_keeps_fewer_points(driven):
    sequence, result, structure = driven
    strict = metric_structure(result, sequence.tracks, 0.002)
    assert 0 < len(strict.points) < len(structure.points)
    assert set(strict.tracks) <= set(structure.tracks)
    assert not len(metric_structure(result, sequence.tracks, 0.0).points)


@pytest.mark.filterwarnings('error')
def test_points_at_infinity_are_left_out_in_silence(driven):
    """Those that only a standing camera sees; NumPy warned of what is infinite times zero."""
    sequence, result, structure = driven
    shape = result.reconstruction
    points = shape.points.copy()
    far = np.isin(shape.tracks, structure.tracks[:20])
    points[far, 3] = 0
    rest = metric_structure(replace(result, reconstruction=replace(shape, points=points)),
                            sequence.tracks)
    assert set(rest.tracks) == set(structure.tracks[20:])


def test_projective_structure_is_upgraded_step_by_step():
    rng = np.random.default_rng(3)
    K = np.array([[500, 2, 320], [0, 510, 240], [0, 0, 1.0]])
    t = np.array([0.3, -0.2, 0.1])
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)
    points = np.column_stack([rng.normal(size=(20, 3)) + (0, 0, 5), np.ones(20)])
    cameras = np.stack([K @ np.eye(3, 4), K @ np.column_stack([R, t])])
    # spoil it: [I | 0] first, and a plane at infinity that is not (0, 0, 0, 1)
    plane = np.array([1e-3, -2e-3, 0.1])
    H = np.eye(4)
    H[:3, :3] = np.linalg.inv(K)
    H[3] = 0, 0, 0, 1
    upgrade = H.copy()
    affinely = np.eye(4)
    affinely[3, :3] = plane
    upgrade = H @ affinely
    spoilt_cameras = cameras @ upgrade
    spoilt_points = points @ np.linalg.inv(upgrade).T
    affine = to_affine(spoilt_cameras, spoilt_points, plane)
    # the infinite homography K R K^-1 (thesis 2.12)
    assert np.allclose(affine[0][1][:, :3], K @ R @ np.linalg.inv(K))
    found_cameras, found_points = to_metric(*affine, K)
    assert np.allclose(found_points / found_points[:, 3:], points)
    assert np.allclose(found_cameras, cameras)


def test_measures_of_perfect_structure_are_zero_at_any_scale_and_place():
    R = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    left = 0.37 * grid() @ R.T + (1, 2, 3)
    right = 0.37 * (grid()[..., [2, 1, 0]] + (0, 0, 0)) @ R.T + (1, 2, 3)
    assert distance_error([left, right]) < 1e-12
    assert pattern_error([left, right]) < 1e-12
    assert plane_angle(left, right) == pytest.approx(np.pi / 2)


def test_measures_have_the_size_of_the_defect():
    rng = np.random.default_rng(1)
    noisy = grid(30, 30) + rng.normal(scale=0.01, size=(30, 30, 3))
    # a distance is the difference of two coordinates, an angle of two directions
    assert distance_error(noisy) == pytest.approx(0.01 * np.sqrt(2), rel=0.1)
    assert pattern_error(noisy) == pytest.approx(0.02, rel=0.1)
    skewed = grid() @ np.array([[1, 0, 0], [np.sin(0.1), np.cos(0.1), 0], [0, 0, 1]])
    assert distance_error(skewed) < 1e-12
    assert pattern_error(skewed) == pytest.approx(0.1)
    for degrees in (60, 120):
        turned = grid() @ np.array([[np.cos(np.radians(degrees)), 0, np.sin(np.radians(degrees))],
                                    [0, 1, 0], [0, 0, 1]])
        assert np.degrees(plane_angle(grid(), turned)) == pytest.approx(degrees)


def test_missing_points_are_left_out_and_too_few_refused():
    holey = grid()
    holey[2, 3] = np.nan
    assert distance_error(holey) < 1e-12 and pattern_error(holey) < 1e-12
    assert plane_angle(holey, holey) == pytest.approx(0)
    for measure in (distance_error, pattern_error):
        with pytest.raises(ArgumentError):
            measure(np.full((2, 2, 3), np.nan))
        with pytest.raises(ArgumentError):
            measure(np.zeros((2, 3)))
    with pytest.raises(ArgumentError):
        plane_angle(grid(), np.zeros((2, 3)))
