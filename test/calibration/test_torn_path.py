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
"""Paths in two parts of different scale: told by the tracks that pass between, and mended."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import CameraFacts
from selfcal_ros.calibration.bundle.depths import share_behind
from selfcal_ros.calibration.bundle.motion import NEARLY_PLANAR
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, with_all_points
from selfcal_ros.calibration.estimators.model_selection import first_fit
from selfcal_ros.calibration.estimators.motion_problem import problem_of
from selfcal_ros.calibration.estimators.torn_path import (continued, is_torn, mended,
                                                          passing_shares, sound_stretches,
                                                          torn_findings)
from selfcal_ros.calibration.initialisation.multi_start import starts
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.synthetic.special_scenes import drive

VIEWS, TORN_AT, SMALLER = 16, 8, 0.2
#: Of the tracks that pass the view where it tears; what begins or ends there tells no scale.
PASSING = 10


@pytest.fixture(scope='module')
def scene():
    """Return a drive, what is to be explained of it, and a good start."""
    sequence = drive(np.random.default_rng(8), 0.1, VIEWS, 1200, track_length=5)
    tracks = sequence.tracks
    before, after = (set(tracks.track[mask].tolist()) for mask in (
        tracks.frame < TORN_AT, tracks.frame > TORN_AT))
    cut = np.isin(tracks.track, sorted(before & after)[PASSING:]) & (tracks.frame > TORN_AT)
    graph = build_view_graph(tracks.select(~cut), np.random.default_rng(0))
    problem = replace(problem_of(graph, (640, 480), CameraFacts(aspect_ratio=1.0, skew=0.0)),
                      motion=NEARLY_PLANAR)
    (start, _), = starts(problem, iter([sequence.camera]))
    return sequence, problem, start


def unevenness(path, sequence):
    """Largest over smallest ratio of an estimated step to the true one."""
    found, true = (np.linalg.norm(np.diff(centres, axis=0), axis=1) for centres in (
        path.centres(), -np.einsum('vji,vj->vi', sequence.cam_from_world[:, :, :3],
                                   sequence.cam_from_world[:, :, 3])))
    return (found / true).max() / (found / true).min()


def test_a_path_that_falls_in_two_is_told_and_mended(scene):
    sequence, problem, start = scene
    centres = start.path.centres()
    at = centres[TORN_AT].copy()
    centres[TORN_AT:] = at + SMALLER * (centres[TORN_AT:] - at)
    path = start.path.placed_at(centres)
    torn = with_all_points(replace(start, path=path), problem.observations)
    fit = first_fit(problem, problem.observations, torn)
    # nothing in the residuals shows it: the tracks that contradict it are outliers
    assert unevenness(fit.state.path, sequence) > 3 and fit.bundle.sigma_px < 0.15
    shares = passing_shares(problem.observations, fit.observations, VIEWS)
    assert np.nanargmin(shares) == TORN_AT and is_torn(
        problem.observations, fit.observations, VIEWS)
    whole = mended(fit, problem.observations, problem)
    assert unevenness(whole.state.path, sequence) < 1.02
    assert passing_shares(problem.observations, whole.observations, VIEWS)[TORN_AT] > 0.8


def test_a_part_that_is_inside_out_is_mended(scene):
    """Scales of parts are not sure to have one sign: points of one part are behind its views."""
    sequence, problem, start = scene
    seen = problem.observations
    first, last = (np.array([one(seen.view[seen.point == k]) for k in range(len(seen.track))])
                   for one in (min, max))
    apart = ~((first < TORN_AT) & (last > TORN_AT))
    tried, _ = seen.select(apart[seen.point])
    state = with_all_points(start, tried)
    centres, points = state.path.centres(), state.points[:, :3] / state.points[:, 3:]
    at, late = centres[TORN_AT].copy(), first[apart] >= TORN_AT
    centres[TORN_AT:] = at - SMALLER * (centres[TORN_AT:] - at)
    points[late] = at - SMALLER * (points[late] - at)
    turned = np.column_stack([points, np.ones(len(points))])
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    fit = first_fit(problem, tried, replace(state, path=state.path.placed_at(centres),
                                            points=turned))
    assert fit.bundle.sigma_px < 0.15 and share_behind(fit) > 0.2
    # no track is left to tell
    assert not is_torn(tried, fit.observations, VIEWS)
    whole = mended(fit, tried, problem)
    assert share_behind(whole) == 0 and whole.bundle.sigma_px < 0.15


def without_a_view(fit, tried, view):
    """Reject most of what a view shows, as if it were where nothing fits."""
    found = fit.observations
    kept, points = found.select((found.view != view) | (found.point % 5 == 0))
    bundle = bundle_of(kept, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)
    return replace(fit, bundle=bundle, observations=kept,
                   outliers=len(tried.view) - len(kept.view),
                   state=replace(fit.state, points=fit.state.points[points]))


def test_a_view_that_is_where_nothing_fits_is_placed_anew(scene):
    """The rest of the path is sound, but the view keeps what agrees by chance."""
    sequence, problem, start = scene
    tried = problem.observations
    sound = first_fit(problem, tried, with_all_points(start, tried))
    fit = without_a_view(sound, tried, 5)
    centres = fit.state.path.centres()
    centres[5] += [0.8, 0.3, -0.6]
    fit = replace(fit, state=replace(fit.state, path=fit.state.path.placed_at(centres)))
    assert not is_torn(tried, fit.observations, VIEWS)
    assert unevenness(fit.state.path, sequence) > 2

    whole = continued(fit, tried, problem)

    assert unevenness(whole.state.path, sequence) < 1.02
    assert whole.outliers < 0.01 * len(tried.view)


def test_stretches_are_those_between_weak_views(scene):
    _, problem, start = scene
    tried = problem.observations
    fit = first_fit(problem, tried, with_all_points(start, tried))
    assert sound_stretches(fit, tried) == []

    (first, last), (begin, end) = sound_stretches(without_a_view(fit, tried, 5), tried)
    assert last == VIEWS - 1 and begin == 0 and end < 5 < first < 8


@pytest.mark.parametrize('offset', [2**40, -300])
def test_tracks_may_have_any_numbers(scene, offset):
    # as many numbers as the largest were kept a view: a terabyte where they are hashes
    _, problem, start = scene
    kept, _ = problem.observations.select(np.arange(len(problem.observations.view)) % 7 > 0)
    far, fewer = (replace(one, track=one.track + offset) for one in (problem.observations, kept))

    np.testing.assert_equal(passing_shares(far, fewer, VIEWS),
                            passing_shares(problem.observations, kept, VIEWS))


def test_a_path_that_holds_together_is_left_alone(scene):
    sequence, problem, start = scene
    fit = first_fit(problem, problem.observations, with_all_points(start, problem.observations))
    assert mended(fit, problem.observations, problem) is fit
    shares = passing_shares(problem.observations, fit.observations, VIEWS)
    assert np.isnan(shares[[0, -1]]).all() and shares[1:-1].min() > 0.8


def test_what_stays_torn_is_said(scene):
    _, problem, _ = scene
    tried = problem.observations
    frames = np.arange(VIEWS) * 3
    assert torn_findings(tried, tried, frames) == ()
    # of each track that passes a view all is lost beyond it
    at = 4
    kept = tried.select(~(np.isin(tried.point, np.flatnonzero(
        np.bincount(tried.point[tried.view < at], minlength=len(tried.track)))) & (
            tried.view > at)))[0]
    found, = torn_findings(tried, kept, frames)
    assert found.kind == 'path_torn' and found.values['frame'] == 12
    assert found.values['kept_percent'] == 0
