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
import json

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL, NEARLY_PLANAR
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import Prior, priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, fit_robustly, Observations,
                                                       RobustFit)
from selfcal_ros.calibration.bundle.scene_model import SceneModel
from selfcal_ros.calibration.bundle.shutter import RowShifts
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.zoom import VIEW_NAME, with_walk, Zoom, ZoomModel
from selfcal_ros.calibration.estimators import parted_tracks
from selfcal_ros.calibration.estimators.acceptance import most_agree
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.estimators.one_motion import _zooms_far, OneMotion
from selfcal_ros.calibration.estimators.parted_tracks import calibrate_sorted
from selfcal_ros.calibration.estimators.zoom_selection import contradicted
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.calibration.uncertainty.focal_course import (_steady_growth, focal_evidence,
                                                              gain_of_most, shape_gain, SURE)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.lenses.plumb_bob import PLUMB_BOB
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.result_json import result_from_dict, result_to_dict
from selfcal_ros.synthetic.hard_scenes import (bumpy, hand, rolled, s_curve, scene, short_tracks,
                                               vehicle)
from selfcal_ros.synthetic.special_scenes import with_outliers
from selfcal_ros.synthetic.zoomed_scenes import zoomed

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')
VIEWS = 8
LENS_NAMES = ('f', 'aspect', 'cx', 'cy', 'skew', *PLUMB_BOB.coefficients)


def drive(scale, seed=0, facts=FACTS, motion='planar'):
    """Calibrate an S-curve whose views are magnified; returns the result and the true fx."""
    rng = np.random.default_rng([seed, 14])
    scale = np.asarray(scale, float)
    sequence = zoomed(vehicle(rng, s_curve(len(scale)), count=80), scale, rng)
    result = calibrate(sequence.tracks, motion=motion, facts=facts)
    assert result, result.reason
    return result, sequence.camera.K[0, 0] * scale[list(result.frames)]


@pytest.fixture(scope='module')
def ramp():
    return drive(np.linspace(0.9, 1.2, VIEWS))


def test_a_zoom_is_found_in_every_view(ramp):
    result, fx = ramp
    course = result.focal

    assert course is not None and course.frames.tolist() == sorted(result.frames)
    assert np.abs(course.fx / fx - 1).max() < 0.01
    assert (np.abs(course.fx - fx) < 4 * course.sigma).all()
    # the camera is that of the mean
    assert result.camera.K[0, 0] == pytest.approx(np.exp(np.log(course.fx).mean()))
    assert abs(result.camera.K[0, 0] - np.exp(np.log(fx).mean())) < 4 * result.sigma['fx']
    assert any(one.kind in ('focal_varies', 'focal_drifts') for one in result.findings)


def test_a_zoom_by_more_than_movers_feign_is_no_stabiliser(ramp):
    """A video that zoomed by 40 % half-way was told as shifted by 12 px, 25 sigma off."""
    zoomed_by_a_third, _ = ramp
    shifted = replace(zoomed_by_a_third, focal=None)
    noise = zoomed_by_a_third.noise_sigma_px
    assert _zooms_far(zoomed_by_a_third, replace(shifted, noise_sigma_px=0.9 * noise))
    # shifts that leave clearly less are believed
    assert not _zooms_far(zoomed_by_a_third, replace(shifted, noise_sigma_px=0.7 * noise))
    # what moves seems to zoom by a tenth
    course = zoomed_by_a_third.focal
    slight = replace(course, fx=course.fx[0] * (course.fx / course.fx[0])**0.3)
    assert not _zooms_far(replace(zoomed_by_a_third, focal=slight), shifted)
    assert not _zooms_far(shifted, shifted)


def test_each_frame_has_its_camera(ramp):
    result, _ = ramp
    last = result.camera_of(result.frames[-1])

    assert last.K[0, 0] == pytest.approx(result.focal.fx[-1])
    assert last.K[1, 1] / last.K[0, 0] == pytest.approx(1.0)
    np.testing.assert_array_equal(last.K[:2, 2], result.camera.K[:2, 2])
    np.testing.assert_array_equal(last.distortion, result.camera.distortion)
    between = result.focal_of(0.5)
    assert result.focal.fx[0] < between.value < result.focal.fx[1] and between.sigma > 0


def test_the_file_holds_the_focal_lengths(ramp):
    content = json.loads(json.dumps(result_to_dict(ramp[0])))

    assert [one['frame'] for one in content['focal']] == list(ramp[0].frames)
    again = result_from_dict(content)
    np.testing.assert_allclose(again.focal.fx, ramp[0].focal.fx)
    assert again.facts == ramp[0].facts


@pytest.mark.long
def test_a_step_is_found_with_free_hands():
    rng = np.random.default_rng([3, 14])
    turns = 15 * rng.standard_normal((VIEWS, 3))
    scale = np.where(np.arange(VIEWS) < 3, 1.0, 1.1)
    sequence = zoomed(hand(rng, turns, count=80), scale, rng)
    result = calibrate(sequence.tracks, motion='general', facts=FACTS)

    assert result and result.focal is not None and not result.focal.is_steady
    fx = 520 * scale[list(result.frames)]
    assert (np.abs(result.focal.fx - fx) < 4 * result.focal.sigma).all()
    assert np.abs(result.focal.fx / fx - 1).max() < 0.01


def test_a_constant_focal_length_is_called_so():
    result, _ = drive(np.ones(VIEWS), seed=1)
    stated, _ = drive(np.ones(VIEWS), seed=1, facts=replace(FACTS, focal='constant'))

    assert result.focal is None and 'focal' not in result_to_dict(result)
    np.testing.assert_array_equal(result.camera.parameters, stated.camera.parameters)
    assert result.camera_of(3) is result.camera
    assert result.focal_of(3).value == result.camera.K[0, 0]


@pytest.mark.long
def test_a_plane_that_is_left_is_not_made_up_for_by_the_focal_length():
    rng = np.random.default_rng([0, 140])
    sequence = bumpy(rng, 5.0, count=120)
    result = calibrate(sequence.tracks, facts=FACTS)

    # the usual unevenness of a ground held the views by force: no calibration at all
    assert result and result.focal is None and result.motion == 'general'
    assert abs(result.camera.K[0, 0] - sequence.camera.K[0, 0]) < 4 * result.sigma['fx']


@pytest.mark.long
def test_a_warm_up_is_one_unknown():
    result, fx = drive(1 + 0.02 * np.linspace(-1, 1, VIEWS), seed=2)

    assert result.focal is not None and result.focal.is_steady
    assert np.abs(result.focal.fx - fx).max() < 4 * result.focal.sigma.max()


def test_a_constant_one_that_is_stated_is_tested():
    rng = np.random.default_rng([4, 14])
    scale = np.where(np.arange(VIEWS) < 3, 1.0, 1.05)
    tracks = zoomed(vehicle(rng, s_curve(VIEWS), count=100), scale, rng).tracks
    refused = calibrate(tracks, motion='planar', facts=replace(FACTS, focal='constant'))

    assert not refused and refused.kind == 'focal_not_constant'


@pytest.mark.long
def test_a_head_that_turns_may_zoom():
    rng = np.random.default_rng([5, 14])
    turns = np.radians(12 * rng.standard_normal((VIEWS, 3)))
    R = rotation_matrix(turns)
    scale = np.linspace(1.0, 1.1, VIEWS)
    head = scene(rng, np.concatenate([R, np.zeros((VIEWS, 3, 1))], axis=2), count=150)
    result = calibrate(zoomed(head, scale, rng).tracks, motion='rotation', facts=FACTS)

    assert result and result.focal is not None
    fx = 520 * scale[list(result.frames)]
    assert (np.abs(result.focal.fx - fx) < 4 * result.focal.sigma).all()
    assert np.abs(result.focal.fx / fx - 1).max() < 0.01


def fitted(sequence):
    """Return the optimum of a constant camera near the truth."""
    tracks = sequence.tracks.with_at_least(2)
    names, point = np.unique(tracks.track, return_inverse=True)
    observations = Observations(tracks.frame, point, tracks.xy, names)
    points = np.column_stack([sequence.points[names], np.ones(len(names))])
    state = SceneState(Lens.of(sequence.camera),
                       AxisPath.of_poses(np.eye(3), sequence.cam_from_world),
                       points / np.linalg.norm(points, axis=1, keepdims=True))
    bundle = bundle_of(observations, GENERAL, priors_from_facts(FACTS), 0.2)
    state = bundle.optimise(state, iterations=30, tolerance=0.01)
    return RobustFit(bundle.with_sigma(bundle.noise_sigma(state)), state, observations, 0)


def test_images_that_change_their_shape_are_no_zooms():
    rng = np.random.default_rng([6, 14])
    turns = 15 * np.sin(np.linspace(0, 9, VIEWS))[:, None] * [0.3, 1.0, 0.5]
    still = hand(rng, turns, count=100)
    scales = np.where(np.arange(VIEWS) < 3, 1.0, 1.02)
    zooms, rolls = fitted(zoomed(still, scales, rng)), fitted(rolled(still, rng, 0.05))

    assert focal_evidence(zooms, tuple(range(VIEWS)), 1.0).gain > 2 * shape_gain(zooms, 1.0)
    assert focal_evidence(rolls, tuple(range(VIEWS)), 1.0).gain < 0.5 * shape_gain(rolls, 1.0)
    quiet = focal_evidence(fitted(zoomed(still, np.ones(VIEWS), rng)), tuple(range(VIEWS)), 1.0)
    assert not quiet.varies


def test_what_rests_on_a_few_tracks_is_no_zoom():
    rng, instants = np.random.default_rng([2, 15]), tuple(range(14))
    turns = 8 * np.sin(np.linspace(0, 9, 14))[:, None] * [0.3, 1.0, 0.5]
    still = hand(rng, turns, shift_m=0.1, count=250, seen=short_tracks(rng, 3))
    tracks = still.tracks
    # gross errors along the epipolar lines of short tracks stay
    wrong = rng.random(len(tracks.frame)) < 0.08
    xy = tracks.xy + wrong[:, None] * rng.uniform(-40, 40, tracks.xy.shape)
    start = fitted(replace(still, tracks=replace(tracks, xy=xy)))
    errors = fit_robustly(start.observations, start.state, GENERAL, start.bundle.priors, 0.2)
    zooms = fitted(zoomed(still, np.where(np.arange(14) < 3, 1.0, 1.02), rng))

    found, few = (focal_evidence(fit, instants, 1.0) for fit in (zooms, errors))
    assert gain_of_most(zooms, instants, found, 1.0) > 4 * SURE
    assert few.varies and gain_of_most(errors, instants, few, 1.0) < SURE


def test_steps_of_a_free_view_sum_to_zero():
    model = SceneModel(replace(GENERAL, zoom=ZoomModel((0, 1, 2, 3))))
    unknowns = model.unknowns(4, LENS_NAMES)
    step = unknowns.selection @ np.arange(1.0, unknowns.count + 1)
    of_zoom = step[unknowns.of_views(VIEW_NAME)[:, 0]]

    assert of_zoom.sum() == pytest.approx(0) and of_zoom.any()
    np.testing.assert_array_equal(step[unknowns.members], np.arange(1.0, unknowns.count + 1))


def test_the_walk_is_measured_between_views():
    model = ZoomModel((0, 1, 3, 4), 0.01)
    unknowns = SceneModel(replace(GENERAL, zoom=model)).unknowns(4, LENS_NAMES)
    z = np.array([0.0, 0.01, 0.01, -0.02])

    def cost(value):
        nothing = 0.0, np.zeros(len(unknowns)), np.zeros(len(unknowns))
        return with_walk(nothing, Zoom(value), model, unknowns)

    # a step of one sigma, none, and one of three over the mean interval of 4/3
    assert cost(z)[0] == pytest.approx(0.5 * (1 / 0.75 + 9 / 0.75))
    slope = cost(z)[1][unknowns.of_views(VIEW_NAME)[:, 0]]
    numeric = [(cost(z + h)[0] - cost(z - h)[0]) / 2e-6 for h in 1e-6 * np.eye(4)]
    np.testing.assert_allclose(slope, numeric, rtol=1e-6, atol=1e-6)


def test_what_is_said_of_the_focal_length_is_checked():
    with pytest.raises(ArgumentError, match='one of auto, constant, varying'):
        CameraFacts(focal='zoom')


@pytest.mark.parametrize(('rejected', 'zooms', 'kind'), [
    (0.15, True, None), (0.25, True, 'too_many_outliers'), (0.25, False, None),
    (0.4, False, 'too_many_outliers')])
def test_less_may_contradict_a_focal_length_of_each_view(rejected, zooms, kind):
    refusal = most_agree(rejected, zooms)
    assert (None if refusal is None else refusal.kind) == kind


@pytest.mark.long
def test_a_true_zoom_is_kept_among_gross_errors():
    # a fifth of the observations contradicts; it was refused for that
    rng = np.random.default_rng([2, 16])
    scale = np.linspace(0.95, 1.1, VIEWS)
    sequence = zoomed(vehicle(rng, s_curve(VIEWS), count=80), scale, rng)
    few = calibrate(with_outliers(sequence, rng, 0.2).tracks, motion='planar', facts=FACTS)
    assert few and few.focal is not None
    fx = sequence.camera.K[0, 0] * scale[list(few.frames)]
    assert (np.abs(few.focal.fx - fx) < 4 * few.focal.sigma).all()


@pytest.mark.long
def test_a_steady_growth_may_be_steady_in_another_measure():
    # as much in every view, not by the same factor: cx was 8.5 sigmas off
    rng = np.random.default_rng([0, 16])
    scale = np.linspace(0.95, 1.1, VIEWS)
    sequence = zoomed(vehicle(rng, s_curve(VIEWS), count=50), scale, rng)
    result = calibrate(sequence.tracks, motion='planar', facts=FACTS)
    assert result.focal.is_steady
    assert abs(result.camera.K[0, 2] - sequence.camera.K[0, 2]) < 3 * result.sigma['cx']
    fx = sequence.camera.K[0, 0] * scale
    assert (np.abs(result.focal.fx - fx) < 3 * result.focal.sigma).all()
    # the bend is no more than the difference of the two
    assert result.sigma['cx'] < 2 and (result.focal.sigma < 0.004 * fx).all()


def test_a_growth_that_is_hinted_at_is_in_the_sigmas():
    # too little to be believed; the camera is that of a constant focal length
    rng = np.random.default_rng([4, 18])
    scale = 1 + 0.004 * np.linspace(-1, 1, VIEWS)
    sequence = zoomed(vehicle(rng, s_curve(VIEWS), count=80), scale, rng)
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0)
    result = calibrate(sequence.tracks, motion='planar', facts=facts)
    stated = calibrate(sequence.tracks, motion='planar', facts=replace(facts, focal='constant'))
    assert result.focal is None
    np.testing.assert_allclose(result.camera.K, stated.camera.K, rtol=0.005)
    assert 1.2 * stated.sigma['cy'] < result.sigma['cy'] < 2 * stated.sigma['cy']
    assert abs(result.camera.K[1, 2] - sequence.camera.K[1, 2]) < 1.5 * result.sigma['cy']


def test_tracks_are_not_parted_where_a_zoom_explains_what_is_still():
    # some that walk were sorted out, and the others stood still, as those of a zoom of 2 % do
    rng = np.random.default_rng([0, 19])
    sequence = zoomed(vehicle(rng, s_curve(VIEWS), count=100),
                      1 + 0.01 * np.linspace(-1, 1, VIEWS), rng)
    given = sequence.tracks
    walks = rng.normal(0, 3, given.xy.shape) * (given.track % 8 == 0)[:, None]
    tracks = replace(given, xy=given.xy + walks)
    graph = build_view_graph(tracks, np.random.default_rng(0))
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')
    problem = replace(problem_of(graph, tracks.image_size, facts), motion=NEARLY_PLANAR)
    fit = OneMotion(problem, graph, [], None)._first[0]

    def from_still(*_):
        raise AssertionError('calibrated from still tracks')

    assert contradicted(fit, problem)
    assert calibrate_sorted(fit, problem, graph, from_still) is None


@pytest.mark.long
def test_a_true_zoom_among_many_gross_errors_is_refused():
    # more than a third
    rng = np.random.default_rng([0, 16])
    sequence = zoomed(vehicle(rng, s_curve(6), count=50), np.linspace(0.95, 1.1, 6), rng)
    with_outliers(sequence, rng, 0.08)
    tracks = with_outliers(sequence, rng, 0.3).tracks
    many = calibrate(tracks, motion='planar', facts=CameraFacts(distortion='radial2'))
    assert not many and many.kind == 'too_many_outliers'


def test_tracks_are_not_parted_while_their_rows_are_read_in_turn(monkeypatch):
    """A traceback: without facts a shutter was found, and a zoom was doubted."""
    rng = np.random.default_rng(0)
    graph = build_view_graph(vehicle(rng, s_curve(4), count=40).tracks, rng)
    problem = problem_of(graph, (640, 480), FACTS)
    observed = problem.observations
    read = replace(observed, shutter=RowShifts.none(len(observed.view), Prior(0.0, 1.0)))
    monkeypatch.setattr(parted_tracks, 'coherent_fit', pytest.fail)
    assert parted_tracks.calibrate_coherent_tracks(
        replace(problem, observations=read), graph, [], pytest.fail) is None


@pytest.mark.parametrize('told, found', [(4.0, (0.5, 12.0)), (-1e-9, (0.0, 0.0))])
def test_rounding_tells_of_no_course(told, found):
    """An arm that only shifts was refused for singular equations, after overflows."""
    rate, information, along = _steady_growth(told * np.eye(3), np.full(3, -2.0), np.ones(3))

    assert (rate, information) == found
    assert along @ along == pytest.approx(max(told, 0))
