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
"""What is supposed of the camera, against images that know better."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from selfcal_ros import calibrate, Camera, CameraFacts, Tracks
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts, with_fixed
from selfcal_ros.calibration.bundle.robust_fit import fit_robustly, with_all_points
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators import one_motion, stated_facts
from selfcal_ros.calibration.estimators.contradictions import contradictions_of
from selfcal_ros.calibration.estimators.facts_in_the_way import preferred_by_all
from selfcal_ros.calibration.estimators.stated_facts import examine_facts
from selfcal_ros.calibration.initialisation.problem import observations_of
from selfcal_ros.calibration.uncertainty.prism import possible_prism
from selfcal_ros.calibration.uncertainty.two_cameras import two_cameras, two_focal_lengths
from selfcal_ros.cli.result_text import result_text
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.report.comparison import compare_cameras
from selfcal_ros.synthetic.few_view_scenes import general_views
from selfcal_ros.synthetic.hard_scenes import hand, s_curve, vehicle
from selfcal_ros.synthetic.zoomed_scenes import zoomed

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2', focal='constant',
                     shutter='global')
SIZE = (640, 480)


def seen_by(seed: int, aspect: float = 1.0, skew: float = 0.0, views: int = 6, lens=(-0.12, 0.05)):
    """Show a cloud of points to a hand-held camera that may not be what is stated of it."""
    camera = Camera([[520, skew, 328], [0, 520 * aspect, 235], [0, 0, 1]], lens, *SIZE)
    return general_views(np.random.default_rng(seed), camera, views=views, points=70, noise_px=0.2)


def optimum(scene, facts=SQUARE, xy=None):
    """Fit from the true path, under facts that may be wrong."""
    tracks = scene.tracks if xy is None else Tracks(scene.tracks.frame, scene.tracks.track, xy,
                                                    SIZE)
    observations = observations_of(tracks, tracks.frames)
    first = scene.cam_from_world[0]
    R = scene.cam_from_world[:, :, :3] @ first[:, :3].T
    t = scene.cam_from_world[:, :, 3] - R @ first[:, 3]
    path = AxisPath.of_poses(np.eye(3), np.concatenate([R, t[:, :, None]], axis=2))
    priors = priors_from_facts(facts)
    state = with_fixed(SceneState(Lens.of(scene.camera), path), priors)
    return fit_robustly(observations, with_all_points(state, observations), GENERAL, priors, 0.3)


def verdict(scene, **stated):
    """Ask the images about what is stated."""
    facts = replace(SQUARE, **stated)
    return examine_facts(optimum(scene, facts), facts, SIZE, 1.0)


@pytest.mark.parametrize('true, stated, fact, values', [
    ({'aspect': 1.02}, {}, 'aspect ratio', [1.02]),
    ({'skew': 3.0}, {}, 'skew', [3.0]),
    ({}, {'principal_point': (319.5, 239.5)}, 'principal point', [328, 235]),
    ({}, {'distortion': 'none'}, 'lens model', [-0.12, 0.05, 0, 0]),
    # a fact with a sigma is held against it
    ({'aspect': 1.02}, {'aspect_ratio_sigma': 0.003}, 'aspect ratio', [1.02])])
def test_a_wrong_fact_is_named_with_what_the_images_prefer(true, stated, fact, values):
    found = verdict(seen_by(1, **true), **stated)
    first = found.contradicted[0]

    assert first.fact == fact and len(found.contradicted) == 1
    for one, value in zip(first.preferred, values):
        assert abs(one['value'] - value) < 4 * one['sigma']
    assert first.sigmas > 4


def test_true_facts_are_let_pass():
    for seed in range(2, 6):
        assert not verdict(seen_by(seed), principal_point=(328, 235)).contradicted
    assert not verdict(seen_by(2, aspect=1.02), aspect_ratio_sigma=0.02).contradicted


@pytest.mark.parametrize('seed', range(2, 8))
def test_what_becomes_of_every_fact_is_told_wherever_the_limit_of_doubt_lies(seed, monkeypatch):
    """Between what the score says and what a fit says a fact was dropped: 10 sigma in silence."""
    fit = optimum(seen_by(seed, aspect=1.001))
    tested, = stated_facts._tested(fit, {'aspect ratio': ('aspect',)}, 1.0, None)
    between = np.sqrt(tested.p_value * stated_facts._released(fit, tested, SIZE)[1])
    monkeypatch.setattr(stated_facts, 'DOUBTED', between)
    found = examine_facts(fit, SQUARE, SIZE, 1.0)
    assert 'aspect ratio' in [one.fact for one in (*found.contradicted, *found.doubted)] + [
        fact for fact, *_ in found.unchecked]


def deviating(seed, bumps_px=0.0):
    """Show many points to a lens with k2, and with smooth bumps that no model has."""
    camera = Camera([[420, 0, 328], [0, 420, 235], [0, 0, 1]], (-0.25, 0.1), *SIZE)
    scene = general_views(np.random.default_rng(seed), camera, views=10, points=500, noise_px=0.2)
    xy = scene.tracks.xy + bumps_px * np.sin(scene.tracks.xy[:, ::-1] / 45)
    return Tracks(scene.tracks.frame, scene.tracks.track, xy, SIZE)


@pytest.mark.long
def test_a_stated_lens_that_another_model_explains_is_to_blame_for_the_field():
    tracks = deviating(0)
    result = calibrate(tracks, facts=replace(SQUARE, distortion='radial1'))
    told = {one.kind: one for one in result.findings}

    # without the blame the focal length is 5 sigmas off
    assert {'lens_deviates', 'fact_doubtful'} <= set(told)
    assert told['fact_doubtful'].values['fact'] == 'lens model'
    first = told['fact_doubtful'].values['preferred'][0]
    assert first['name'] == 'k2' and abs(first['value'] - 0.1) < 3 * first['sigma']
    assert abs(result.camera.K[0, 0] - 420) < 4 * result.sigma['fx']


@pytest.mark.long
def test_a_lens_like_no_model_is_not_blamed_on_what_was_stated():
    tracks = deviating(0, bumps_px=0.5)
    result = calibrate(tracks, facts=replace(SQUARE, distortion='plumb_bob'))

    assert 'lens_deviates' in [one.kind for one in result.findings]
    assert 'fact_doubtful' not in [one.kind for one in result.findings]
    assert abs(result.camera.K[0, 0] - 420) < 4 * result.sigma['fx']


def test_a_lens_that_was_chosen_is_no_fact_once_the_focal_length_is_free(monkeypatch):
    """A straight drive was refused for a lens model that nobody had stated."""
    asked = []
    refusal = NoEstimate(one_motion.NOT_CONSTANT)
    monkeypatch.setattr(one_motion, 'assess', lambda *_: refusal)
    monkeypatch.setattr(one_motion, 'parted_or_zooming',
                        lambda problem, *_: asked.append(problem.facts.distortion) or refusal)
    calibrate(seen_by(5, views=8).tracks, motion='general',
              facts=CameraFacts(aspect_ratio=1.0, skew=0.0))

    assert asked == ['auto']


def test_another_family_of_lenses_is_told_by_its_name():
    told = Finding('fact_contradicted_too', fact='lens model', sigmas=10.0, preferred=[
        {'name': 'lens', 'value': 'equidistant', 'sigma': 0.0, 'stated': 'plumb_bob'}])
    assert 'lens = equidistant in place of plumb_bob' in str(told)


@pytest.mark.long
def test_the_calibration_is_refused_unless_the_facts_are_declared_exact():
    tracks = seen_by(1, aspect=1.02).tracks
    refused = calibrate(tracks, motion='general', facts=SQUARE)
    kept = calibrate(tracks, motion='general', facts=replace(SQUARE, trusted=True))

    assert not refused and refused.kind == 'fact_contradicted'
    assert 'stated aspect ratio' in refused.reason and '--trust-facts' in refused.advice
    assert kept and 'fact_trusted' in [one.kind for one in kept.findings]
    assert np.isclose(kept.camera.K[1, 1], kept.camera.K[0, 0])


@pytest.mark.long
@pytest.mark.parametrize('true, fact, value', [({'aspect': 1.2}, 'aspect ratio', 1.2),
                                               ({'skew': 40.0}, 'skew', 40.0)])
def test_a_fact_so_wrong_that_no_start_stands_is_named(true, fact, value):
    tracks = seen_by(3, views=8, **true).tracks
    refused = calibrate(tracks, motion='general', facts=replace(SQUARE, focal='auto'))

    assert not refused and refused.kind == 'fact_contradicted'
    assert refused.values['fact'] == fact
    first = refused.values['preferred'][0]
    assert abs(first['value'] - value) < 4 * first['sigma']


def test_an_exact_plane_leaves_the_aspect_ratio_open_and_that_is_said_first():
    camera = Camera([[520, 0, 328], [0, 540.8, 235], [0, 0, 1]], (), *SIZE)
    scene = vehicle(np.random.default_rng(0), s_curve(8), camera=camera, count=120)
    result = calibrate(scene.tracks, motion='planar', facts=replace(SQUARE, distortion='none'))

    # 70 sigmas off, for the images do not know better
    assert abs(result.camera.K[1, 1] - 540.8) > 4 * result.sigma['fy']
    assert result.findings[0].kind == 'fact_unchecked'
    told = {one.values['fact']: one.values for one in result.findings
            if one.kind == 'fact_unchecked'}
    assert told['aspect ratio']['error'] == pytest.approx(0.05)
    assert {'fy', 'cy'} <= set(told['aspect ratio']['moves'])
    rows = {row.split()[0]: row for row in result_text(result).splitlines() if '±' in row}
    assert rows['fy'].endswith('estimated, if the aspect ratio is exact')
    # a sigma of the fact is in those of the result
    unsure = replace(SQUARE, distortion='none', aspect_ratio_sigma=0.02)
    held = calibrate(scene.tracks, motion='planar', facts=unsure)
    assert abs(held.camera.K[1, 1] - 540.8) < 3 * held.sigma['fy']
    assert abs(held.camera.K[1, 2] - 235) < 3 * held.sigma['cy']


def test_a_skew_of_two_pixels_is_in_the_sigmas_of_a_drive_once_it_has_one():
    """Beyond 4 sigmas over the image it was, in silence."""
    camera = Camera([[520, 2, 328], [0, 520, 235], [0, 0, 1]], (-0.2, 0.05), *SIZE)
    scene = vehicle(np.random.default_rng(3), s_curve(10), 5.0, camera=camera, count=80)
    exact, unsure = (calibrate(scene.tracks, motion='planar', facts=replace(
        SQUARE, distortion='radial2', skew_sigma_px=sigma)) for sigma in (0.0, 1.0))

    assert 'fact_open' in [one.kind for one in exact.findings]
    assert compare_cameras(camera, exact.camera, None, exact.covariance).sigmas.max() > 4
    assert 'fact_open' not in [one.kind for one in unsure.findings]
    assert compare_cameras(camera, unsure.camera, None, unsure.covariance).sigmas.max() < 4


def test_eight_views_of_a_drive_tell_what_an_aspect_ratio_of_a_twentieth_more_would_do():
    camera = Camera([[520, 0, 328], [0, 546, 235], [0, 0, 1]], (), *SIZE)
    scene = vehicle(np.random.default_rng(1), s_curve(8), camera=camera, count=40)
    result = calibrate(scene.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))

    assert abs(result.camera.K[1, 2] - 235) > 4 * result.sigma['cy']
    assert 'fact_unchecked' in [one.kind for one in result.findings]


@pytest.mark.parametrize('whole', [False, True], ids=['observations', 'tracks'])
def test_what_goes_with_the_rest_of_its_track_does_not_contradict(whole):
    scene, rng = seen_by(6), np.random.default_rng(6)
    tracks = scene.tracks
    bad = rng.random(tracks.track.max() + 1 if whole else len(tracks)) < 0.25
    bad = bad[tracks.track] if whole else bad
    xy = np.where(bad[:, None], rng.uniform(0, SIZE, (len(tracks), 2)), tracks.xy)
    fit = optimum(scene, xy=xy if whole else None)
    given = SimpleNamespace(given=Tracks(tracks.frame, tracks.track, xy, SIZE),
                            frames=tracks.frames)
    assert abs(contradictions_of(fit, given).share - bad.mean()) < 0.02


def test_images_of_two_cameras_are_parted():
    scene = seen_by(5, views=12)
    frame, xy = scene.tracks.frame, scene.tracks.xy
    of_two = np.where((frame % 3 == 1)[:, None], (xy - [328, 235]) * 1.03 + [332, 233], xy)
    # an image that is cut elsewhere from the middle on
    cut = xy - np.where(frame >= 6, 8.0, 0.0)[:, None]
    # a lens that zooms is one camera
    zoomed = (xy - [328, 235]) * (1 + 0.004 * frame[:, None]) + [328, 235]

    assert np.flatnonzero(two_cameras(optimum(scene, xy=of_two), 1.0)).tolist() == [1, 4, 7, 10]
    assert two_cameras(optimum(scene, xy=cut), 1.0).tolist() in (
        [False] * 6 + [True] * 6, [True] * 6 + [False] * 6)
    assert two_cameras(optimum(scene, xy=zoomed), 1.0) is None
    assert two_cameras(optimum(scene), 1.0) is None


def test_two_kinds_of_focal_lengths_alternate_or_zoom():
    spread = 0.001 * np.random.default_rng(0).standard_normal(12)

    assert two_focal_lengths(spread + 0.1 * (np.arange(12) % 4 == 1)).sum() == 3
    t = np.linspace(-1, 1, 20)
    bent = 0.08 * (np.arange(20) % 2) + 0.02 * t**3 - 0.03 * t**2
    assert (two_focal_lengths(bent) == (np.arange(20) % 2 == 1)).all()
    assert two_focal_lengths(0.1 * np.sin(np.arange(12))) is None
    assert two_focal_lengths(spread + 0.1 * (np.arange(12) > 5)) is None


def test_mirrored_images_are_named_before_anything_is_estimated():
    tracks = seen_by(6, views=8).tracks
    xy = tracks.xy.copy()
    flipped = np.isin(tracks.frame, (2, 3, 6))
    xy[flipped, 0] = SIZE[0] - 1 - xy[flipped, 0]
    result = calibrate(Tracks(tracks.frame, tracks.track, xy, SIZE), facts=SQUARE)

    assert not result and result.kind == 'images_mirrored'
    assert result.values['mirrored'] == (2, 3, 6)


def test_a_lens_that_is_much_decentred_may_be_a_prism():
    facts = replace(SQUARE, distortion='radtan')
    fit = optimum(seen_by(7, lens=(-0.12, 0.05, 0.004, -0.003)), facts)
    wider = possible_prism(fit, fit.lens_covariance, 1.0).covariance
    assert np.sqrt(np.diag(wider)[2:4]).min() > 1
    fit = optimum(seen_by(7, lens=(-0.12, 0.05, 0.0003, 0)), facts)
    assert possible_prism(fit, fit.lens_covariance, 1.0) is None


def test_what_is_preferred_of_another_lens_model_stays_as_it_was_told():
    # names of another model's coefficients ended in a traceback
    fit = optimum(seen_by(0))
    refusal = NoEstimate('fact_contradicted', name='lens model', sigmas=9.0, further=[],
                         preferred=[{'name': 'k6', 'value': 0.1, 'sigma': 0.01, 'stated': 0.0}])
    assert preferred_by_all(refusal, fit, fit.observations, SIZE) is refusal


@pytest.mark.long
def test_images_of_a_second_camera_in_a_hand_are_left_out():
    # what no plane explains is for free motion to refuse, with its own reason
    rng = np.random.default_rng([0, 5])
    time, starts = np.linspace(0, 2 * np.pi, 14), rng.uniform(0, 6, (3, 2))
    turns_deg = 18 * np.column_stack([np.sin(time + a) + np.sin(2 * time + b) for a, b in starts])
    scale = np.where(np.arange(14) % 3 == 1, 1.08, 1.0)
    sequence = zoomed(hand(rng, turns_deg, count=200), scale, rng)
    found = calibrate(sequence.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))

    assert 'other_camera_left_out' in [one.kind for one in found.findings]
    assert abs(found.camera.K[0, 0] - sequence.camera.K[0, 0]) < 4 * found.sigma['fx']
