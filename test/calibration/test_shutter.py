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
"""Rows that are read one after the other: derivatives, truth recovered, and global left alone."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.calibration.bundle.clock import Clock, difference_weights
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.neighbour_motion import motion_from_neighbours
from selfcal_ros.calibration.bundle.motion import GENERAL
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import priors_from_facts
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, RobustFit
from selfcal_ros.calibration.bundle.shutter import local_motion, row_shifts
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.model_selection import ModelDecision
from selfcal_ros.calibration.estimators.shutter_choice import clock_of, ShutterDecision
from selfcal_ros.calibration.row_readout import RowReadout
from selfcal_ros.cli.result_text import result_text
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.synthetic.rolling_scenes import CAMERA, drive, hand, record
from selfcal_ros.values.neighbours import Film, SeenPoints
from selfcal_ros.values.tracks import Tracks

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0, distortion='radial2')


def recorded(readout_s, kind=drive, seed=0, views=13, length_s=4.0):
    """Half of a path, observed."""
    rng = np.random.default_rng(seed)
    return record(rng, kind(rng), readout_s, np.linspace(0, length_s, views), points=90)


def deviations(result, sequence):
    """Errors of fx, cx and cy in sigmas."""
    error = (result.camera.parameters - sequence.camera.parameters)[[0, 2, 3]]
    return error / [result.sigma[name] for name in ('fx', 'cx', 'cy')]


def test_derivatives_at_uneven_times_are_exact_for_polynomials():
    times = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 12))
    values = np.polynomial.Polynomial([3, -2, 0.5, 0.1, -0.02, 0.003, 1e-4])
    near, (first, second, third) = difference_weights(times)
    assert near.shape == (12, 7)
    sought = values(times)[near]
    np.testing.assert_allclose(np.sum(first * sought, axis=1), values.deriv()(times), rtol=1e-8)
    np.testing.assert_allclose(np.sum(second * sought, axis=1), values.deriv(2)(times), rtol=1e-6)
    np.testing.assert_allclose(np.sum(third * sought, axis=1), values.deriv(3)(times), rtol=1e-5)


def test_a_clock_that_was_set_meanwhile_leaves_both_sides_alone():
    # 54 years between two images: all others were at the same instant, and nothing was solved
    times = np.arange(24.0)
    near, (first, *_) = difference_weights(times + np.where(times < 12, 0, 1.7e9 / 0.1))
    sides = [k for k in range(24) if min(abs(k - 11.5), 11.5 - abs(k - 11.5) + 9) > 4]
    assert np.isfinite(first).all() and len(sides) > 10
    values = np.sin(0.2 * times)[near]
    np.testing.assert_allclose(np.sum(first * values, axis=1)[sides],
                               0.2 * np.cos(0.2 * times[sides]), atol=1e-5)


@pytest.fixture
def moving():
    """A state on a smooth path, with the pose that it has at any time."""
    rng = np.random.default_rng(3)
    pose, times = hand(rng), np.arange(12) * 0.1
    R, centre = pose(times)
    path = AxisPath.of_poses(np.eye(3), np.concatenate([R, -R @ centre[..., None]], axis=2))
    X = centre[5] + (rng.uniform(-1, 1, (30, 3)) + [0, 0, 4]) @ R[5]
    points = np.column_stack([X, np.ones(30)])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    view, point = np.tile(np.arange(12), 30), np.repeat(np.arange(30), 12)
    state = SceneState(Lens.of(CAMERA), path, points, line_delay=0.3)
    return state, PointBlocks(point, view), pose, times, X


def test_rows_are_displaced_by_the_motion_until_they_are_read(moving):
    state, blocks, pose, times, X = moving
    rng, clock = np.random.default_rng(4), Clock(times / 0.1, 480)
    xy = rng.uniform(0, 480, (len(blocks.view), 2))
    found = row_shifts(state, blocks, xy, clock)

    def seen(line_delay):
        R, centre = pose(times[blocks.view] + 0.1 * line_delay * clock.delays(xy))
        return state.camera().project(np.einsum('nij,nj->ni', R, X[blocks.point] - centre))

    np.testing.assert_allclose(found.shift, seen(0.3) - seen(0.0), atol=0.02)
    assert np.abs(found.shift).max() > 3.0
    ahead, behind = (row_shifts(replace(state, line_delay=0.3 + h), blocks, xy, clock).shift
                     for h in (1e-4, -1e-4))
    slope = (ahead - behind) / 2e-4
    np.testing.assert_allclose(found.slope, slope, atol=1e-5 * np.abs(slope).max())
    assert local_motion(state.path, clock.times).shape == (3, 12, 6)


@pytest.mark.long
@pytest.mark.parametrize('readout_ms, kind, motion', [(20, drive, 'planar'),
                                                      (-25, hand, 'general')])
def test_the_line_delay_is_found_with_the_camera(readout_ms, kind, motion):
    sequence = recorded(readout_ms * 1e-3, kind)
    result = calibrate(sequence.tracks, facts=SQUARE, motion=motion, start=CAMERA)
    shutter = result.shutter
    assert shutter.status == 'estimated' and np.sign(shutter.line_delay_s) == np.sign(readout_ms)
    assert abs(shutter.readout_s - sequence.readout_s) < 4 * 480 * shutter.sigma_s
    assert shutter.sigma_s < 0.02 * abs(sequence.line_delay_s)
    assert np.abs(deviations(result, sequence)).max() < 4
    assert 'rolling_shutter' in [finding.kind for finding in result.findings]


def shaking(rng):
    """Drive and shake by 0.05 degrees, too fast for the images to follow."""
    path, phase = drive(rng), rng.uniform(0, 2 * np.pi, (2, 3))

    def pose(time):
        R, centre = path(time)
        angle = 2 * np.pi * np.asarray(time, float)[..., None, None] * [[11.3], [17.9]] + phase
        return rotation_matrix(np.radians(0.05) * np.sin(angle).sum(axis=-2)) @ R, centre

    return pose


@pytest.mark.long
def test_the_sigma_of_the_line_delay_holds_what_shakes_between_images():
    # without the views' own errors the second was 4.1 sigma off, and a vehicle's 17
    scores = []
    for seed in range(2):
        sequence = recorded(0.02, shaking, seed, views=16)
        shutter = calibrate(sequence.tracks, facts=SQUARE, start=CAMERA).shutter
        scores.append((shutter.readout_s - sequence.readout_s) / (480 * shutter.sigma_s))
    assert np.abs(scores).max() < 4


@pytest.mark.long
@pytest.mark.parametrize('readout_ms, kind, motion', [(20, drive, 'planar'),
                                                      (-25, hand, 'general')])
def test_columns_of_an_image_that_was_turned_upright_are_found(readout_ms, kind, motion):
    sequence = recorded(readout_ms * 1e-3, kind)
    tracks = sequence.tracks
    # turned by 90 degrees: the former rows run from left to right
    xy = np.column_stack([tracks.xy[:, 1], 639 - tracks.xy[:, 0]])
    K = CAMERA.K
    upright = Camera([[K[1, 1], 0, K[1, 2]], [0, K[0, 0], 639 - K[0, 2]], [0, 0, 1]],
                     CAMERA.distortion, 480, 640)
    result = calibrate(replace(tracks, xy=xy, image_size=(480, 640)), facts=SQUARE, motion=motion,
                       start=upright)
    shutter = result.shutter
    assert (shutter.lines, shutter.rows) == ('columns', 480)
    assert abs(shutter.readout_s - sequence.readout_s) < 4 * 480 * shutter.sigma_s
    assert shutter.sigma_s < 0.02 * abs(sequence.line_delay_s)
    apart = result.camera.K[[0, 0, 1], [0, 2, 2]] - upright.K[[0, 0, 1], [0, 2, 2]]
    assert (np.abs(apart) < [4 * result.sigma[name] for name in ('fx', 'cx', 'cy')]).all()
    assert 'The columns are read' in result_text(result)


@pytest.mark.long
@pytest.mark.parametrize('readout_ms', [8, -33])
def test_a_camera_that_only_turns_is_read_in_rows_too(readout_ms):
    sequence = recorded(readout_ms * 1e-3, partial(hand, shift_m=0.0), views=14)
    result = calibrate(sequence.tracks, facts=SQUARE)
    blind = calibrate(sequence.tracks, facts=replace(SQUARE, shutter='global'), motion='rotation')
    shutter = result.shutter

    assert result.motion == 'rotation'
    assert abs(shutter.readout_s - sequence.readout_s) < 4 * 480 * shutter.sigma_s
    assert np.abs(deviations(result, sequence)).max() < 4
    # as if all rows were read at once, it is another camera or none
    assert not blind or abs(blind.camera.K[0, 0] - 520) > 4 * abs(result.camera.K[0, 0] - 520)


@pytest.mark.long
def test_a_stated_shutter_is_held_against_the_images():
    # it was not asked about: skew or things that move were blamed, or nothing was
    sequence = recorded(0.02)

    def under(**stated):
        return calibrate(sequence.tracks, facts=replace(SQUARE, **stated), motion='planar',
                         start=CAMERA)

    refused = under(shutter='global')
    assert (refused.kind, refused.values['fact']) == ('fact_contradicted', 'global shutter')
    prefers, = refused.values['preferred']
    assert prefers['stated'] == 0 and abs(prefers['value'] - 20) < 4 * prefers['sigma'] < 2
    assert 'readout in ms' in refused.reason
    # who knows better may say so
    kept = under(shutter='global', trusted=True)
    assert kept.shutter is None and 'fact_trusted' in [one.kind for one in kept.findings]
    wrong = under(line_delay_s=1.2 * sequence.line_delay_s)
    assert wrong.values['fact'] == 'line delay'
    assert abs(wrong.values['preferred'][0]['value'] - 1e6 * sequence.line_delay_s) < 2
    # with a sigma that allows for it, it is no contradiction
    allowed = under(line_delay_s=1.2 * sequence.line_delay_s,
                    line_delay_sigma_s=0.2 * sequence.line_delay_s)
    assert allowed and np.abs(deviations(allowed, sequence)).max() < 4
    assert 'line delay' not in [one.values.get('fact') for one in allowed.findings]


@pytest.mark.long
def test_a_global_shutter_of_views_far_apart_is_held_against_the_images():
    sequence = recorded(0.02, hand, views=11)
    refused = calibrate(sequence.tracks, facts=replace(SQUARE, shutter='global'),
                        motion='general', start=CAMERA)
    assert refused.values['fact'] == 'global shutter'
    assert 'prefer shutter = rolling in place of global' in refused.reason


def test_a_global_shutter_is_told_apart_and_a_stated_delay_is_held():
    sequence = recorded(0.0)
    result = calibrate(sequence.tracks, facts=SQUARE, motion='planar', start=CAMERA)
    assert result.shutter is None and np.abs(deviations(result, sequence)).max() < 4
    rolling = recorded(0.01)
    stated = replace(SQUARE, line_delay_s=rolling.line_delay_s)
    result = calibrate(rolling.tracks, facts=stated, motion='planar', start=CAMERA)
    assert result.shutter.status == 'held' and result.shutter.sigma_s == 0
    assert result.shutter.line_delay_s == pytest.approx(rolling.line_delay_s)
    assert np.abs(deviations(result, rolling)).max() < 4


def test_a_doubtful_line_delay_widens_a_path_by_what_it_would_do(moving):
    # it was multiplied by the variance inflation, which the shift holds, and rotations did not
    state, blocks, *_ = moving
    xy = CAMERA.project(np.column_stack([blocks.point, blocks.view, 100 + blocks.view]) * 0.1)
    observations = Observations(blocks.view, blocks.point, xy, np.arange(30))
    fit = RobustFit(bundle_of(observations, GENERAL, priors_from_facts(CameraFacts()), 1.0),
                    state, observations, 0)
    count = len(state.lens)
    model = ModelDecision(fit, SQUARE, False, (1.0, np.zeros((count, count))),
                          np.eye(count), True, 1.0)
    decision = ShutterDecision(fit, shift=np.arange(1.0, count + 1))
    added = decision.widened(model).covariance_of_choices(3.0) - 3 * np.eye(count)
    assert np.allclose(added, decision.covariance(count, fit.bundle.unknowns.free))
    assert added[0, 0] == 1 and added[0, 2] == 3


def test_a_line_delay_in_seconds_needs_stamps():
    sequence = recorded(0.01)
    tracks = replace(sequence.tracks, stamps_ns=None)
    with pytest.raises(ArgumentError, match='stamps'):
        calibrate(tracks, facts=replace(SQUARE, line_delay_s=1e-5))
    for wrong in ({'shutter': 'leaf'}, {'line_delay_s': 0.5}, {'line_delay_sigma_s': -1.0},
                  {'shutter': 'global', 'line_delay_s': 1e-5}):
        with pytest.raises(ArgumentError):
            CameraFacts(**wrong)


def test_a_stamp_that_repeats_leaves_the_views_a_frame_apart():
    tracks = recorded(0.01).tracks
    beside = np.broadcast_to([[[0.0, 0, -1 / 30], [0, 0, 1 / 30]]], (len(tracks), 2, 3))
    frames = tracks.frames
    stamps = {int(k): int(k) * 33_333_333 for k in frames}
    stamps[int(frames[3])] = stamps[int(frames[2])]
    clock = clock_of(replace(tracks, stamps_ns=stamps, neighbours=beside), frames, (640, 480),
                     CameraFacts())
    assert not clock.is_stamped
    np.testing.assert_array_equal(clock.times, frames - frames[0])


def test_what_is_said_of_the_shutter():
    stamped = RowReadout(2e-5, 1e-7, 'estimated', 0.288, 0.00144, 480)
    assert '9.600 ± 0.048 ms' in stamped.finding().sentence
    bare = RowReadout(None, None, 'estimated', 0.288, 0.00144, 480)
    assert '0.2880 ± 0.0014 intervals' in bare.finding().sentence and bare.readout_s is None
    held = RowReadout(2e-5, 0.0, 'held', 0.288, 0.0, 480)
    assert '20 µs' in held.finding().sentence


def test_the_images_before_and_after_tell_how_the_camera_moves(moving):
    state, blocks, pose, times, X = moving
    interval = 1 / 30

    def seen(time, rows):
        for _ in range(8):
            taken = time + 0.3 * interval * (rows - 239.5) / 480
            R, centre = pose(taken)
            xy = CAMERA.project(np.einsum('nij,nj->ni', R, X[blocks.point] - centre))
            rows = xy[:, 1]
        return xy

    instants = times[blocks.view]
    xy = seen(instants, np.full(len(instants), 239.5))
    beside = np.stack([np.column_stack([seen(instants + step * interval, xy[:, 1]),
                                        np.full(len(xy), step)]) for step in (-1, 1)], axis=1)
    beside[::7, 1] = np.nan
    clock = Clock(times / interval, 480, interval)
    speed, _, _ = motion_from_neighbours(state, blocks, xy, beside, clock,
                                         np.full((3, len(times), 6), np.nan))
    near = [pose(times + h)[0] for h in (-1e-4, 1e-4)]
    turn = rotation_vector(near[1] @ np.swapaxes(near[0], 1, 2)) / 2e-4 * interval
    centre = (pose(times + 1e-4)[1] - pose(times - 1e-4)[1]) / 2e-4 * interval
    # at the ends the third derivative is told from one side
    np.testing.assert_allclose(speed[:, :3], turn, atol=1e-2 * np.abs(turn).max())
    np.testing.assert_allclose(speed[2:-2, :3], turn[2:-2], atol=2e-4 * np.abs(turn).max())
    moved = np.einsum('vij,vj->vi', state.path.rotations(), centre)
    np.testing.assert_allclose(speed[:, 3:], moved, atol=2e-2 * np.abs(moved).max())
    # a view that nothing is asked of is a view nevertheless, the last one, too
    part = blocks.view < len(times) - 1
    fewer, _, _ = motion_from_neighbours(
        state, PointBlocks(blocks.point[part], blocks.view[part]), xy[part], beside[part], clock,
        np.zeros((3, len(times), 6)))
    assert fewer.shape == speed.shape and not fewer[-1].any()
    np.testing.assert_allclose(fewer[:-4], speed[:-4], atol=1e-3 * np.abs(speed).max())


@pytest.mark.long
def test_a_camera_that_swings_once_a_second_is_read_as_fast_as_it_is():
    # between the images beside a view it is 0.7 % slower than at the view
    rng = np.random.default_rng([2, 3])
    path = hand(rng, 3.0, turn_deg=16.0)
    sequence = record(rng, path, 0.02, np.arange(28) * 0.1 + 0.1, points=250, noise_px=0.05,
                      interval_s=1 / 30)
    result = calibrate(sequence.tracks, facts=SQUARE, motion='general', start=CAMERA)
    shutter = result.shutter

    assert 480 * shutter.sigma_s < 3e-5
    assert abs(shutter.readout_s - 0.02) < 4 * 480 * shutter.sigma_s
    assert np.abs(deviations(result, sequence)).max() < 4


def test_the_first_image_of_a_video_counts_near_its_middle_row():
    sequence = recorded(0.02)
    observed = Observations.of(sequence.tracks, sequence.tracks.frames)
    beside = np.zeros((len(observed.view), 2, 3))
    beside[observed.view == 0, 0] = np.nan
    timed = replace(observed, clock=Clock(np.arange(13.0), 480), neighbours=beside).surely_timed()
    rows = np.abs(timed.xy[:, 1] - 239.5)

    assert np.sum(timed.view == 0) < np.sum(observed.view == 0) / 2
    assert rows[timed.view == 0].max() < 120 < rows[timed.view == 12].max()
    assert np.sum(timed.view == 12) == np.sum(observed.view == 12)


def test_a_film_remembers_what_is_beside_the_images_that_are_kept():
    film, kept = Film(), []
    for k in range(4):
        film.add(SeenPoints(np.arange(k, k + 4), np.full((4, 2), float(k)), 10**8 * k))
        if k in (0, 2):
            kept.append(film.keep())
    first, second = (one.neighbours for one in kept)
    assert np.isnan(first[:, 0]).all() and np.isnan(first[0, 1]).all()
    np.testing.assert_allclose(first[1:, 1], [[1, 1, 0.1]] * 3)
    np.testing.assert_allclose(second[:3, 0], [[1, 1, -0.1]] * 3)
    np.testing.assert_allclose(second[1:, 1], [[3, 3, 0.1]] * 3)
    tracks = Tracks(np.zeros(4), [3, 2, 1, 0], np.zeros((4, 2)), neighbours=first)
    np.testing.assert_array_equal(tracks.neighbours, first[::-1])
    assert np.nanmax(tracks.unstamped(30.0).neighbours[:, :, 2]) == pytest.approx(3.0)
