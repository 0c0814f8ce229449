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
"""A focal length that is doubtful after a small turn is a hint; one that no lens has is none."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.estimators.acceptance import only_a_hint
from selfcal_ros.calibration.estimators.motion_class import widest_turn_rad
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import CENTRE_OUTSIDE, HINT, NotCalibrated
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.hard_scenes import hand, one_curve, s_curve, scene, vehicle

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')


@pytest.fixture(scope='module')
def curve():
    """Drive a curve of 6 degrees; returns the sequence and what comes of it."""
    sequence = vehicle(np.random.default_rng(1), one_curve(6, 6), count=100)
    return sequence, calibrate(sequence.tracks, motion='planar', facts=FACTS)


@pytest.mark.long
def test_a_curve_of_six_degrees_gives_a_hint_that_is_true_and_no_calibration(curve):
    sequence, result = curve
    assert not result and result.is_hint and result.kind == HINT
    assert str(result).startswith('A hint, no calibration: The camera turned by ')
    assert result.values['turned_deg'] == pytest.approx(6, abs=0.3)
    assert result.motion in ('planar', 'circular') and result.status['fx'] == 'estimated'
    found, truth = result.hint, sequence.camera.K[0, 0]
    assert result.values['focal_px'] == found.camera.K[0, 0]
    assert abs(found.camera.K[0, 0] - truth) < 4 * found.sigma['fx']
    with pytest.raises(AttributeError, match='hint'):
        result.camera


def test_a_small_turn_that_shows_the_focal_length_is_a_calibration():
    turns = 6 * np.array([[0, 0, 0], [.5, 1, .2], [-.5, .3, .3], [.2, -1, 0], [1, 0, 0]])
    sequence = hand(np.random.default_rng(1), turns, count=100)
    result = calibrate(sequence.tracks, motion='general', facts=FACTS)
    assert result and result.sigma['fx'] < 0.01 * result.camera.K[0, 0]


def _turning(known, turn_deg, share, **changed):
    """Return a result with another turn, and another sigma of fx as a share of it."""
    focal_px = known.camera.K[0, 0]
    # there and back: neither end is the first view
    R = rotation_matrix(np.radians(turn_deg) * np.array([[0, 0, 0.5], [0, 0, 0], [0, 0, 1.0]]))
    poses = np.concatenate([R, np.zeros((3, 3, 1))], axis=2)
    return replace(known, covariance=known.covariance * (share * focal_px / known.sigma['fx'])**2,
                   reconstruction=Reconstruction(np.arange(3), poses, np.zeros(0, int),
                                                 np.zeros((0, 4))), **changed)


@pytest.mark.parametrize('motion', ['planar', 'circular', 'general', 'pivot', 'rotation'])
@pytest.mark.parametrize('turn_deg, share, is_hint', [
    (14.9, 0.011, True), (15.2, 0.05, False), (3, 0.0099, False), (14.9, 0.0099, False)])
def test_the_gate_is_one_for_all_motions(curve, motion, turn_deg, share, is_hint):
    found = only_a_hint(_turning(curve[1].hint, turn_deg, share, motion=motion))
    assert (found is not None) == is_hint
    if is_hint:
        assert found.kind == HINT and found.values['motion'] == motion


@pytest.mark.parametrize('centre, share, stated, is_hint', [
    ((320, -3), 0.011, None, True), ((645, 240), 0.05, None, True), ((320, 3), 0.02, None, True),
    ((320, 130), 0.02, None, False), ((320, -3), 0.009, None, False),
    ((320, -3), 0.05, (320, -3), False)])
def test_an_unsure_camera_whose_principal_point_is_far_from_the_middle_is_a_hint(
        curve, centre, share, stated, is_hint):
    known = curve[1].hint
    K = known.camera.K.copy()
    K[:2, 2] = centre
    shown = _turning(known, 40, share, camera=replace(known.camera, K=K),
                     facts=replace(known.facts, principal_point=stated))
    found = only_a_hint(shown)
    assert (found is not None) == is_hint
    if is_hint:
        refusal = NotCalibrated.of(found)
        assert refusal.kind == CENTRE_OUTSIDE and refusal.is_hint
        assert f'at {centre[0]}, {centre[1]}' in refusal.reason


def test_the_widest_turn_is_between_any_two_views():
    about_x = np.radians([[10, 0, 0], [-20, 0, 0], [0, 0, 0]])
    assert np.degrees(widest_turn_rad(rotation_matrix(about_x))) == pytest.approx(30)
    assert widest_turn_rad(np.eye(3)[None]) == 0


@pytest.mark.long
def test_a_plane_that_nobody_stated_must_explain_a_clip_as_well_as_free_motion():
    """A hand goes aside, turns by 6 degrees and trembles: beside that no plane is likely."""
    t, rng = np.linspace(-0.5, 0.5, 8), np.random.default_rng(4)
    R = rotation_matrix(np.radians(np.column_stack(
        [1.2 * np.sin(9 * t + 4), 6 * t, 1.2 * np.cos(7 * t)])))
    centres = np.column_stack([-0.5 * t, 0.06 * np.sin(8 * t + 4), 0.08 * np.sin(11 * t + 8)])
    clip = scene(rng, np.concatenate([R, -R @ centres[:, :, None]], axis=2), count=80,
                 depth_m=(1.5, 5))
    result = calibrate(clip.tracks, facts=FACTS)
    assert result.motion == 'general' and result.is_hint
    found = result.hint
    away = found.camera.parameters[:4] - clip.camera.parameters[:4]
    assert (np.abs(away) < 4 * np.sqrt(np.diag(found.covariance))[:4]).all()


@pytest.mark.parametrize('focal_px', [60.0, 70.0])
def test_a_focal_length_that_no_lens_has_is_refused(focal_px):
    """A drone over a field came out at 15 px in images of 1280, 1109 sigmas off, in silence."""
    camera = Camera([[focal_px, 0, 320], [0, focal_px, 240], [0, 0, 1]], (), 640, 480)
    sequence = vehicle(np.random.default_rng(2), s_curve(), count=150, camera=camera)
    result = calibrate(sequence.tracks, facts=CameraFacts(1.0, 0.0, distortion='none'))
    if focal_px < 0.1 * 640:
        assert not result and result.kind == 'focal_too_short'
        assert result.values['focal_px'] == pytest.approx(focal_px, rel=0.01)
    else:
        assert abs(result.camera.K[0, 0] - focal_px) < 4 * result.sigma['fx']
