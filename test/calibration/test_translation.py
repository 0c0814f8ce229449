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
"""Translated views: the chain as a start, the frames named or found, refusals."""

from dataclasses import replace
import re

import numpy as np
import pytest

from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.scenes import observe, si_camera

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0)


def arm(rng, turns_rad, noise_px=0.1):
    """Return three translated views, then one for each turn (3,), of points in a box."""
    points = rng.uniform([-1.5, -1.2, 4], [1.5, 1.2, 7], (250, 3))
    vectors = np.vstack([np.zeros((3, 3)), turns_rad])
    centres = np.vstack([[0, 0, 0], [0.5, 0.1, 0], [-0.3, 0.4, 0.1],
                         rng.uniform(-0.4, 0.4, (len(turns_rad), 3))])
    R = rotation_matrix(vectors)
    poses = np.concatenate([R, -R @ centres[:, :, None]], axis=2)
    return observe(rng, si_camera(), poses, points, noise_px)


TURNS = np.radians([[8, 3, 0], [-6, 9, 4], [2, -10, -8], [10, 5, 12.0]])


@pytest.mark.parametrize('frames', [None, (0, 1, 2)])
def test_truth_is_found_from_translated_views(frames):
    sequence = arm(np.random.default_rng(3), TURNS)
    result = calibrate(sequence.tracks, motion='translation', facts=FACTS,
                       translation_frames=frames)

    assert result
    assert 'translated' in result.notes[0]
    sigma = np.sqrt(np.diag(result.covariance))
    error = result.camera.parameters - sequence.camera.parameters
    assert np.abs(error[sigma > 0] / sigma[sigma > 0]).max() < 4
    assert result.sigma['fx'] < 9


@pytest.mark.parametrize('distortion', ['auto', 'none'])
def test_stated_translation_is_evidence(distortion):
    """Views that are stated to be parallel stay so, and make the calibration more certain."""
    facts = replace(FACTS, distortion=distortion)
    sequence = arm(np.random.default_rng(3), TURNS[:2])
    general = calibrate(sequence.tracks, motion='general', facts=facts)
    stated = calibrate(sequence.tracks, motion='translation', facts=facts,
                       translation_frames=(0, 1, 2))

    R = stated.reconstruction.cam_from_world[:3, :, :3]
    np.testing.assert_allclose(R[1:], R[[0, 0]], atol=1e-12)
    assert stated.sigma['fx'] < 0.97 * general.sigma['fx']
    sigma = np.sqrt(np.diag(stated.covariance))
    error = stated.camera.parameters - sequence.camera.parameters
    assert np.abs(error[sigma > 0] / sigma[sigma > 0]).max() < 4


@pytest.mark.parametrize('turn_deg, calibrated', [(0.3, True), (8.0, False)])
def test_what_is_said_to_be_translated_is_tested(turn_deg, calibrated):
    """A robot that repeats its orientation badly is forgiven; a wrong frame is not."""
    turns = np.vstack([np.radians([[turn_deg, 0, 0]]), TURNS])
    sequence = arm(np.random.default_rng(3), turns)
    result = calibrate(sequence.tracks, motion='translation', facts=FACTS,
                       translation_frames=(0, 1, 2, 3))

    assert bool(result) == calibrated
    said = ' '.join(result.notes) if result else result.reason
    found = re.search(r'translation turned by (?:up to )?([\d.]+) degrees', said)
    assert abs(float(found[1]) / turn_deg - 1) < 0.1


def test_translation_alone_says_nothing():
    sequence = arm(np.random.default_rng(3), np.zeros((2, 3)))
    for motion in ('translation', 'auto', 'general'):
        result = calibrate(sequence.tracks, motion=motion, facts=FACTS)

        assert not result
        assert result.kind in ('views_not_rotated', 'no_rotation')


def test_without_translated_views_it_says_so():
    rng = np.random.default_rng(5)
    sequence = arm(rng, np.radians(rng.uniform(-12, 12, (5, 3))))
    turned = sequence.tracks.in_frames([0, 3, 4, 5, 6, 7])
    result = calibrate(turned, motion='translation', facts=FACTS)

    assert not result
    assert result.kind == 'no_translated_pair'


def test_a_frame_that_is_not_there_is_told():
    sequence = arm(np.random.default_rng(3), TURNS)
    result = calibrate(sequence.tracks, motion='translation', facts=FACTS,
                       translation_frames=(0, 1, 2, 99))

    assert result and '99 had no part' in result.notes[1]


def test_frames_that_are_not_there_are_refused():
    sequence = arm(np.random.default_rng(3), TURNS)
    result = calibrate(sequence.tracks, motion='translation', facts=FACTS,
                       translation_frames=(0, 99))

    assert not result
    assert result.kind == 'too_few_stated_frames'
