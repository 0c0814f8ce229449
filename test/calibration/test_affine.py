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
"""Affine self-calibration: exact without noise, true covariance, refusal where theory says."""

import numpy as np
import pytest
from selfcal_ros.calibration.affine.affine_calibration import (affine_structure, calibrate_affine,
                                                               translated_pair)
from selfcal_ros.calibration.affine.diac import (_members, camera_from_dual_conic,
                                                 constraint_rows, linear_conic, unit_determinant)
from selfcal_ros.calibration.structure.metric_structure import distance_error
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.grid_scenes import (CORNER_NOISE_PX, CORNERS, grid_camera, grid_points,
                                               grid_sequence, random_rotations)
from selfcal_ros.values.tracks import Tracks

SIZE = (512, 512)
ZERO_SKEW = CameraFacts(skew=0.0)


def _sequence(seed, count, size='10', noise_px=CORNER_NOISE_PX, camera=None):
    rng = np.random.default_rng([seed, count])
    return grid_sequence(rng, random_rotations(rng, count, size), noise_px, camera)


def _parameters(K):
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1]])


@pytest.mark.parametrize('refine', [False, True])
@pytest.mark.parametrize('count, facts', [(1, ZERO_SKEW), (1, CameraFacts(aspect_ratio=1.5)),
                                          (2, CameraFacts()), (4, CameraFacts())])
def test_chain_is_exact_without_noise(count, facts, refine):
    camera = grid_camera(skew=0.0 if count == 1 else 3.0)
    found = calibrate_affine(_sequence(1, count, noise_px=0, camera=camera).tracks, (0, 1), SIZE,
                             facts, refine)
    assert np.allclose(found.K, camera.K, atol=1e-4)
    assert np.allclose(found.conic.linear_K, camera.K, atol=1e-4)
    X = found.metric()
    assert distance_error(X.reshape(2, CORNERS, CORNERS, 3)) < 1e-6


@pytest.mark.long
def test_stated_covariance_is_that_of_the_estimates():
    values, stated = [], []
    for seed in range(60):
        # one scene, many noises
        rng = np.random.default_rng(5)
        scene = grid_sequence(rng, random_rotations(rng, 4), 0)
        noise = CORNER_NOISE_PX * np.random.default_rng(seed).normal(size=scene.tracks.xy.shape)
        tracks = Tracks(scene.tracks.frame, scene.tracks.track, scene.tracks.xy + noise)
        found = calibrate_affine(tracks, (0, 1), SIZE)
        values.append(_parameters(found.K))
        stated.append(np.diag(found.conic.covariance))
    ratio = np.std(values, axis=0) / np.sqrt(np.mean(stated, axis=0))
    assert (np.abs(ratio - 1) < 0.35).all()
    deviation = np.mean(values, axis=0) - _parameters(grid_camera().K)
    assert (np.abs(deviation) < 4 * np.sqrt(np.mean(stated, axis=0) / 60)).all()


@pytest.mark.parametrize('axis, missing', [('x', {'fx', 'aspect_ratio'}),
                                           ('y', {'fy', 'aspect_ratio'}),
                                           ('z', {'fx', 'fy'})])
@pytest.mark.parametrize('noise_px', [0, CORNER_NOISE_PX])
@pytest.mark.parametrize('facts', [CameraFacts(), ZERO_SKEW])
def test_one_camera_axis_leaves_open_what_theory_says(axis, missing, noise_px, facts):
    for seed in range(2):
        found = calibrate_affine(_sequence(seed, 4, axis, noise_px).tracks, (0, 1), SIZE, facts)
        assert isinstance(found, NoEstimate) and not hasattr(found, 'K')
        open_ones = {k for k, state in found.values['status'].items() if state == 'unobservable'}
        assert missing <= open_ones
        if facts is ZERO_SKEW:
            assert open_ones == missing
            assert found.values['status']['skew'] == 'held'
        assert f"the camera's {axis} axis" in found.reason
        assert found.kind == 'rotations_about_camera_axis' and 'turned about' in found.reason


def test_known_aspect_ratio_settles_a_rotation_about_x():
    found = calibrate_affine(_sequence(0, 2, 'x').tracks, (0, 1), SIZE,
                             CameraFacts(aspect_ratio=1.5, skew=0.0))
    assert abs(found.K[0, 0] / 649 - 1) < 0.02


def test_one_axis_without_a_fact_is_refused():
    found = calibrate_affine(_sequence(0, 1).tracks, (0, 1), SIZE)
    assert found.kind == 'rotations_about_one_axis'


def _about(axis, seed, count=2, camera=None, noise_px=CORNER_NOISE_PX):
    """Rotations of 5 to 15 degrees about one axis of the camera."""
    rng = np.random.default_rng([seed, count])
    angles = rng.uniform(5, 15, count) * rng.choice([-1, 1], count)
    return grid_sequence(rng, np.outer(angles, axis / np.linalg.norm(axis)), noise_px, camera)


@pytest.mark.parametrize('axis, facts', [
    # of the family of an axis in the plane of x and z every member has zero skew
    ((1, 0, 1), ZERO_SKEW),
    # and one about a diagonal has an aspect ratio that a change of the focal length leaves
    ((1, 1, 0), CameraFacts(aspect_ratio=1.5)), ((1, 1, 1), CameraFacts(aspect_ratio=1.5))])
def test_a_fact_without_hold_on_the_family_gives_no_confident_camera(axis, facts):
    refused = 0
    for seed in (7, 11, 0, 5, 84):
        found = calibrate_affine(_about(np.array(axis), seed).tracks, (0, 1), SIZE, facts)
        if not found:
            assert found.kind in ('rotations_about_one_axis', 'rotations_about_camera_axis')
            refused += 1
            continue
        away = _parameters(found.K) - _parameters(grid_camera().K)
        assert (np.abs(away) <= 3 * np.sqrt(np.diag(found.conic.covariance))).all()
    assert refused >= 3


def test_an_aspect_ratio_about_one_axis_has_both_its_cameras():
    camera = grid_camera(skew=40.0)
    K = camera.K / [[512], [512], [1]]
    R = rotation_matrix([[0.1, 0.17, 0.0], [-0.15, -0.255, 0.0]])
    candidates, family = linear_conic(K @ R @ np.linalg.inv(K), 0.0,
                                      CameraFacts(aspect_ratio=1.5))
    cameras = [camera_from_dual_conic(conic) for _, conic in candidates]
    cameras = [found for found in cameras if not isinstance(found, NoEstimate)
               and abs(found[1, 1] / found[0, 0] - 1.5) < 1e-6]
    assert family and len(cameras) == 2
    one, other = sorted(np.abs(found - K).max() for found in cameras)
    assert one < 1e-6 and other > 0.05


def test_translation_only_and_two_views_leave_everything_open():
    still = grid_sequence(np.random.default_rng(0), np.zeros((3, 3))).tracks
    for tracks, frames in ((still, (0, 1)), (still, range(5)), (still.in_frames((0, 1)), (0, 1))):
        found = calibrate_affine(tracks, frames, SIZE, ZERO_SKEW)
        assert not found
        assert {found.values['status'][k] for k in ('fx', 'fy', 'cx', 'cy')} == {'unobservable'}


def test_gross_errors_are_weighed_down():
    tracks = _sequence(0, 4).tracks
    xy = tracks.xy.copy()
    rng = np.random.default_rng(1)
    wrong = rng.random(len(xy)) < 0.02
    xy[wrong] += rng.uniform(-30, 30, (wrong.sum(), 2))
    found = calibrate_affine(Tracks(tracks.frame, tracks.track, xy), (0, 1), SIZE)
    assert abs(found.K[0, 0] / 649 - 1) < 0.02


def test_further_translated_views_and_partial_tracks_take_part():
    rng = np.random.default_rng(2)
    sequence = grid_sequence(rng, np.vstack([np.zeros((2, 3)), random_rotations(rng, 4)]))
    seen = rng.random(len(sequence.tracks)) < 0.7
    tracks = sequence.tracks.select(seen)
    structure = affine_structure(tracks, (0, 1, 2, 3))
    assert structure.translated.sum() == 4 and len(structure.frames) == 8
    assert np.allclose(structure.cameras[structure.translated][:, :, :3], np.eye(3), atol=1e-9)
    found = calibrate_affine(tracks, (0, 1, 2, 3), SIZE)
    assert abs(found.K[0, 0] / 649 - 1) < 0.01
    assert len(structure.points) == len(grid_points())


def test_too_few_matches_are_refused_with_the_number():
    tracks = _sequence(0, 2).tracks
    found = translated_pair(tracks.select(tracks.track < 5), (0, 1))
    assert found.kind == 'too_few' and found.values['found'] == 5


@pytest.mark.parametrize('quadratic', [(1.0, -3.0, 2.0), (2.0, 3.0, 1.0), (0.0, 2.0, -3.0),
                                       (3.0, -2.0, 0.0), (1e-14, 1.0, -1.0), (0.0, -1.0, 0.0)])
def test_neither_end_of_a_family_is_lost(quadratic):
    # with a = 0 the finite root was lost, and no matrix at all took its place
    a, b, c = quadratic
    first, second = np.diag([1.0, 0, 1]), np.diag([0, 1.0, 1])

    def form(x, y):
        # of x first + y second: a y^2 + b x y + c x^2
        return a * x[1, 1] * y[1, 1] + b * x[0, 0] * y[1, 1] + c * x[0, 0] * y[0, 0]

    found = [matrix for _, matrix in _members('any', first, second, form)]
    assert len(found) == 2
    for matrix in found:
        x, y = matrix[0, 0], matrix[1, 1]
        assert abs(a * y * y + b * x * y + c * x * x) < 1e-9 * max(x * x, y * y)
    x, y = (np.array([matrix[k, k] for matrix in found]) for k in (0, 1))
    assert abs(x[0] * y[1] - x[1] * y[0]) > 1e-9


def test_linear_constraints_vanish_on_the_true_conic():
    K, R = grid_camera().K / 500, rotation_matrix([[0.1, 0.2, 0.0], [-0.1, 0.1, 0.05]])
    K[2, 2] = 1
    H = unit_determinant(5 * K @ R @ np.linalg.inv(K))[0]
    conic = K @ K.T
    c = conic[np.triu_indices(3)]
    assert np.abs(constraint_rows(H) @ c).max() < 1e-12
    (name, found), = linear_conic(H)[0]
    assert name == 'linear' and np.allclose(found / found[2, 2], conic)
