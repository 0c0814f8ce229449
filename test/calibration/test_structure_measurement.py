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
"""Sigmas of lengths and angles of the structure against repeated runs."""

from dataclasses import replace
import pickle

import numpy as np
import pytest

from selfcal_ros import (calibrate, CameraFacts, length_ratio, Measured, NotCalibrated,
                         structure_angle)
from selfcal_ros.calibration.bundle.lens import Lens, to_intrinsics, to_parameters
from selfcal_ros.calibration.bundle.motion import PLANAR
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import all_fixed, priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, RobustFit
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.structure.angular_measurement import measurement_sentences
from selfcal_ros.calibration.structure.structure_measurement import (corner_angle, distance_ratio,
                                                                     precision_of, regression)
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera import PARAMETER_NAMES
from selfcal_ros.report.result_json import result_to_dict
from selfcal_ros.synthetic.scenes import sequence_si

FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')


@pytest.fixture(scope='module')
def result():
    return calibrate(sequence_si(np.random.default_rng(0), 0.3, views=5).tracks, facts=FACTS)


@pytest.mark.long
def test_measurements_of_a_result_scatter_as_stated():
    """Calibrate the same scene and path with new noise; compare with the truth."""
    ratios, angles, typical = [], [], []
    for seed in range(20):
        sequence = sequence_si(np.random.default_rng([seed, 2]), 0.3, views=5)
        found = calibrate(sequence.tracks, facts=FACTS)
        X = sequence.points

        def ratio(first, second, X=X):
            return np.linalg.norm(X[first[1]] - X[first[0]]) / np.linalg.norm(
                X[second[1]] - X[second[0]])

        def angle(a, b, c, X=X):
            arms = X[[a, c]] - X[b]
            return np.arccos(arms[0] @ arms[1] / np.prod(np.linalg.norm(arms, axis=1)))

        one = length_ratio(found, (0, 30), (12, 45))
        ratios.append((one.value - ratio((0, 30), (12, 45))) / one.sigma)
        one = structure_angle(found, (3, 40, 21))
        angles.append((one.value - angle(3, 40, 21)) / one.sigma)
        told = found.measured
        typical.append((told.length_ratio.value - ratio(told.first, told.second))
                       / told.length_ratio.sigma)
        typical.append((told.angle_deg.value - np.degrees(angle(*told.corner)))
                       / told.angle_deg.sigma)

    # the root of the mean of 20 squares is 1 +- 0.16
    for scaled in (ratios, angles, typical):
        assert 0.7 < np.sqrt(np.mean(np.square(scaled))) < 1.35


def test_words_and_json_give_the_typical_measurements(result):
    told = result.measured
    stated = result_to_dict(result)['measurement']
    words = measurement_sentences(result.camera, result.covariance, told)[-1]

    again = length_ratio(result, told.first, told.second)
    assert stated['length_ratio'] == {
        'value': pytest.approx(again.value), 'sigma': pytest.approx(again.sigma),
        'first': list(told.first), 'second': list(told.second)}
    assert stated['structure_angle_deg'] == {
        'value': pytest.approx(np.degrees(structure_angle(result, told.corner).value)),
        'sigma': pytest.approx(np.degrees(structure_angle(result, told.corner).sigma)),
        'corner': list(told.corner)}
    assert f'{again.value:.3f}' in words and f'{told.angle_deg.sigma:.2g} degrees' in words
    # what the camera is known to less well is known less well
    wider = replace(result, covariance=4 * result.covariance)
    assert again.sigma < length_ratio(wider, told.first, told.second).sigma < 2 * again.sigma


@pytest.mark.parametrize('name', ['length_ratio', 'angle_deg'])
def test_a_measurement_that_says_nothing_is_not_told(result, name):
    """A ratio was told as 1 ± 26, and an angle as good to ± 2e+03 degrees."""
    known = getattr(result.measured, name)
    vague = replace(result.measured, **{name: replace(known, sigma=2 * known.value)})
    words = [' '.join(measurement_sentences(result.camera, result.covariance, one))
             for one in (result.measured, vague)]
    assert ['typical lengths' in one for one in words] == [True, False]


@pytest.mark.parametrize('first, second', [
    ((0, 0), (1, 2)), ((0, 1), (2, 2)), ((0, 9999), (1, 2)), ((-1, 0), (1, 2)), ((0,), (1, 2)),
    ((0, 1.5), (1, 2)), (7, (1, 2)), ((0, 10**30), (1, 2))])
def test_impossible_lengths_are_refused_in_a_sentence(result, first, second):
    with pytest.raises(ArgumentError, match=r'.\.$'):
        length_ratio(result, first, second)


def test_without_an_adjusted_structure_nothing_is_measured(result):
    for one in (NotCalibrated('nothing moves.'), replace(result, reconstruction=None),
                replace(result, reconstruction=replace(result.reconstruction, precision=None))):
        with pytest.raises(ArgumentError, match='no adjusted structure'):
            length_ratio(one, (0, 1), (2, 3))
        with pytest.raises(ArgumentError, match='no adjusted structure'):
            structure_angle(one, (0, 1, 2))
    with pytest.raises(ArgumentError, match='Track 1 is named twice'):
        structure_angle(result, (0, 1, 1))


def test_a_result_stays_small(result):
    copy = pickle.loads(pickle.dumps(result))
    before = len(pickle.dumps(copy))
    first = length_ratio(copy, (0, 30), (12, 45))

    assert len(pickle.dumps(copy)) == before
    # no derivatives, no covariance of poses
    assert before < 300 * result.observation_count
    assert first == length_ratio(result, (0, 30), (12, 45))


def test_the_covariance_is_that_of_the_public_parameters():
    """The sigma of fy is pixels; taken for that of the aspect ratio it would swamp everything."""
    fit = _fit(sequence_si(np.random.default_rng(5), 0.3, views=5),
               CameraFacts(distortion='none'))
    public, shape = to_parameters(fit.covariance, fit.state.lens), precision_of(fit)
    ends = (0, 30), (12, 45)

    assert public[1, 1] > 1e3 * fit.covariance[1, 1]
    np.testing.assert_allclose(to_intrinsics(public, fit.state.lens), fit.lens_covariance,
                               atol=1e-12)
    assert distance_ratio(shape, *ends, covariance=public).sigma == pytest.approx(
        distance_ratio(shape, *ends).sigma, rel=1e-6)


def test_a_camera_known_exactly_leaves_what_holding_it_leaves():
    """All nine parameters free, of which some are known to 1e-5 and others to pixels."""
    fit = _fit(sequence_si(np.random.default_rng(5), 0.3, views=5),
               CameraFacts(distortion='plumb_bob'))
    held = fit.bundle.with_priors(all_fixed(fit.state.lens))
    factor = fit.bundle.loss_factors(fit.linearisation)[0] / held.loss_factors(
        fit.linearisation)[0]
    ends = (0, 30), (12, 45)

    alone = distance_ratio(precision_of(replace(fit, bundle=held)), *ends)
    nothing = np.zeros((len(PARAMETER_NAMES),) * 2)
    assert distance_ratio(precision_of(fit), *ends, covariance=nothing).sigma == pytest.approx(
        alone.sigma * np.sqrt(factor), rel=1e-3)


def test_small_variances_are_no_rounding():
    covariance = np.diag([1e4, 0.0, 4.0, 1e-10])

    np.testing.assert_allclose(regression(covariance, np.array([50.0, 0.0, 2.0, 3e-10])),
                               [5e-3, 0, 0.5, 3])


def test_ratios_of_lengths_scatter_as_stated():
    """The same scene and path with new noise: chi-square of the ratio over the runs."""
    facts = CameraFacts(aspect_ratio=1.0, distortion='none')
    ends, spread, own = ((0, 30), (12, 45)), [], []
    for seed in range(30):
        sequence = sequence_si(np.random.default_rng([seed, 1]), 0.3, views=5)
        fit, true = _fit(sequence, facts), sequence.points
        apart = [np.linalg.norm(true[b] - true[a]) for a, b in ends]
        shape = precision_of(fit)
        found = distance_ratio(shape, *ends)
        spread.append((found.value - apart[0] / apart[1]) / found.sigma)
        nothing = np.zeros((len(PARAMETER_NAMES),) * 2)
        own.append(distance_ratio(shape, *ends, covariance=nothing).sigma / found.sigma)

    # chi-square over 30 runs: the root of its mean is 1 ± 0.13
    assert 0.7 < np.sqrt(np.mean(np.square(spread))) < 1.3
    # the camera's part is not nothing, and not all
    assert 0.1 < np.mean(own) < 1


def test_a_point_at_infinity_has_no_distance():
    fit = _fit(sequence_si(np.random.default_rng(0), 0.1), CameraFacts(1.0, distortion='none'))
    points = fit.state.points.copy()
    points[3] = [1, 0, 0, 0]
    near = precision_of(fit)
    far = replace(near, points=points)

    assert np.isnan(distance_ratio(far, (0, 3), (1, 2)).sigma)
    assert np.isnan(corner_angle(far, (0, 3, 1)).value)
    assert isinstance(corner_angle(far, (0, 2, 1)), Measured)
    with pytest.raises(ArgumentError):
        distance_ratio(near, (0, 1), (2, 2))


def _fit(sequence, facts) -> RobustFit:
    """Adjust a planar sequence from its truth."""
    tracks = sequence.tracks
    order = np.lexsort((tracks.frame, tracks.track))
    view, point = tracks.frame[order], tracks.track[order]
    poses = sequence.cam_from_world
    mount = poses[0, :, :3]
    # the world of the adjustment starts at the first view
    start = mount.T @ poses[0, :, 3]
    shifted = poses.copy()
    shifted[:, :, 3] -= poses[:, :, :3] @ start
    points = np.column_stack([sequence.points + start, np.ones(len(sequence.points))])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    path = AxisPath.of_poses(mount, shifted).flat()
    observations = Observations(view, point, tracks.xy[order], np.arange(len(points)))
    bundle = bundle_of(observations, PLANAR, priors_from_facts(facts), 0.3)
    state = bundle.optimise(SceneState(Lens.of(sequence.camera), path, points), 50, 1e-6)
    return RobustFit(bundle.with_sigma(bundle.noise_rms(state)), state, observations, 0)
