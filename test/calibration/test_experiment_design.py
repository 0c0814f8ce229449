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
"""What the images and the facts say, and whether the advice holds what it promises."""

from dataclasses import replace

import numpy as np
import pytest

from selfcal_ros import calibrate, CameraFacts, Tracks
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import Prior, Priors
from selfcal_ros.calibration.bundle.robust_fit import fit_robustly, Observations
from selfcal_ros.calibration.bundle.scene_model import rescaled
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.uncertainty.experiment_design import suggest_motions
from selfcal_ros.synthetic.hard_scenes import (CAMERA, HARD_SCENES, NOISE_PX, one_curve, s_curve,
                                               scene, VIEWS)
from selfcal_ros.synthetic.scenes import pitched_mount, planar_poses
from test_support.hard_worlds import calibrated, SQUARE


def advised(result):
    text = ' '.join(result.notes) if result else result.advice
    return text[text.find(f'{VIEWS} more images'):] if 'more images' in text else ''


@pytest.mark.long
def test_a_near_circle_is_told_to_drive_an_s():
    _, result = calibrated('on the spot, 0.1 m off the axis', 0)

    assert 'drive an S' in advised(result)


@pytest.mark.long
def test_no_rotation_is_told_to_turn():
    _, result = calibrated('forward only', 0)

    assert not result
    assert 'drive an S' in advised(result)


def test_a_roll_about_the_optical_axis_is_told_another_axis():
    sequence = HARD_SCENES['general, about z only'](np.random.default_rng([1, 5]))
    result = calibrate(sequence.tracks, motion='general', facts=SQUARE)

    assert not result
    assert 'turn 20 degrees' in advised(result)
    assert 'roll' not in advised(result).split('would')[0]


def test_a_good_drive_gets_no_advice():
    _, result = calibrated('floor and wall', 0)

    assert not advised(result)


def test_what_is_promised_comes_true():
    """Drive the curve, ask, drive the S that is advised, and compare the sigmas."""
    rng = np.random.default_rng(3)
    mount = pitched_mount(np.radians(20))
    curve = scene(rng, planar_poses(mount, *one_curve(turn_deg=12)), count=120)
    result = calibrate(curve.tracks, facts=SQUARE)
    words = advised(result)
    assert 'an S, 45 degrees' in words
    promised = float(words.split('fx to ± ')[1].split(',')[0].split(' ')[0])

    more = scene(rng, planar_poses(mount, *s_curve(turn_deg=45)), count=150)
    both = calibrate(more.tracks, facts=SQUARE)

    # a curve of 12 degrees gives a hint
    assert result.hint.sigma['fx'] > 5 * promised
    # the information of the S alone is nearly all there is
    assert 0.5 < both.sigma['fx'] / promised < 2


def fit_of(views):
    """Return the optimum of a drive with a level camera, the skew stated with a sigma."""
    sequence = HARD_SCENES['S-curve, level camera'](np.random.default_rng([0, 5]))
    observations = Observations.of(sequence.tracks.in_frames(range(views)), np.arange(views))
    lens = Lens.of(CAMERA)
    held = {name: Prior(lens[name], 0.0) for name in lens.model.coefficients}
    priors = Priors({**held, 'skew': Prior(0.0, 1e-3)}, lens.model)
    points = np.column_stack([sequence.points[observations.track],
                              np.ones(len(observations.track))])
    start = SceneState(lens, AxisPath.of_poses(np.eye(3), sequence.cam_from_world[:views]),
                       points / np.linalg.norm(points, axis=1, keepdims=True))
    return fit_robustly(observations, rescaled(start), GENERAL, priors, NOISE_PX)


def test_a_fact_counts_once_however_few_observations_are_used():
    fit = fit_of(VIEWS)
    whole, tenth = (suggest_motions(fit, (640, 480), ('fx',), fraction)[0].sigma
                    for fraction in (1.0, 0.1))
    # no image says as much of the skew as it is stated to
    assert whole['skew'] == pytest.approx(1e-3, rel=1e-2)
    assert tenth['skew'] == pytest.approx(1e-3, rel=1e-2)
    assert tenth['fx'] < whole['fx']


def test_what_a_view_has_of_its_own_is_none_of_views_to_come():
    # more of these are simulated than there were, which ended in an exception
    few = VIEWS - 4
    fit = fit_of(few)
    fit = replace(fit, state=replace(fit.state, shift=np.zeros((few, 2)),
                                     row_motion=np.zeros((few, 6))))
    assert suggest_motions(fit, (640, 480), ('fx',))


def test_images_and_facts_are_told_apart():
    sequence = HARD_SCENES['S-curve, level camera'](np.random.default_rng([0, 5]))
    soft = CameraFacts(aspect_ratio=1.0, skew=0.0, principal_point=(328.0, 235.0),
                       principal_point_sigma_px=0.02)
    known = calibrate(sequence.tracks, facts=soft).identifiability

    # a fact far sharper than the images brings in nearly all of what is known
    assert known.from_images['cx'] < 0.1
    assert known.from_images['fx'] > 0.9
    assert known.without['principal point']['cx'] > 3

    # what real lenses are like is no image's word either
    alone = replace(SQUARE, lens_population=False)
    free = calibrate(sequence.tracks, facts=alone).identifiability
    assert all(abs(share - 1) < 1e-6 for share in free.from_images.values())
    # level camera: the aspect ratio rests on the fact, and a sentence says so
    assert free.without['aspect ratio']['fy'] > 5
    assert any('aspect ratio' in sentence for sentence in free.sentences())


def test_what_is_lost_without_a_fact_is_what_a_calibration_without_it_has():
    sequence = HARD_SCENES['S-curve, level camera'](np.random.default_rng([0, 5]))
    facts = replace(SQUARE, distortion='radial2')
    result = calibrate(sequence.tracks, motion='planar', facts=facts)
    without = calibrate(sequence.tracks, motion='planar',
                        facts=replace(facts, aspect_ratio=None))

    factor = result.identifiability.without['aspect ratio']['fx']
    assert 0.7 < factor * result.sigma['fx'] / without.sigma['fx'] < 1.4


def test_tracks_keep_the_camera_of_the_scenes():
    sequence = HARD_SCENES['two views'](np.random.default_rng(0))

    assert isinstance(sequence.tracks, Tracks)
    assert sequence.camera is CAMERA
    assert abs(np.std(sequence.tracks.xy - sequence.true_pixels[
        sequence.tracks.frame, sequence.tracks.track]) / NOISE_PX - 1) < 0.1
