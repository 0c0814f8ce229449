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
import json
from pathlib import Path

import numpy as np
import pytest
from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
from selfcal_ros.errors import InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.wide_recordings import wide_camera
from selfcal_ros.values.known_object import KnownObject
from selfcal_ros.values.tracks import Tracks

SIZE = (640, 480)
CAMERA = Camera([[610, 0, 330], [0, 640, 225], [0, 0, 1]], [-0.2, 0.08, 0.001, -0.002], *SIZE)
PINHOLE = Camera(CAMERA.K, np.zeros(4), *SIZE)
NO_SKEW = CameraFacts(skew=0.0)


def board(columns=9, rows=6, square=0.03):
    """Corners of a board, row by row."""
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * square
    return KnownObject(np.arange(x.size), points)


def corner(side=0.04, squares=4):
    """Two orthogonal planes of corners, as a Tsai grid."""
    u, v = np.meshgrid(np.arange(2 * squares) + 1.0, np.arange(2 * squares) + 1.0)
    u, v, o = u.ravel() * side, v.ravel() * side, np.zeros(u.size)
    points = np.concatenate([np.column_stack([u, o, v]), np.column_stack([o, u, v])])
    return KnownObject(np.arange(len(points)), points)


def looking_at(target, turns, distance):
    """Poses before an object, turned about its middle by the given angle-axis vectors."""
    middle = target.points.mean(axis=0)
    R = rotation_matrix(np.asarray(turns, float))
    t = np.array([0, 0, distance]) - R @ middle
    return np.concatenate([R, t[..., None]], axis=2)


def seen(target, poses, camera=CAMERA, noise_px=0.0, rng=None, frames=None):
    """Tracks of an object in every pose."""
    X = np.einsum('vij,pj->vpi', poses[:, :, :3], target.points) + poses[:, None, :, 3]
    assert X[..., 2].min() > 0
    xy = camera.project(X).reshape(-1, 2)
    if noise_px:
        xy = xy + noise_px * rng.standard_normal(xy.shape)
    frames = np.arange(len(poses)) if frames is None else frames
    return Tracks(np.repeat(frames, len(target)), np.tile(target.identity, len(poses)), xy, SIZE)


BOARD, CORNER = board(), corner()
TILTS = [[0.5, 0, 0], [0, 0.6, 0.1], [-0.4, 0.3, 0], [0.3, -0.5, 0.2], [-0.5, -0.3, 1.0]]
BOARD_POSES = looking_at(BOARD, TILTS, 0.45)
#: A view into the corner, third axis up in the image.
INTO_CORNER = rotation_matrix(np.array([0.25, 0.1, 0.05])) @ np.array(
    [[-1, 1, 0], [0, 0, -np.sqrt(2)], [-1, -1, 0]]) / np.sqrt(2)


def corner_poses(distances=(1.0,), shifts=((0, 0),)):
    """Views into the corner."""
    middle = CORNER.points.mean(axis=0)
    return np.array([np.column_stack([INTO_CORNER, [*shift, z] - INTO_CORNER @ middle])
                     for z, shift in zip(distances, shifts)])


@pytest.mark.parametrize('target, poses', [(BOARD, BOARD_POSES), (CORNER, corner_poses())],
                         ids=['five views of a board', 'one view of a corner'])
@pytest.mark.parametrize('camera', [CAMERA, PINHOLE], ids=['distorted', 'pinhole'])
def test_without_noise_it_is_exact(target, poses, camera):
    result = calibrate_known_object(seen(target, poses, camera), target, facts=NO_SKEW)

    assert result, result
    np.testing.assert_allclose(result.camera.parameters, camera.parameters, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(result.reconstruction.cam_from_world, poses, atol=1e-6)
    np.testing.assert_allclose(result.reconstruction.points[:, :3], target.points,
                               atol=1e-12)
    assert result.motion == 'known-object' and result.facts.distortion == 'plumb_bob'
    assert result.status['skew'] == 'held' and result.status['k1'] == 'estimated'
    assert result.outlier_count == 0


def test_far_origin_and_millimetres_change_nothing():
    tracks = seen(BOARD, BOARD_POSES, CAMERA, 0.2, np.random.default_rng(1))
    moved = KnownObject(BOARD.identity, 1000 * BOARD.points + [4e6, 5e6, 100])
    here, there = (calibrate_known_object(tracks, one, facts=NO_SKEW) for one in (BOARD, moved))

    np.testing.assert_allclose(there.camera.parameters, here.camera.parameters, rtol=1e-6,
                               atol=1e-7)
    X = there.reconstruction.cam_from_world[1] @ there.reconstruction.points[7]
    expected = here.reconstruction.cam_from_world[1] @ here.reconstruction.points[7]
    np.testing.assert_allclose(X, 1000 * expected, rtol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize('target, poses', [(BOARD, BOARD_POSES), (CORNER, corner_poses())],
                         ids=['board', 'corner'])
def test_covariance_is_that_of_many_runs(target, poses):
    facts = CameraFacts(skew=0.0, distortion='radial1')
    camera = Camera(CAMERA.K, [-0.2, 0, 0, 0], *SIZE)
    chosen = [0, 1, 2, 3, 5]
    distances = []
    for seed in range(30):
        result = calibrate_known_object(
            seen(target, poses, camera, 0.3, np.random.default_rng(seed)), target, facts=facts)
        error = (result.camera.parameters - camera.parameters)[chosen]
        distances.append(error @ np.linalg.solve(result.covariance[np.ix_(chosen, chosen)],
                                                 error))

    # chi-square of 5 degrees of freedom, mean over 30 runs: 5 ± 0.58; now and then a chance
    # pattern of the residuals counts as shared errors, which lowers it
    assert 5 - 3.5 * 0.58 < np.mean(distances) < 5 + 2.8 * 0.58


def test_gross_errors_are_left_out():
    rng = np.random.default_rng(4)
    tracks = seen(BOARD, BOARD_POSES, CAMERA, 0.1, rng)
    xy = tracks.xy.copy()
    bad = rng.choice(len(xy), 12, replace=False)
    xy[bad] += rng.uniform(10, 30, (12, 2))
    result = calibrate_known_object(Tracks(tracks.frame, tracks.track, xy, SIZE), BOARD,
                                    facts=NO_SKEW)

    assert 12 <= result.outlier_count <= 14
    assert result.noise_sigma_px == pytest.approx(0.1, rel=0.1)
    assert abs(result.camera.K[0, 0] - 610) < 4 * result.sigma['fx']


def test_a_board_that_does_not_show_k3_still_shows_decentring():
    result = calibrate_known_object(
        seen(BOARD, BOARD_POSES, CAMERA, 0.1, np.random.default_rng(4)), BOARD, facts=NO_SKEW)
    assert result.facts.distortion == 'radtan' and result.status['k3'] == 'held'
    assert result.status['p1'] == result.status['p2'] == 'estimated'
    error = result.camera.parameters - CAMERA.parameters
    assert (np.abs(error)[:-1] < 4 * np.sqrt(np.diag(result.covariance))[:-1] + 1e-12).all()


@pytest.mark.parametrize('model, values, choice', [
    ('equidistant', [-0.02, 0.006, -0.004, 5e-4], 'equidistant'),
    ('rational_polynomial', [0.78, 0.07, 1e-3, -2e-3, 0.001, 1.11, 0.24, 0.002], 'rational')])
def test_a_wide_lens_that_is_stated(model, values, choice):
    camera = Camera(CAMERA.K, values, *SIZE, model)
    result = calibrate_known_object(
        seen(BOARD, BOARD_POSES, camera, 0.1, np.random.default_rng(4)), BOARD,
        facts=CameraFacts(skew=0.0, distortion=choice))
    assert result.camera.model == model
    assert result.noise_sigma_px == pytest.approx(0.1, rel=0.1)
    error = (result.camera.parameters - camera.parameters)[:4]
    assert (np.abs(error) < 4 * np.sqrt(np.diag(result.covariance))[:4]).all()


def test_a_view_that_is_wrong_as_a_whole_is_left_out():
    tracks = seen(BOARD, BOARD_POSES, CAMERA, 0.1, np.random.default_rng(0))
    xy = tracks.xy.copy()
    wrong = np.flatnonzero(tracks.frame == 2)
    xy[wrong] = np.random.default_rng(1).permutation(xy[wrong])
    result = calibrate_known_object(Tracks(tracks.frame, tracks.track, xy, SIZE), BOARD,
                                    facts=NO_SKEW)
    assert result.frames == (0, 1, 3, 4)
    assert any('in frame 2, left out' in note for note in result.notes)
    assert abs(result.camera.K[0, 0] - 610) < 4 * result.sigma['fx']


def test_facts_are_measurements():
    tracks = seen(BOARD, BOARD_POSES, CAMERA, 0.3, np.random.default_rng(2))
    held = calibrate_known_object(tracks, BOARD, facts=CameraFacts(
        aspect_ratio=640 / 610, skew=0.0, principal_point=(330, 225)))
    assert held.camera.K[0, 2] == 330 and held.sigma['cx'] == 0
    assert held.camera.K[1, 1] / held.camera.K[0, 0] == pytest.approx(640 / 610)
    soft = calibrate_known_object(tracks, BOARD, facts=CameraFacts(
        skew=0.0, principal_point=(340, 225), principal_point_sigma_px=0.01))
    assert soft.camera.K[0, 2] == pytest.approx(340, abs=0.1)


@pytest.mark.parametrize('true, stated, fact, name', [
    ((525, 2.0, 0.0), {'aspect_ratio': 1.0, 'skew': 2.0}, 'aspect ratio', 'aspect'),
    ((520, 4.0, 0.0), {'skew': 0.0}, 'skew', 'skew'),
    ((520, 0.0, 0.0), {'skew': 0.0, 'principal_point': (338.0, 235.0)}, 'principal point', 'cx'),
    ((520, 0.0, 0.002), {'skew': 0.0, 'distortion': 'radial2'}, 'lens model', 'p1')])
def test_facts_that_a_board_contradicts_are_named(true, stated, fact, name):
    # the first was 5 sigmas off in silence, the last 11
    fy, skew, p1 = true
    camera = Camera([[520, skew, 328], [0, fy, 235], [0, 0, 1]], [-0.12, 0.05, p1, -p1], *SIZE)
    rng = np.random.default_rng(1)
    target = board()
    poses = looking_at(target, rng.uniform(-0.6, 0.6, (14, 3)), 0.5)
    tracks = seen(target, poses, camera, 0.1, rng)
    refused = calibrate_known_object(tracks, target, facts=CameraFacts(**stated))
    assert (refused.kind, refused.values['fact']) == ('fact_contradicted', fact)
    prefers = next(one for one in refused.values['preferred'] if one['name'] == name)
    truth = {'aspect': fy / 520, 'skew': skew, 'cx': 328.0, 'p1': p1}[name]
    assert abs(prefers['value'] - truth) < 4 * prefers['sigma']
    # declared exact, it is kept and told
    kept = calibrate_known_object(tracks, target, facts=CameraFacts(**stated, trusted=True))
    assert kept and fact in [one.values.get('fact') for one in kept.findings]


def test_one_board_suffices_where_the_facts_do():
    pose = looking_at(BOARD, [[0.5, 0.4, 0]], 0.45)
    facts = CameraFacts(aspect_ratio=640 / 610, skew=0.0, principal_point=(330, 225))
    result = calibrate_known_object(seen(BOARD, pose, PINHOLE), BOARD, facts=facts)
    assert result.camera.K[0, 0] == pytest.approx(610, rel=1e-5)


def test_one_board_without_facts_is_refused_even_with_distortion():
    """The lens would fix the camera, if only it were exactly what its model says."""
    pose = looking_at(BOARD, [[0.5, 0.4, 0]], 0.45)
    result = calibrate_known_object(seen(BOARD, pose, CAMERA, 0.05, np.random.default_rng(0)),
                                    BOARD, facts=NO_SKEW)
    assert not result and result.kind == 'one_flat_image'
    assert result.status['fx'] == 'unobservable' and result.status['skew'] == 'held'


def test_boards_under_one_tilt_are_refused():
    poses = looking_at(BOARD, [[0.4, 0, 0]] * 4, 0.5)
    poses[:, :2, 3] += [[0, 0], [0.05, 0], [0, 0.05], [-0.05, 0]]
    result = calibrate_known_object(seen(BOARD, poses, PINHOLE, 0.2, np.random.default_rng(0)),
                                    BOARD, facts=NO_SKEW)
    assert not result and result.kind == 'views_alike' and 'Tilt' in result.advice


def few(count, target=CORNER):
    keep = np.linspace(0, len(target) - 1, count).astype(int)
    return KnownObject(target.identity[keep], target.points[keep])


@pytest.mark.parametrize('target, shown, words', [
    (CORNER, few(3), '3 points'),
    (CORNER, few(5), 'a solid needs at least 6'),
    (CORNER, KnownObject([0, 1, 2, 3], CORNER.points[:4]), 'one line'),
    (few(6), few(6), 'Too few points'),
    (KnownObject(CORNER.identity + 1000, CORNER.points), CORNER, 'numbers of the two files'),
    (KnownObject(CORNER.identity, CORNER.points * [-1, 1, 1]), CORNER, 'mirror image'),
    (KnownObject(CORNER.identity, np.random.default_rng(0).permutation(CORNER.points)), CORNER,
     'do not fit'),
    (KnownObject([1, 2], np.ones((2, 3))), CORNER, 'no extent'),
], ids=['three', 'five', 'line', 'unknowns', 'numbers', 'mirror', 'misfit', 'one place'])
def test_what_cannot_be_calibrated_says_why(target, shown, words):
    facts = CameraFacts(distortion='radial1')
    result = calibrate_known_object(seen(shown, corner_poses(), PINHOLE), target, facts=facts)
    assert not result
    assert words in result.reason, str(result)
    assert result.motion == 'known-object'


def test_a_bad_view_is_left_out_with_a_note():
    poses = np.concatenate([BOARD_POSES, BOARD_POSES[:1]])
    tracks = seen(BOARD, poses, CAMERA, 0.1, np.random.default_rng(0))
    tracks = tracks.select((tracks.frame < 5) | (tracks.track < 3))
    result = calibrate_known_object(tracks, BOARD, facts=NO_SKEW)
    assert result.frames == (0, 1, 2, 3, 4)
    assert any('frame 5 has 3 points' in note for note in result.notes)


@pytest.mark.parametrize('identity, points, words', [
    ([1, 2], np.zeros((3, 3)), 'one length'),
    ([1, 2], [[0, 0, 0], [0, np.nan, 0]], 'not finite'),
    ([1, 1], np.eye(3)[:2], 'twice'), ([1], [[0, 0, 1e200]], 'not finite'),
])
def test_a_wrong_object_is_refused(identity, points, words):
    with pytest.raises(InputError, match=words):
        KnownObject(identity, points)


def data(name):
    """Return a recorded set, or skip."""
    for parent in Path(__file__).resolve().parents:
        if (parent / 'shared' / 'data' / name).is_dir():
            return parent / 'shared' / 'data' / name
    pytest.skip(f'../shared/data/{name} is not there')


def test_tags_with_given_corners():
    folder = data('vamr_tags3d')
    points = np.loadtxt(folder / 'p_W_corners.txt', delimiter=',') / 100
    xy = np.loadtxt(folder / 'detected_corners.txt').reshape(-1, 12, 2)
    tracks = Tracks(np.repeat(np.arange(len(xy)), 12), np.tile(np.arange(12), len(xy)),
                    xy.reshape(-1, 2), (752, 480))
    # the images are free of distortion
    for facts in (NO_SKEW, CameraFacts(skew=0.0, distortion='none')):
        result = calibrate_known_object(tracks, KnownObject(np.arange(12), points), facts=facts)
        assert result.camera.K[0, 0] == pytest.approx(420.507, rel=0.01)
        assert result.camera.K[1, 1] == pytest.approx(420.611, rel=0.01)


def test_boards_before_an_arm():
    corners = np.load(data('kuka_chess') / 'corners.npz')
    target = KnownObject(np.arange(476), corners['object'])
    tracks = Tracks(np.repeat(np.arange(30), 476), np.tile(np.arange(476), 30),
                    corners['image'].reshape(-1, 2), (1928, 1208))
    # what was published supposes a flat board
    result = calibrate_known_object(tracks, target, facts=NO_SKEW, flatness=0)
    true = [2057.976, 2058.374, 960.113, 610.095]
    error = result.camera.parameters[:4] - true
    assert np.abs(error[:2]).max() < 0.001 * 2058 and np.abs(error[2:]).max() < 1
    assert (np.abs(error) < 3 * np.array(list(result.sigma.values())[:4])).all()


def before_a_fisheye(rng, count=12, camera=None, reach_deg=75.0, noise_px=0.2):
    """Tracks of the board all over a 150 degree equidistant lens, and the lens."""
    camera = camera or wide_camera(150.0)
    middle = BOARD.points.mean(axis=0)
    seen_px: list[np.ndarray] = []
    while len(seen_px) < count:
        angle, about = np.deg2rad(rng.uniform(0, reach_deg - 10)), rng.uniform(0, 2 * np.pi)
        axis = np.array([-np.sin(about), np.cos(about), 0.0])
        towards = rotation_matrix(angle * axis)
        R = towards @ rotation_matrix(rng.uniform(-0.6, 0.6, 3))
        X = (BOARD.points - middle) @ R.T + rng.uniform(0.2, 0.5) * towards[:, 2]
        xy = camera.project(X)
        from_axis = np.arctan2(np.hypot(X[:, 0], X[:, 1]), X[:, 2])
        if (from_axis < np.deg2rad(reach_deg)).all() and (xy > 0).all() and (xy < SIZE).all():
            seen_px.append(xy + noise_px * rng.standard_normal(xy.shape))
    return Tracks(np.repeat(np.arange(count), len(BOARD)), np.tile(BOARD.identity, count),
                  np.concatenate(seen_px), SIZE), camera


@pytest.mark.long
def test_a_board_before_a_fisheye_shows_the_family_and_the_lens():
    inside = []
    for seed in range(6):
        tracks, camera = before_a_fisheye(np.random.default_rng(seed))
        result = calibrate_known_object(tracks, BOARD, facts=NO_SKEW)
        assert result, result
        assert result.facts.distortion == 'equidistant'
        known = np.flatnonzero(np.diag(result.covariance) > 0)
        off = (result.camera.parameters - camera.parameters)[known]
        assert abs(off[0]) < 4 * result.sigma['fx'] < 0.03 * camera.K[0, 0]
        C = result.covariance[np.ix_(known, known)]
        scale = np.sqrt(np.diag(C))
        inside.append(off / scale @ np.linalg.solve(C / np.outer(scale, scale), off / scale))
    # of chi square with eight degrees of freedom, the mean of six
    assert 3.5 < np.mean(inside) < 14


def test_a_board_that_reaches_behind_the_camera():
    # of a circle of 220 degrees; the outer corners lie up to 105 degrees from the axis
    camera = wide_camera(220.0, SIZE, (), filled='height', off_centre_px=(0, 0))
    tracks, _ = before_a_fisheye(np.random.default_rng(3), 14, camera, 105.0, 0.0)
    assert (camera.rays(tracks.xy)[:, 2] < -0.1).any()
    result = calibrate_known_object(tracks, BOARD,
                                    facts=CameraFacts(skew=0.0, distortion='equidistant'))
    assert result, result
    np.testing.assert_allclose(result.camera.parameters, camera.parameters, atol=1e-4)


def test_a_narrow_board_stays_with_the_perspective_family():
    tracks = seen(BOARD, BOARD_POSES, CAMERA, 0.2, np.random.default_rng(1))
    result = calibrate_known_object(tracks, BOARD, facts=NO_SKEW)
    assert result.camera.model == 'plumb_bob'


def test_recorded_fisheye_agrees_with_its_published_lens():
    truth = json.loads((data('fisheye_room') / 'truth.json').read_text())
    seen_by = [(k, np.array(frame['corners'])) for k, frame in enumerate(truth['frames'])
               if frame.get('corners')]
    rows = np.concatenate([c for _, c in seen_by])
    place = (8 * rows[:, 1] + rows[:, 0]).astype(int)
    y, x = np.mgrid[:6, :8].reshape(2, -1)
    target = KnownObject(np.arange(48), 0.117 * np.column_stack([x, y, 0 * x]))
    tracks = Tracks(np.concatenate([np.full(len(c), k) for k, c in seen_by]), place, rows[:, 2:],
                    (748, 480))
    # what was published supposes a flat board
    result = calibrate_known_object(tracks, target, facts=NO_SKEW, flatness=0)
    assert result, result
    assert result.facts.distortion == 'equidistant'
    np.testing.assert_allclose(np.diag(result.camera.K)[:2], np.diag(truth['K'])[:2], rtol=1e-3)
    grid = np.stack(np.meshgrid(np.arange(150.0, 620, 40), np.arange(20.0, 470, 40)), axis=-1)
    true = Camera(truth['K'], truth['dist'], 748, 480, 'equidistant')
    rays = true.rays(grid)
    # farther out there was no corner in the images
    rays = np.where(rays[..., 2:] > np.cos(np.deg2rad(70)), rays, np.nan)
    cosine = np.einsum('...i,...i', rays, result.camera.rays(grid))
    assert np.nanmax(np.arccos(np.clip(cosine, -1, 1))) < np.deg2rad(0.15)
