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
"""The benches run, and what they compute is true; the figures themselves take longer."""

from types import SimpleNamespace

from bench.__main__ import BENCHES, main
from bench.fisher import cramer_rao_bound
from bench.live.live import RATE_HZ, there_and_back
from bench.tables import Report
from bench.thesis import dinosaur, few_views, si_degenerate, si_horizon, si_triplet
import numpy as np
import pytest
from scipy.stats import chi2
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.synthetic.scenes import planar_poses, sequence_si, si_camera
from selfcal_ros.synthetic.special_scenes import circular_motion, drive, general_motion


def test_bound_of_si_is_what_the_scene_was_chosen_for():
    sigma = cramer_rao_bound(sequence_si(np.random.default_rng(0)), 0.1).sigma
    thesis = dict(zip(si_triplet.FREE, si_triplet.THESIS[0.1]))
    assert all(0.65 < sigma[name] / thesis[name] < 1.35 for name in sigma)


def test_bound_agrees_with_the_inverse_hessian_of_the_estimate():
    sequence = drive(np.random.default_rng(3), 0.1, 12, 500)
    free = ('fx', 'cx', 'cy', 'k1', 'k2')
    result = calibrate(sequence.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0,
                                                          distortion='radial2'))
    bound = cramer_rao_bound(sequence, result.noise_sigma_px, free).sigma
    for name in free:
        assert result.sigma[name] == pytest.approx(bound[name], rel=0.25), name


def test_bound_grows_with_noise_and_with_ignorance_and_shrinks_with_views():
    three = sequence_si(np.random.default_rng(0))
    known = cramer_rao_bound(three, 0.1, ('fx', 'cx', 'cy')).sigma
    open_skew = cramer_rao_bound(three, 0.1).sigma
    more = cramer_rao_bound(sequence_si(np.random.default_rng(0), views=6), 0.1).sigma
    for name in known:
        assert known[name] < open_skew[name]
        assert more[name] < open_skew[name]
        assert cramer_rao_bound(three, 0.3).sigma[name] == pytest.approx(3 * open_skew[name])


def test_bound_is_for_planar_motion_only():
    with pytest.raises(ValueError, match='not planar'):
        cramer_rao_bound(general_motion(np.random.default_rng(0)), 0.1)


def test_si_triplet_reaches_the_bound():
    runs = 16
    found = si_triplet.measure(0.3, runs, processes=1)
    assert not found['refused']
    ratio = found['refined'].std(axis=0, ddof=1) / found['bound']
    # 16 runs know a spread to 18 percent, and that of all four together to 9
    assert (ratio < 1.3).all() and (ratio > 0.7).all()
    bound = cramer_rao_bound(sequence_si(np.random.default_rng(0), 0.3), 0.3, si_triplet.FREE)
    distance = np.sum(found['refined'] @ np.linalg.inv(bound.covariance) * found['refined'])
    least, most = chi2.ppf([1e-3, 1 - 1e-3], found['refined'].size)
    assert least < distance < most
    assert (np.abs(found['refined'].mean(axis=0)) < 3.5 / np.sqrt(runs) * found['bound']).all()
    assert (found['linear'].std(axis=0, ddof=1) > found['bound']).all()
    shares = si_triplet.coverage(found['refined'], found['covariance'])
    assert np.abs(shares - si_triplet.SHARES).max() < 0.2


@pytest.mark.parametrize('index', range(len(si_degenerate.CASES)),
                         ids=[f'{c.name} {c.facts}' for c in si_degenerate.CASES])
def test_degenerate_scene_never_gives_a_wrong_camera(index):
    kind, *_ = si_degenerate.one_run((index, 'none', 1))
    assert kind != 'WRONG'
    assert si_degenerate.CASES[index].expected in ('either', kind)


@pytest.mark.parametrize('method', si_horizon.METHODS)
def test_horizon_and_point_lie_within_their_ellipsoids(method):
    sequence = sequence_si(np.random.default_rng(0))
    for (value, covariance), true in zip(si_horizon.one_run((0.1, method, 5)),
                                         (sequence.vanishing_point, sequence.horizon)):
        away = value - true[:2] / true[2]
        assert away @ np.linalg.solve(covariance, away) < 25


def test_dinosaur_measures_a_known_turntable():
    sequence = circular_motion(np.random.default_rng(0), 0.0, views=12, step_deg=10.0, aside=0.3)
    reconstruction = Reconstruction(np.arange(12), sequence.cam_from_world, np.arange(0),
                                    np.empty((0, 4)))
    result = SimpleNamespace(reconstruction=reconstruction, camera=sequence.camera)
    assert dinosaur.steps_deg(result) == pytest.approx(10.0)
    # the axis stands 0.3 to the left of the grid's centre
    K, first = sequence.camera.K, sequence.cam_from_world[0]
    centre = sequence.points.mean(axis=0)
    line = dinosaur.image_of_axis(result)
    side = [line @ K @ (first @ [*(centre[:2] + [0, y]), z, 1]) for y, z in
            ((0.3, 0.0), (0.3, 1.0), (0.0, 0.0))]
    assert np.abs(side[:2]).max() < 1e-9 * abs(side[2])


def test_published_cameras_show_their_fixed_points():
    mount = np.column_stack([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    K = si_camera().K
    poses = planar_poses(mount, np.radians([0, 10, 20]), np.zeros((3, 2)))
    poses[:, :, 3] = [0.1, -0.2, 4]          # a turntable: the camera's frame stands still
    warp = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 2, 0.3], [0, 0, 0.1, 1]])
    plus = np.array([[1, 0, 1], [0, 1, 1], [0, 0, 1]])
    horizon, _, circular = dinosaur.published_fixed_points(plus @ K @ poses @ warp)
    true = np.linalg.solve(K.T, mount[:, 2])
    assert np.abs(np.cross(horizon / np.linalg.norm(horizon),
                           true / np.linalg.norm(true))).max() < 1e-9
    i = np.linalg.solve(K, [*circular, 1])
    assert abs(i @ i) < 1e-9 * np.linalg.norm(i) ** 2


def test_a_missed_requirement_ends_with_status_1(capsys, monkeypatch):
    report = Report()
    report.section('a table')
    assert report.verdict('error', -0.5, 1.0, '%')
    assert not report.verdict('error', -1.5, 1.0, '%')
    assert len(report.failures) == 1
    monkeypatch.setattr('bench.thesis.si_horizon.run',
                        lambda report, _: report.judge(False, 'missed'))
    assert main(['si_horizon']) == 1
    assert 'MISSED' in capsys.readouterr().out


def test_every_bench_can_be_asked_for(capsys):
    with pytest.raises(SystemExit) as ended:
        main(['--help'])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert all(name in text for name in BENCHES)
    with pytest.raises(SystemExit) as ended:
        main(['nonsense'])
    assert ended.value.code == 2


def test_images_are_shown_there_and_back():
    shown = list(there_and_back(range(4), seconds=8 / RATE_HZ))
    assert shown == [0, 1, 2, 3, 2, 1, 0, 1]


@pytest.mark.long
def test_every_method_of_few_views_is_measured_and_degenerate_scenes_are_refused():
    general = few_views.general_run(0, 'usual')
    assert set(general) == set(few_views.GENERAL_METHODS)
    assert all(abs(error) < 2 for error, *_ in general.values())
    repeated = few_views.repeated_run(0, '2 parallel, 1 turned')
    assert set(repeated) == set(few_views.REPEATED_METHODS)
    assert all(abs(error) < 4 * sigma for error, sigma, _ in repeated.values())
    for name in ('two objects', 'two views'):
        assert few_views.degenerate_run(0, name) == ('refused', ('too_few_images',) * 2)
    good, bad, *_, inside, _ = few_views.summary([repeated], 'parallel stated')
    assert (good, bad, inside) == (1, 0, 1.0)
