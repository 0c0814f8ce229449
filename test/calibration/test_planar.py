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
"""Calibration from planar motion: right, or refused for the right reason."""

import numpy as np
import pytest

from selfcal_ros import calibrate, CameraFacts, NotCalibrated, Tracks
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import Camera, PARAMETER_NAMES
from selfcal_ros.synthetic import special_scenes
from selfcal_ros.synthetic.scenes import pitched_mount, planar_sequence, sequence_si

KNOWN_ASPECT = CameraFacts(aspect_ratio=1.0, distortion='none')
SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)


def deviations(result, camera):
    """Errors of the free parameters in stated sigmas."""
    sigma = np.sqrt(np.diag(result.covariance))
    free = sigma > 0
    return ((result.camera.parameters - camera.parameters)[free] / sigma[free])


@pytest.mark.long
def test_one_triplet_without_noise_is_exact():
    sequence = sequence_si(np.random.default_rng(0), 0.0)
    result = calibrate(sequence.tracks, facts=KNOWN_ASPECT)

    assert result
    np.testing.assert_allclose(result.camera.K, sequence.camera.K, atol=0.01)
    assert result.motion == 'planar'


@pytest.mark.parametrize('facts', [
    CameraFacts(aspect_ratio=1.1, distortion='none'),
    CameraFacts(aspect_ratio=1.1, skew=5.0, distortion='none'),
    CameraFacts(principal_point=(400.0, 300.0), distortion='none')])
def test_each_fact_picks_the_member_of_the_pencil(facts):
    sequence = sequence_si(np.random.default_rng(5), 0.1, aspect_ratio=1.1, skew=5.0)
    result = calibrate(sequence.tracks, facts=facts)

    assert result
    assert np.abs(deviations(result, sequence.camera)).max() < 4
    assert result.sigma['fx'] < 5


def test_without_a_fact_one_parameter_stays_open():
    sequence = sequence_si(np.random.default_rng(0), 0.1)
    result = calibrate(sequence.tracks, facts=CameraFacts(distortion='none'))

    assert not result
    assert 'one fact' in str(result)
    assert 'unobservable' in result.status.values()


@pytest.mark.parametrize('seed', range(3))
def test_level_horizon_needs_more_than_zero_skew(seed):
    sequence = special_scenes.level_horizon(np.random.default_rng(seed), 0.2)
    refused = calibrate(sequence.tracks, facts=CameraFacts(skew=0.0, distortion='none'))
    result = calibrate(sequence.tracks, facts=KNOWN_ASPECT)

    assert not refused
    assert refused.kind == 'horizon_level'
    assert result
    assert np.abs(deviations(result, sequence.camera)).max() < 4


@pytest.mark.parametrize('name, kind', [
    ('pure_translation', 'no_rotation'),
    ('pure_rotation', 'no_parallax'),
    ('nearly_equal_positions', 'no_parallax'),
    ('coplanar_points', 'no_parallax'),
    ('few_points', 'no_epipolar_geometry')])
@pytest.mark.parametrize('seed', range(2))
def test_degenerate_sequences_are_refused_with_the_reason(name, kind, seed):
    sequence = getattr(special_scenes, name)(np.random.default_rng(seed), 0.2)
    result = calibrate(sequence.tracks, motion='planar', facts=SQUARE)

    assert not result
    assert result.kind == kind


@pytest.mark.long
def test_a_camera_that_only_rotates_is_calibrated_as_such():
    sequence = special_scenes.pure_rotation(np.random.default_rng(0), 0.2, views=6)
    result = calibrate(sequence.tracks, facts=SQUARE)
    few = sequence.tracks.in_frames(range(3))

    assert result
    assert result.motion == 'rotation'
    # three views cannot show that it did not move as well
    assert not calibrate(few, facts=SQUARE)
    assert calibrate(few, motion='rotation', facts=SQUARE)
    assert np.abs(deviations(result, sequence.camera)).max() < 4


@pytest.mark.long
def test_one_plane_is_refused_in_every_motion():
    sequence = special_scenes.coplanar_points(np.random.default_rng(0), 0.2)
    for motion in ('auto', 'general', 'rotation'):
        assert not calibrate(sequence.tracks, motion=motion, facts=SQUARE)


@pytest.mark.long
@pytest.mark.parametrize('seed', range(2))
def test_general_motion_is_refused_or_right(seed):
    sequence = special_scenes.general_motion(np.random.default_rng(seed), 0.2)
    result = calibrate(sequence.tracks, facts=SQUARE)

    if result:
        assert np.abs(deviations(result, sequence.camera)).max() < 4
    else:
        assert result.kind == 'not_planar'


def test_circular_motion_of_many_views_is_solved_with_square_pixels():
    sequence = sequence_si(np.random.default_rng(3), 0.1, views=3, step_deg=12.0)
    ring = special_scenes.circular_motion(np.random.default_rng(3), 0.1)
    result = calibrate(ring.tracks, facts=SQUARE)

    # three views within 20 degrees: refused or right, never wrong
    if result:
        assert np.abs(deviations(result, ring.camera)).max() < 4
    assert calibrate(sequence.tracks, facts=SQUARE)


@pytest.mark.long
def test_turning_on_the_spot_does_not_end_beside_the_optimum():
    """Half a turn, camera 0.3 m off the axis: a valley with other optima beside the right one."""
    rng = np.random.default_rng(0)
    camera = Camera([[520, 0, 328], [0, 520, 235], [0, 0, 1]], [-0.12, 0.05, 0, 0], 640, 480)
    heading = np.radians(np.linspace(0, 180, 24))
    path = 0.3 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    points = rng.uniform((-12, -12, -1.2), (15, 12, 2.5), (6000, 3))
    tracks = planar_sequence(rng, camera, pitched_mount(np.radians(20)), heading, path, points,
                             0.1, only_inside=True).tracks.with_at_least(3)
    tracks = tracks.select(tracks.track < 1000)

    result = calibrate(tracks, facts=CameraFacts(aspect_ratio=1, skew=0, distortion='radial2'))

    assert result
    away = deviations(result, camera)
    assert np.abs(away).max() < 4
    assert result.sigma['fx'] < 10
    assert result.outlier_count < 0.02 * len(tracks)


def test_distortion_is_found_and_named():
    sequence = special_scenes.drive(np.random.default_rng(2), 0.1, views=16, tracks=700)
    straight = calibrate(sequence.tracks, facts=SQUARE)

    assert straight
    assert np.abs(deviations(straight, sequence.camera)).max() < 4
    bent = sequence_si(np.random.default_rng(2), 0.1, views=10, distortion=(-0.12, 0.05, 0, 0))
    result = calibrate(bent.tracks, facts=SQUARE)
    assert result
    assert result.status['k1'] == 'estimated'
    assert np.abs(deviations(result, bent.camera)).max() < 4


def test_outliers_do_not_matter():
    rng = np.random.default_rng(8)
    clean = sequence_si(rng, 0.1, views=8)
    dirty = special_scenes.with_outliers(clean, rng, 0.15)
    result = calibrate(dirty.tracks, facts=KNOWN_ASPECT)

    assert result
    assert np.abs(deviations(result, clean.camera)).max() < 4
    assert result.outlier_count >= 0.8 * dirty.outliers.sum()


def test_the_result_does_not_depend_on_the_start():
    sequence = sequence_si(np.random.default_rng(1), 0.2, views=6)
    free = calibrate(sequence.tracks, facts=KNOWN_ASPECT)
    for focal in (500.0, 1500.0):
        start = Camera([[focal, 0, 400], [0, focal, 300], [0, 0, 1]], width=800, height=600)
        other = calibrate(sequence.tracks, facts=KNOWN_ASPECT, start=start)

        shift = np.abs(other.camera.parameters - free.camera.parameters)[:5]
        assert (shift < 0.2 * np.sqrt(np.diag(free.covariance))[:5] + 1e-12).all()


def test_held_parameters_have_no_variance_and_say_why():
    sequence = sequence_si(np.random.default_rng(1), 0.2, views=4)
    result = calibrate(sequence.tracks, facts=CameraFacts(1.0, 0.0, distortion='none'))

    skew = PARAMETER_NAMES.index('skew')
    assert result.status['skew'] == 'held'
    assert 'skew' in result.held_by['skew']
    assert not result.covariance[skew].any()
    assert result.status['fx'] == result.status['fy'] == 'estimated'


def test_fixed_points_are_those_of_the_truth():
    sequence = sequence_si(np.random.default_rng(1), 0.0)
    fixed = calibrate(sequence.tracks, facts=KNOWN_ASPECT).fixed_points

    v, line = fixed.vanishing_point, fixed.horizon
    np.testing.assert_allclose(v[:2] / v[2], (-571.8, -11876), rtol=1e-3)
    np.testing.assert_allclose(line[:2] / line[2], (-2.003e-4, -2.510e-3), rtol=2e-3)
    assert abs(fixed.circular_point @ line) < 1e-6 * np.linalg.norm(fixed.circular_point)


@pytest.mark.parametrize('tracks', [
    Tracks([], [], np.zeros((0, 2)), (640, 480)),
    Tracks([0, 1], [5, 5], np.zeros((2, 2)), (640, 480)),
    Tracks(np.zeros(50), np.arange(50), np.ones((50, 2)), (640, 480))])
def test_too_little_is_a_reason_not_a_crash(tracks):
    result = calibrate(tracks, facts=SQUARE)

    assert isinstance(result, NotCalibrated)
    assert result.reason


def test_static_tracks_are_refused():
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 600, (80, 2))
    frame, track = np.divmod(np.arange(400), 80)
    tracks = Tracks(frame, track, xy[track] + 0.05 * rng.standard_normal((400, 2)), (640, 600))
    result = calibrate(tracks, facts=SQUARE)

    assert not result


def test_unknown_motion_is_an_error():
    with pytest.raises(ArgumentError, match='Motion'):
        calibrate(Tracks([], [], np.zeros((0, 2))), motion='flying')
