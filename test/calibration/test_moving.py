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
"""Things that move by themselves and tracks that jump, against the truth."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from selfcal_ros import calibrate, Camera, CameraFacts, Tracks
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import (fit_robustly, Observations,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.coherent_start import straight_and_bent
from selfcal_ros.calibration.estimators.zoom_selection import contradicted, zoomed_fit
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.initialisation.supposed_lens import supposed_camera
from selfcal_ros.calibration.moving.coherent_tracks import coherent_half
from selfcal_ros.calibration.moving.crowded_views import crowd_in_few_views
from selfcal_ros.calibration.moving.rigid_bodies import find_bodies
from selfcal_ros.calibration.moving.sorting import explained_share, explains_all, moving_findings
from selfcal_ros.calibration.moving.track_judgement import judged
from selfcal_ros.geometry.relative_pose import epipolar_angles, relative_motion
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.report.result_json import result_to_json
from selfcal_ros.values.track_labels import (JUMPED, MOVING, STATIC, TrackLabels,
                                             UNEXPLAINED)

CAMERA = Camera(np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), width=640, height=480)
FACTS = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='none')
NOISE_PX, VIEWS = 0.2, 10


def poses(rng, views=VIEWS):
    """Hand-held: turns about all axes, steps in all directions; cam_from_world (V, 3, 4)."""
    time = np.linspace(0, 2 * np.pi, views)[:, None]
    turns = 0.35 * np.sin(time * [1, 2, 1] + rng.uniform(0, 6, 3)) * [1, 1, 0.5]
    centres = 0.9 * np.sin(time * [1, 1, 2] + rng.uniform(0, 6, 3)) * [1, 0.6, 0.4]
    R = rotation_matrix(turns)
    return np.concatenate([R, -R @ centres[..., None]], axis=2)


def seen(points, path, rng):
    """Observe points (V, P, 3) that may move: frame, point, pixels of those in the image."""
    local = np.einsum('vij,vpj->vpi', path[:, :, :3], points) + path[:, None, :, 3]
    xy = CAMERA.project(local)
    inside = (local[..., 2] > 0.5) & ((xy > 0) & (xy < [640, 480])).all(axis=2)
    frame, point = np.nonzero(inside)
    return frame, point, xy[inside] + NOISE_PX * rng.standard_normal((len(frame), 2))


def world(rng, moving=0, jumping=0):
    """Tracks of a cloud, the last of them on a thing that moves or on a repeated pattern."""
    path, count = poses(rng), 150
    still = rng.uniform([-3, -2.2, 4], [3, 2.2, 9], (count, 3))
    points = np.tile(still, (VIEWS, 1, 1))
    if moving:
        body = rng.uniform(-0.7, 0.7, (moving, 3))
        turns = rotation_matrix(np.outer(np.linspace(0, 0.8, VIEWS), [0.2, 1, 0]))
        way = np.array([-1.2, 0.3, 5]) + np.outer(np.linspace(0, 1, VIEWS), [2.2, 0.3, -0.5])
        points[:, -moving:] = np.einsum('vij,pj->vpi', turns, body) + way[:, None]
    if jumping:
        late = np.arange(VIEWS)[:, None] >= rng.integers(3, VIEWS - 2, jumping)
        points[:, -jumping:] += late[..., None] * [0.4, 0, 0]
    frame, point, xy = seen(points, path, rng)
    return Tracks(frame, point, xy, (640, 480)).with_at_least(3)


def briefly_crossed(rng, views=16, body=10000):
    """Tracks of up to four views, and of three views on a thing that crosses slowly."""
    path, still = poses(rng, views), rng.uniform([-3, -2.2, 4], [3, 2.2, 9], (160, 3))
    frame, point, xy = seen(np.tile(still, (views, 1, 1)), path, rng)
    tracks = Tracks(frame, 10 * point + (frame + rng.integers(0, 4, 160)[point]) // 4, xy,
                    (640, 480)).with_at_least(3)
    thing, first = rng.uniform(-0.5, 0.5, (30, 3)), rng.integers(2, views - 5)
    step, turn = rng.normal(size=3), path[first + 1, :, :3]
    place = turn.T @ ([rng.uniform(-1, 1), rng.uniform(-0.7, 0.7), 4] - path[first + 1, :, 3])
    way = place + np.outer(np.arange(views) - first - 1, 0.03 * step / np.linalg.norm(step))
    frame, point, xy = seen(thing + way[:, None], path, rng)
    there = (frame >= first) & (frame < first + 3)
    return Tracks(np.r_[tracks.frame, frame[there]], np.r_[tracks.track, body + point[there]],
                  np.r_[tracks.xy, xy[there]], (640, 480)).with_at_least(3)


def off_by(result):
    """Errors of fx, cx, cy in sigmas."""
    error = result.camera.parameters[[0, 2, 3]] - CAMERA.parameters[[0, 2, 3]]
    return error / [result.sigma[name] for name in ('fx', 'cx', 'cy')]


def test_a_thing_that_moves_is_labelled_and_has_no_part():
    tracks = world(np.random.default_rng(4), moving=40)
    result = calibrate(tracks, motion='general', facts=FACTS)
    assert result, str(result)
    assert np.abs(off_by(result)).max() < 4
    labels = result.labels
    own = np.concatenate([labels.of(f'moving {k + 1}') for k in range(labels.bodies)])
    true = np.unique(tracks.track)[np.unique(tracks.track) >= 110]
    assert np.isin(true, own).mean() > 0.9
    assert np.mean(own < 110) < 0.05
    assert 'tracks_moving' in [one.kind for one in result.findings]
    assert result.outlier_count < 0.02 * len(tracks)
    told = json.loads(result_to_json(result))['labels']
    assert sorted(told) == sorted(labels.names)
    assert sum(len(some) for some in told.values()) == len(labels.track)


def test_what_passes_by_within_a_few_views_is_found_though_no_track_is_rejected():
    rng = np.random.default_rng(11)
    tracks = world(rng, moving=60)
    # each of its points is seen in three or four views: too short to lose its track
    first = rng.integers(0, 3, tracks.track.max() + 1)[tracks.track] * 3
    tracks = tracks.select((tracks.track < 90) | (
        (tracks.frame >= first) & (tracks.frame < first + 4))).with_at_least(3)
    result = calibrate(tracks, motion='general', facts=FACTS)
    assert result, str(result)
    assert np.abs(off_by(result)).max() < 4
    assert 'tracks_moving' in [one.kind for one in result.findings]
    labels = result.labels
    own = np.concatenate([labels.of(f'moving {k + 1}') for k in range(labels.bodies)])
    assert np.mean(own < 90) < 0.05


@pytest.mark.long
def test_few_brief_tracks_that_bend_the_estimate_are_found_from_without_them():
    tracks = briefly_crossed(np.random.default_rng(31))
    result = calibrate(tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0))
    assert result and np.abs(off_by(result)).max() < 3
    assert 'tracks_moving' in [one.kind for one in result.findings]
    labels = result.labels
    own = np.concatenate([labels.of(f'moving {k + 1}') for k in range(labels.bodies)])
    assert np.isin(np.unique(tracks.track[tracks.track >= 10000]), own).mean() > 0.5
    assert np.mean(own < 10000) < 0.05


def test_tracks_that_jump_are_used_in_two_parts():
    tracks = world(np.random.default_rng(5), jumping=30)
    result = calibrate(tracks, motion='general', facts=FACTS)
    assert result and np.abs(off_by(result)).max() < 4
    jumped = result.labels.of('jumped')
    assert len(jumped) > 20 and (jumped >= 120).all()
    assert len(result.reconstructed.tracks) > len(np.unique(tracks.track))


def test_a_pattern_on_few_tracks_is_named_and_patches_that_drift_are_none():
    def told(tracks):
        result = calibrate(tracks, motion='general', facts=FACTS)
        assert result and np.abs(off_by(result)).max() < 4
        return [one.kind for one in result.findings]

    rng = np.random.default_rng(3)
    assert 'tracks_jump' in told(world(rng, jumping=6))
    tracks = world(np.random.default_rng(3))
    first = np.full(150, VIEWS)
    np.minimum.at(first, tracks.track, tracks.frame)
    way = rng.normal(size=(150, 2)) * (rng.random(150) < 0.08)[:, None]
    since = (tracks.frame - first[tracks.track]) / VIEWS
    drifted = tracks.xy + 2.0 * since[:, None] * way[tracks.track]
    assert 'tracks_jump' not in told(Tracks(tracks.frame, tracks.track, drifted, (640, 480)))


def test_few_tracks_that_jump_are_told_beside_few_that_nothing_explains():
    def told(jumped, unexplained, still=500):
        label = np.repeat([JUMPED, UNEXPLAINED, STATIC], [jumped, unexplained, still])
        labels = TrackLabels(np.arange(len(label)), label)
        return [one.kind for one in moving_findings(labels, np.full(len(label), 8))]

    assert told(10, 20) == ['tracks_jump'] and told(6, 20) == []
    # gross errors on a quarter of the observations
    assert told(12, 170) == ['tracks_unexplained_whole']


def test_few_tracks_that_move_are_told_where_they_are_seen_all_the_time():
    label = np.repeat([MOVING, STATIC], [17, 480])
    labels, length = TrackLabels(np.arange(len(label)), label, bodies=1), np.repeat(
        [20, 6], [17, 480])
    finding, = moving_findings(labels, length)
    assert finding.kind == 'tracks_moving'
    assert finding.values['share'] == pytest.approx(17 / 497)
    assert not moving_findings(labels, np.full(len(label), 6))


@pytest.mark.long
@pytest.mark.parametrize('seed, noise_px', [(0, 0.0), (1, 0.05)])
def test_gross_errors_that_repeated_frames_share_are_no_jumps(seed, noise_px):
    rng = np.random.default_rng(seed)
    tracks = world(rng)
    bad = rng.random(len(tracks)) < 0.03
    xy = tracks.xy + bad[:, None] * rng.uniform(-40, 40, (len(tracks), 2))
    xy = np.tile(xy, (3, 1)) + noise_px * rng.standard_normal((3 * len(xy), 2))
    copies = np.concatenate([3 * tracks.frame + k for k in range(3)])
    result = calibrate(Tracks(copies, np.tile(tracks.track, 3), xy, (640, 480)),
                       motion='general', facts=FACTS)
    assert result and np.abs(off_by(result)).max() < 4
    assert not [one.kind for one in result.findings if one.kind.startswith('tracks_')]


def test_a_still_scene_is_not_sorted():
    result = calibrate(world(np.random.default_rng(6)), motion='general', facts=FACTS)
    assert result and result.labels is None
    assert 'labels' not in json.loads(result_to_json(result))


def test_motion_of_two_views_from_few_matches():
    rng = np.random.default_rng(7)
    R, t = rotation_matrix(np.array([0.05, -0.1, 0.02])), np.array([0.6, 0, 0.8])
    X = rng.uniform([-0.5, -0.5, 3], [0.5, 0.5, 4], (14, 3))
    a, b = X, X @ R.T + 0.4 * t
    b[:3] = rng.uniform([-0.5, -0.5, 3], [0.5, 0.5, 4], (3, 3))
    a, b = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (a, b))
    found, direction, agree = relative_motion(a, b, 1e-4, rng)
    assert agree[3:].all() and agree.sum() <= 12
    assert np.allclose(found, R, atol=1e-6)
    assert abs(direction @ t) == pytest.approx(1, abs=1e-6)
    assert np.abs(epipolar_angles(R[None], t[None], a, b)[0, 3:]).max() < 1e-12
    assert relative_motion(a[:5], b[:5], 1e-4, rng) is None


def test_few_still_tracks_fail_by_chance():
    rng = np.random.default_rng(8)
    point = np.repeat(np.arange(3000), 6)
    # a point takes three of twelve degrees of freedom
    distance = np.sqrt(rng.chisquare(2, len(point)) * 0.75)
    gross = rng.random(len(point)) < 0.02
    found = judged(point, np.where(gross, 50.0, distance))
    assert found.explained.mean() > 0.99
    drifted = judged(point, np.where(point < 300, distance + 2.2, distance))
    assert drifted.explained[:300].mean() < 0.1 and drifted.explained[300:].mean() > 0.99


def crowd(rng, crossing=False, drifting=False, gross=0.02):
    """Tell whether tracks of four views crowd, where in a few views half of them cross."""
    first = rng.integers(0, 17, 600)
    point, view = np.repeat(np.arange(600), 4), (first[:, None] + np.arange(4)).ravel()
    distance = np.sqrt(rng.chisquare(2, 2400) * 5 / 8)
    near, crosses = (first >= 6) & (first <= 9), rng.random(600) < 0.5
    if drifting:
        distance *= np.repeat(rng.uniform(0.8, 2, 600), 4)
    if crossing:
        # what stands still fits badly there, too
        distance *= np.repeat(np.where(near, np.where(crosses, 4.0, 2.0), 1.0), 4)
    distance[rng.random(2400) < gross] = 50.0
    observations = Observations(view, point, np.zeros((2400, 2)), np.arange(600))
    return crowd_in_few_views(judged(point, distance), observations)


@pytest.mark.parametrize('seed', range(51, 54))
def test_what_crosses_crowds_in_the_views_that_see_it(seed):
    def found(**what):
        return crowd(np.random.default_rng(seed), **what)

    assert found(crossing=True)
    # others that fail as wholes are in all views
    assert not found() and not found(drifting=True) and not found(gross=0.1)
    assert not found(crossing=True, drifting=True)


def test_shares_of_labels():
    labels = TrackLabels(np.arange(4), np.array([0, 0, 3, 5]), bodies=2)
    assert labels.of('jumped').tolist() == [2] and labels.of('moving 2').tolist() == [3]
    assert labels.share('moving 1') == 0


def test_an_absurd_bend_is_no_lens():
    # what things that move made of the epipolar lines of a recording
    camera = supposed_camera(500.0, (640, 480), CameraFacts(), (-9.0, 40.0))
    assert np.isfinite(camera.rays(np.array([[320.0, 240.0], [400.0, 300.0]]))).all()


def test_a_body_that_keeps_ahead_is_found_by_its_size():
    rng, views = np.random.default_rng(11), 16
    box = rng.uniform(-0.4, 0.4, (26, 3))
    # it hardly turns before the camera, and is now near, now far
    centre = np.column_stack([np.full(views, 0.2), np.full(views, 0.1),
                              1.8 + 0.3 * np.sin(np.linspace(0, 6, views))])
    xy = CAMERA.project((box + centre[:, None]).reshape(-1, 3)).reshape(views, 26, 2)
    xy += NOISE_PX * rng.standard_normal(xy.shape)
    wrong = rng.random((views, 26)) < 0.03
    xy[wrong] += rng.uniform(-40, 40, (wrong.sum(), 2))
    stray = rng.uniform(100, 400, (views, 6, 2))
    view, point = (one.ravel() for one in np.indices((views, 32)))
    order = np.lexsort((view, point))
    observations = Observations(view[order], point[order],
                                np.concatenate([xy, stray], axis=1).reshape(-1, 2)[order],
                                np.arange(32))
    _, members = next(find_bodies(observations, CAMERA, NOISE_PX, rng))

    assert set(members) <= set(range(26)) and len(members) >= 24


@pytest.mark.long
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_what_agrees_with_a_body_in_a_pair_by_chance_is_no_part_of_it(seed):
    """Points that pass by, with gross errors, are more than those of a thing that keeps ahead."""
    rng, views = np.random.default_rng(seed), 16
    box = rng.uniform(-0.4, 0.4, (30, 3)) + [0.2, 0.1, 1.8]
    ahead = box + np.outer(0.3 * np.sin(np.linspace(0, 6, views)), [0, 0, 1])[:, None]
    passing = rng.uniform([-3, -1, 3], [3, 1, 9], (40, 3))
    passed = np.einsum('vij,pj->vpi', rotation_matrix(np.outer(np.linspace(0, 0.8, views),
                                                               [0, 1, 0])), passing)
    passed = passed - np.outer(np.linspace(0, 2, views), [0, 0, 1])[:, None]
    xy = CAMERA.project(np.concatenate([ahead, passed], axis=1).reshape(-1, 3))
    xy = xy.reshape(views, 70, 2) + NOISE_PX * rng.standard_normal((views, 70, 2))
    wrong = rng.random((views, 70)) < np.where(np.arange(70) < 30, 0.03, 0.4)
    xy[wrong] += rng.uniform(-40, 40, (wrong.sum(), 2))
    view, point = (one.ravel() for one in np.indices((views, 70)))
    inside = ((xy > 0) & (xy < [640, 480])).all(axis=2).ravel()
    order = np.flatnonzero(inside)[np.lexsort((view[inside], point[inside]))]
    names, index = np.unique(point[order], return_inverse=True)
    observations = Observations(view[order], index, xy.reshape(-1, 2)[order], names)
    found = [set(names[members]) for _, members in find_bodies(observations, CAMERA, NOISE_PX,
                                                               rng)]
    assert len(found[0] & set(range(30))) >= 24 and len(found[0] - set(range(30))) <= 1


def test_things_are_parted_from_straight_starts_too_where_they_seem_to_bend_lines():
    """Pairs told a fisheye of 72 px of what kept ahead of a vehicle: 520 px was never tried."""
    problem = SimpleNamespace(size=(640, 480), facts=CameraFacts(), bend=(-2.5,))
    cameras = straight_and_bent(problem)
    straight = [not camera.distortion.any() for camera in cameras]
    assert straight == [True, False] * (len(cameras) // 2) and len(cameras) == 8
    assert cameras[0].K[0, 0] == 640 and cameras[1].K[0, 0] < 320
    problem.bend = (-0.05,)
    assert len(straight_and_bent(problem)) == 4


def observed(tracks):
    """Index tracks of all views."""
    order = np.lexsort((tracks.frame, tracks.track))
    names, point = np.unique(tracks.track[order], return_inverse=True)
    return Observations(tracks.frame[order], point, tracks.xy[order], names)


def fitted(tracks, path):
    """Fit tracks from given poses with a constant focal length."""
    observations = observed(tracks)
    lens = Lens.of(CAMERA)
    state = SceneState(lens, AxisPath.of_poses(np.eye(3), path), np.zeros((0, 4)))
    return fit_robustly(observations, with_all_points(state, observations), GENERAL,
                        priors_from_facts(FACTS), NOISE_PX)


def bent(seed, moving=60):
    """Tracks with a thing that moves, the true poses, and a fit that follows the thing."""
    rng = np.random.default_rng(seed)
    tracks, path = world(rng, moving=moving), poses(np.random.default_rng(seed))
    thing = tracks.select(tracks.track >= 150 - moving)
    still = tracks.select(tracks.track < 150 - moving)
    # as if every other still track was too short to weigh
    few = Tracks(np.append(thing.frame, still.frame[still.track % 2 == 0]),
                 np.append(thing.track, still.track[still.track % 2 == 0]),
                 np.concatenate([thing.xy, still.xy[still.track % 2 == 0]]), (640, 480))
    return tracks, path, fit_robustly_loosely(few, path)


def fit_robustly_loosely(tracks, path):
    """Fit tracks without leaving any out."""
    observations = observed(tracks)
    state = SceneState(Lens.of(CAMERA), AxisPath.of_poses(np.eye(3), path), np.zeros((0, 4)))
    return fit_robustly(observations, with_all_points(state, observations), GENERAL,
                        priors_from_facts(FACTS), 20.0, rounds=1)


@pytest.mark.parametrize('seed', range(21, 25))
def test_half_of_the_tracks_do_without_a_thing_that_moves(seed):
    rng = np.random.default_rng(seed)
    tracks, path = world(rng, moving=55), poses(np.random.default_rng(seed))
    # as far off as pairs of views and a supposed focal length are
    turned = rotation_matrix(0.003 * rng.standard_normal((VIEWS, 3))) @ path
    camera = Camera(np.array([[470.0, 0, 320], [0, 470, 240], [0, 0, 1]]), width=640, height=480)
    start = SceneState(Lens.of(camera), AxisPath.of_poses(np.eye(3), turned), np.zeros((0, 4)))
    half = coherent_half(observed(tracks), start, GENERAL, priors_from_facts(FACTS), 2.0, NOISE_PX)

    assert np.mean(half.observations.track >= 95) < 0.05
    assert NOISE_PX < half.bundle.sigma_px < 1.6 * NOISE_PX
    assert abs(half.state.lens['f'] / 500 - 1) < 0.01


@pytest.mark.parametrize('seed', range(21, 25))
def test_a_false_zoom_moves_what_stands_still(seed):
    tracks, path, fit = bent(seed)
    still = fitted(tracks.select(tracks.track < 90), path)
    names = np.unique(tracks.track)
    labels = TrackLabels(names, np.where(names < 90, STATIC, 4), 1)
    false = zoomed_fit(fit, tuple(range(VIEWS)))
    assert not explains_all(false, still.bundle.sigma_px, tracks, labels)
    assert explained_share(false, tracks, names[names < 90]) < 0.95

    # one that is true keeps all that a constant one explains
    scale = np.where(np.arange(VIEWS) < 5, 1.0, 1.06)[tracks.frame, None]
    magnified = Tracks(tracks.frame, tracks.track, [320, 240] + scale * (tracks.xy - [320, 240]),
                       (640, 480)).select(tracks.track < 90)
    constant = fitted(magnified, path)
    true = zoomed_fit(constant, tuple(range(VIEWS)))
    of_still = names[names < 90]
    assert explains_all(true, constant.bundle.sigma_px, magnified,
                        TrackLabels(of_still, np.full(len(of_still), STATIC), 0))
    assert explained_share(true, magnified, of_still) > 0.98


@pytest.mark.parametrize('seed', range(21, 23))
def test_what_leaves_less_of_all_tracks_than_others_of_still_ones_is_no_rival(seed):
    """Tracks that no fit explains counted against a zoom that left half the noise."""
    path = poses(np.random.default_rng(seed))
    tracks = world(np.random.default_rng(seed))
    scale = np.where(np.arange(VIEWS) < 5, 1.0, 1.06)[tracks.frame, None]
    xy = [320, 240] + scale * (tracks.xy - [320, 240])
    # every eighth track goes astray
    xy[tracks.track % 8 == 0, 0] += 2.0 * tracks.frame[tracks.track % 8 == 0]
    magnified = Tracks(tracks.frame, tracks.track, xy, (640, 480))
    constant = fitted(magnified, path)
    zoomed = zoomed_fit(constant, tuple(range(VIEWS)))
    names = np.unique(tracks.track)
    labels = TrackLabels(names, np.full(len(names), STATIC), 0)

    assert explained_share(zoomed, magnified, names) < 0.95
    assert zoomed.bundle.noise_rms(zoomed.state) < 0.8 * constant.bundle.sigma_px
    assert explains_all(zoomed, constant.bundle.sigma_px, magnified, labels)


@pytest.mark.parametrize('seed', range(31, 35))
def test_a_few_tracks_make_no_zoom(seed):
    rng = np.random.default_rng(seed)
    tracks, path = world(rng), poses(np.random.default_rng(seed))
    problem = SelfCalibrationProblem(observed(tracks), [], (640, 480), FACTS, NOISE_PX,
                                     motion=GENERAL, instants=tuple(range(VIEWS)))
    # four points of a hundred and more, magnified in one view
    some = (tracks.track % 30 == 3) & (tracks.frame == 4)
    xy = tracks.xy + some[:, None] * 0.02 * (tracks.xy - [320, 240])
    assert not contradicted(fitted(Tracks(tracks.frame, tracks.track, xy, (640, 480)), path),
                            problem)
    # all that this view sees
    whole = (tracks.frame == 4)[:, None] * 0.02 * (tracks.xy - [320, 240])
    assert contradicted(fitted(Tracks(tracks.frame, tracks.track, tracks.xy + whole, (640, 480)),
                               path), problem)


@pytest.mark.long
def test_long_tracks_of_a_thing_that_leads_do_not_lead_astray():
    rng = np.random.default_rng(12)
    tracks = world(rng, moving=45)
    # the scene passes by: only the thing is seen for long
    first = rng.integers(0, VIEWS - 3, tracks.track.max() + 1)[tracks.track]
    tracks = tracks.select((tracks.track >= 105) | (
        (tracks.frame >= first) & (tracks.frame < first + 4))).with_at_least(3)
    result = calibrate(tracks, motion='general', facts=FACTS)
    assert result and np.abs(off_by(result)).max() < 4
