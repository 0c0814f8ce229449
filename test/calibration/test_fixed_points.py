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
"""From tracks to fixed points to K: exact without noise, refused where undetermined."""

import numpy as np
import pytest
from selfcal_ros.calibration.planar import circular, conic_pencil as pencil, triplets
from selfcal_ros.calibration.planar.fixed_points import (calibrate_estimate,
                                                         calibrate_from_fixed_points, fixed_points)
from selfcal_ros.calibration.result import FixedPoints
from selfcal_ros.calibration.structure import upgrade
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry import projective, tensor_cameras, trifocal
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.synthetic import scenes, special_scenes
from test_support.image_maps import transform_points


@pytest.fixture
def rng():
    return np.random.default_rng(21)


def truth_of(sequence):
    return FixedPoints(sequence.horizon, sequence.vanishing_point, sequence.circular_point)


def parallel(a, b):
    return np.abs(np.cross(projective.unit(a), projective.unit(b))).max()


@pytest.mark.parametrize('method', ['batch', 'pairs'])
@pytest.mark.parametrize('views', [3, 6])
def test_exact_without_noise(rng, method, views):
    sequence = scenes.sequence_si(rng, 0.0, views, aspect_ratio=1.1, skew=5.0)
    found = fixed_points(sequence.tracks, method=method)
    assert found.motion == 'planar'
    assert parallel(found.fixed.horizon, sequence.horizon) < 1e-8
    assert parallel(found.fixed.vanishing_point, sequence.vanishing_point) < 1e-8
    i = sequence.circular_point
    assert min(parallel(found.fixed.circular_point, x) for x in (i, i.conj())) < 1e-8


@pytest.mark.parametrize('facts', [
    CameraFacts(aspect_ratio=1.1), CameraFacts(skew=5.0), CameraFacts(skew=5.0, aspect_ratio=1.1),
    CameraFacts(principal_point=(400, 300)),
    CameraFacts(principal_point=(400, 300), skew=5.0, aspect_ratio=1.1)])
def test_every_fact_gives_the_camera_exactly(rng, facts):
    sequence = scenes.sequence_si(rng, 0.0, aspect_ratio=1.1, skew=5.0)
    found = calibrate_from_fixed_points(truth_of(sequence), facts)
    assert found.K == pytest.approx(sequence.camera.K, abs=1e-5)
    assert found.omega == pytest.approx(projective.iac_from_calibration(found.K))


def test_zero_skew_gives_the_camera_exactly(rng):
    sequence = scenes.sequence_si(rng, 0.0, aspect_ratio=1.3)
    found = calibrate_from_fixed_points(truth_of(sequence), CameraFacts(skew=0.0))
    assert found.K == pytest.approx(sequence.camera.K, abs=1e-5)


def test_pencil_contains_the_true_conic(rng):
    sequence = scenes.sequence_si(rng, 0.0, aspect_ratio=1.1, skew=5.0)
    C, ll = pencil.conic_pencil(truth_of(sequence))
    omega = projective.iac_from_calibration(sequence.camera.K)
    basis = np.column_stack([C.ravel(), ll.ravel()])
    weights, *_ = np.linalg.lstsq(basis, omega.ravel() / np.linalg.norm(omega), rcond=None)
    assert basis @ weights == pytest.approx(omega.ravel() / np.linalg.norm(omega), abs=1e-9)


def test_aspect_ratio_with_skew_is_exact_where_the_thesis_neglects_it(rng):
    sequence = scenes.sequence_si(rng, 0.0, skew=60.0)
    C, ll = pencil.conic_pencil(truth_of(sequence))
    exact = [projective.calibration_from_iac(C + mu * ll)
             for mu in pencil.mu_from_aspect(C, ll, 1.0)]
    assert min(np.abs(K - sequence.camera.K).max() for K in exact
               if isinstance(K, np.ndarray)) < 1e-4
    # (5.8), the skew neglected
    mu = (C[1, 1] - C[0, 0]) / (ll[0, 0] - ll[1, 1])
    neglecting = projective.calibration_from_iac(C + mu * ll)
    assert np.abs(neglecting - sequence.camera.K).max() > 1


@pytest.mark.parametrize('noise_px', [0.0, 0.1])
@pytest.mark.parametrize('pitch_deg', [0.0, 20.0])
def test_zero_skew_alone_is_refused_with_a_level_horizon(rng, noise_px, pitch_deg):
    sequence = special_scenes.level_horizon(rng, noise_px, pitch_deg)
    found = fixed_points(sequence.tracks)
    refused = calibrate_from_fixed_points(found.fixed, CameraFacts(skew=0.0))
    assert not refused and refused.kind in ('skew_without_hold', 'fact_without_hold')
    assert 'horizon is inclined' in refused.reason
    K = calibrate_from_fixed_points(found.fixed, CameraFacts(aspect_ratio=1.0)).K
    assert K[0, 0] == pytest.approx(900, rel=1e-6 if noise_px == 0 else 0.02)


def test_no_fact_and_impossible_conic_are_refused(rng):
    fixed = truth_of(scenes.sequence_si(rng, 0.0))
    assert calibrate_from_fixed_points(fixed, CameraFacts()).kind == 'no_fact'
    # a v so near to the horizon leaves no camera, or one whose skew gives it away
    swapped = FixedPoints(fixed.horizon, np.array([400.0, 400.0, 1.0]), fixed.circular_point)
    refused = calibrate_from_fixed_points(swapped, CameraFacts(aspect_ratio=1.0))
    assert not refused and refused.kind in ('conic_not_definite', 'skew_too_large')


@pytest.mark.parametrize('scene, kind, noises', [
    (special_scenes.pure_translation, 'pairs_without_rotation', (0.0, 0.1, 0.5)),
    (special_scenes.pure_rotation, 'pairs_without_parallax', (0.0, 0.1, 0.5)),
    (special_scenes.nearly_equal_positions, 'pairs_without_parallax', (0.1, 0.5)),
    (special_scenes.coplanar_points, 'pairs_without_parallax', (0.0, 0.1, 0.5)),
    (special_scenes.few_points, 'too_few_shared', (0.0, 0.1)),
    (special_scenes.general_motion, 'pairs_not_planar', (0.0, 0.1))])
def test_degenerate_data_come_back_with_the_right_reason(rng, scene, kind, noises):
    for noise_px in noises:
        refused = fixed_points(scene(rng, noise_px).tracks)
        assert not refused and refused.kind == kind, (noise_px, refused)
        assert refused.reason.endswith('.')


def test_circular_motion_is_recognised_and_solved_with_known_pixels(rng):
    for options in ({'aside': 0.5}, {'aside': 0.5, 'aspect_ratio': 1.1, 'skew': 5.0}):
        sequence = special_scenes.circular_motion(rng, 0.0, 4, **options)
        found = fixed_points(sequence.tracks)
        assert found.motion == 'circular'
        assert abs(projective.unit(found.screw_axis) @ sequence.vanishing_point) < 1e-8
        K = sequence.camera.K
        facts = CameraFacts(aspect_ratio=K[1, 1] / K[0, 0], skew=K[0, 1])
        assert calibrate_estimate(found, facts).K == pytest.approx(K, abs=1e-3)
        assert calibrate_estimate(found, CameraFacts(skew=0.0)).kind == (
            'circular_motion_needs_facts')
    noisy = fixed_points(special_scenes.circular_motion(rng, 0.1, 12, aside=0.5).tracks)
    assert noisy.motion == 'circular'
    K = calibrate_estimate(noisy, CameraFacts(aspect_ratio=1.0, skew=0.0)).K
    assert K[0, 0] == pytest.approx(900, rel=0.03)


def test_facing_the_axis_of_a_circle_needs_the_principal_point(rng):
    sequence = special_scenes.circular_motion(rng, 0.0, 4)
    found = fixed_points(sequence.tracks)
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0)
    refused = calibrate_estimate(found, facts)
    assert not refused and refused.kind == 'axis_in_view'
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0, principal_point=(400, 300))
    assert circular.calibrate_circular(found.fixed.circular_point, found.screw_axis,
                                       facts).K == pytest.approx(sequence.camera.K, abs=1e-4)


def test_stated_spread_of_horizon_and_vanishing_point_is_the_observed_one(rng):
    runs, noise_px = 75, 0.1
    distance = np.zeros((runs, 2))
    for k in range(runs):
        sequence = scenes.sequence_si(rng, noise_px)
        found = fixed_points(sequence.tracks)
        for which, (x, covariance, truth) in enumerate((
                (found.fixed.horizon, found.pairs.horizon_covariance, sequence.horizon),
                (found.fixed.vanishing_point, found.pairs.vanishing_point_covariance,
                 sequence.vanishing_point))):
            # horizon in inverse pixels, v in pixels: both as (x / z, y / z)
            xy, spread = projective.euclidean_covariance(x, covariance)
            offset = xy - truth[:2] / truth[2]
            distance[k, which] = offset @ np.linalg.solve(spread, offset)
    inside = (distance < 4.605).mean(axis=0)
    assert (inside > 0.8).all() and (inside < 0.98).all()


def test_outliers_are_survived_with_ransac(rng):
    dirty = special_scenes.with_outliers(scenes.sequence_si(rng, 0.1), rng, 0.1)
    found = fixed_points(dirty.tracks, rng=rng)
    assert found.pairs.noise_px < 0.2
    K = calibrate_from_fixed_points(found.fixed, CameraFacts(aspect_ratio=1.0)).K
    assert K[0, 0] == pytest.approx(900, rel=0.05)


@pytest.mark.parametrize('views', [24, 120])
def test_a_drive_combines_many_triplets(rng, views):
    sequence = special_scenes.drive(rng, 0.1, views)
    found = fixed_points(sequence.tracks)
    assert len(found.triplet_kappas) > 10
    K = calibrate_from_fixed_points(found.fixed, CameraFacts(aspect_ratio=1.0)).K
    assert np.diag(K)[:2] == pytest.approx([520, 520], rel=0.003)
    assert K[:2, 2] == pytest.approx([320, 240], abs=2)


def test_frames_need_not_start_at_zero_nor_follow_each_other(rng):
    sequence = scenes.sequence_si(rng, 0.0)
    tracks = sequence.tracks
    moved = type(tracks)(tracks.frame * 7 + 100, tracks.track * 3 - 5, tracks.xy)
    found = fixed_points(moved, triplets=[(100, 107, 114)])
    assert found.triplet_frames.tolist() == [[100, 107, 114]]
    # the next one was taken for a frame that there is not
    for absent in ([100, 106, 114], [100, 107, 10**6]):
        with pytest.raises(ArgumentError, match='frame without tracks'):
            fixed_points(moved, triplets=[absent])
    assert parallel(found.fixed.horizon, sequence.horizon) < 1e-8


def test_choice_of_triplets_respects_common_tracks_and_limit(rng):
    _, _, xy = triplets.dense_tracks(special_scenes.drive(rng, 0.1, 60, 800).tracks)
    chosen = triplets.choose_triplets(xy, 12, 15)
    seen = np.isfinite(xy[..., 0])
    assert len(chosen) == 12 and (np.diff(chosen, axis=1) > 0).all()
    assert all(seen[t].all(axis=0).sum() >= 15 for t in chosen)
    assert np.ptp(chosen[:, 1]) > 30


def test_upgrade_of_projective_cameras_is_metric(rng):
    sequence = scenes.sequence_si(rng, 0.0, aspect_ratio=1.1, skew=5.0)
    found = fixed_points(sequence.tracks)
    xy = np.moveaxis(sequence.tracks.xy.reshape(50, 3, 2), 1, 0)
    tensor = trifocal.circular_points(*transform_points(found.canonical, xy)).tensor
    second, _ = tensor_cameras.cameras_in_pixels(tensor_cameras.planar_cameras(tensor),
                                                 found.canonical)
    to_affine = upgrade.affine_upgrade(upgrade.plane_at_infinity(second, found.fixed))
    camera = calibrate_from_fixed_points(found.fixed, CameraFacts(aspect_ratio=1.1))
    metric = second @ np.linalg.inv(upgrade.metric_upgrade(camera.K) @ to_affine)
    R = np.linalg.solve(camera.K, metric[:, :3])
    R /= np.cbrt(np.linalg.det(R))
    assert R @ R.T == pytest.approx(np.eye(3), abs=1e-6)
    assert np.degrees(np.arccos((np.trace(R) - 1) / 2)) == pytest.approx(10, abs=1e-4)
