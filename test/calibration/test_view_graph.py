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
"""Which observations the epipolar geometry keeps: the noise stays whole, gross errors go."""

import numpy as np
import pytest
from selfcal_ros.calibration.bundle.inliers import verified
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph, truncated_sigma
from selfcal_ros.synthetic import scenes, special_scenes
from selfcal_ros.synthetic.hard_scenes import HARD_SCENES
from selfcal_ros.values.tracks import Tracks


#: Points of sequence SI in general position on its two grids.
TEN = [0, 7, 13, 19, 21, 27, 30, 36, 43, 49]


@pytest.fixture
def rng():
    return np.random.default_rng(4)


@pytest.mark.parametrize('sigma', [0.2, 0.7, 1.2])
def test_sigma_of_a_cut_off_gaussian(rng, sigma):
    values = sigma * rng.standard_normal(200000)
    inside = values[np.abs(values) < 1.5]
    assert truncated_sigma(np.mean(inside ** 2), 1.5) == pytest.approx(sigma, rel=0.02)


def test_what_is_spread_evenly_has_no_sigma(rng):
    assert truncated_sigma(np.mean(rng.uniform(-1, 1, 10000) ** 2), 1.0) == float('inf')


@pytest.mark.long
@pytest.mark.parametrize('noise_px', [0.1, 0.3, 1.0])
@pytest.mark.parametrize('views', [3, 6])
def test_the_limit_does_not_cut_into_the_noise(rng, noise_px, views):
    rejected, noise = [], []
    for _ in range(3):
        graph = build_view_graph(scenes.sequence_si(rng, noise_px, views).tracks, rng)
        rejected.append(graph.rejected)
        noise.append(graph.noise_px)
    assert sum(rejected) <= 1
    assert np.mean(noise) == pytest.approx(noise_px, rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize('noise_px', [0.1, 1.0])
def test_gross_errors_go_with_what_they_leave_unverified(rng, noise_px):
    left, lost = 0, 0
    for _ in range(5):
        dirty = special_scenes.with_outliers(scenes.sequence_si(rng, noise_px), rng, 0.1)
        graph = build_view_graph(dirty.tracks, rng)
        bad = set(zip(dirty.tracks.frame[dirty.outliers], dirty.tracks.track[dirty.outliers]))
        kept = list(zip(graph.tracks.frame, graph.tracks.track))
        left += len(bad.intersection(kept))
        clean = np.bincount(dirty.tracks.track, dirty.outliers) == 0
        lost += 3 * int(clean.sum()) - sum(clean[track] for _, track in kept)
        assert abs(graph.rejected - len(bad)) <= 3
    assert left <= 3
    assert lost <= 6


def test_few_points_link_views_if_all_agree():
    sequence = HARD_SCENES['16 points'](np.random.default_rng([1, 5]))
    graph = build_view_graph(sequence.tracks, np.random.default_rng(0))
    wrong = sequence.tracks.xy + np.where(sequence.tracks.track % 5 == 0, 40, 0)[:, None] \
        * np.random.default_rng(1).standard_normal(sequence.tracks.xy.shape)
    dirty = build_view_graph(Tracks(sequence.tracks.frame, sequence.tracks.track, wrong,
                                    sequence.tracks.image_size), np.random.default_rng(0))

    assert len(graph.frames) >= 9
    # views that could not be linked contradict nobody
    assert graph.rejected == 0
    assert 3 <= len(dirty.frames) <= 5


def test_few_points_link_only_what_is_not_linked_otherwise(rng):
    """The last of seven views shares ten points with each, and so do the first and the third."""
    tracks = scenes.sequence_si(rng, 0.1, 7).tracks
    even, shared = tracks.track % 2 == 0, np.isin(tracks.track, TEN)
    kept = (tracks.frame != 6) | shared
    kept &= (tracks.frame != 0) | shared | even
    kept &= (tracks.frame != 2) | shared | ~even
    graph = build_view_graph(tracks.select(kept), rng)

    few = [(p.first, p.second) for p in graph.pairs if len(p.xy_first) < 12]
    assert len(graph.frames) == 7
    assert few and all(6 in pair for pair in few)


def test_pairs_without_a_geometry_contradict_nobody(rng):
    """Of the ten points that the last view shares, two are wrong: the view says nothing."""
    tracks = scenes.sequence_si(rng, 0.1, 7).tracks
    last = tracks.frame == 6
    xy = tracks.xy.copy()
    # one of them at least across the epipolar lines
    xy[last & (tracks.track == 13)] += [70, 0]
    xy[last & (tracks.track == 30)] += [0, 70]
    kept = ~last | np.isin(tracks.track, TEN)
    graph = build_view_graph(Tracks(tracks.frame, tracks.track, xy, tracks.image_size)
                             .select(kept), rng)

    assert graph.frames.tolist() == list(range(6))
    assert graph.rejected == 0


def test_two_views_left_of_more_are_not_trusted():
    point = np.array([0, 0, 0, 1, 1, 2, 2, 2, 2])
    keep = np.array([True, True, False, True, True, True, True, True, False])
    assert verified(point, keep).tolist() == [False] * 3 + [True] * 6
    assert not verified(np.array([0, 0]), np.array([True, False])).any()
    assert verified(np.zeros(0, int), np.zeros(0, bool)).shape == (0,)


def test_a_view_that_keeps_nothing_is_no_view(rng):
    # the last image shows three parts of the scene from three places; each neighbour sees
    # another part as it is, so that two of three contradict every point of that image
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    X = rng.uniform([-2, -1.5, 4], [2, 1.5, 8], (220, 3))
    third = np.repeat([-1, 0, 1, 2], [100, 40, 40, 40])
    centres = np.column_stack([0.25 * np.arange(10), rng.uniform(-0.3, 0.3, (10, 2))])

    def pixels(points, centre):
        x = (points - centre) @ K.T
        return x[:, :2] / x[:, 2:] + 0.2 * rng.standard_normal((len(x), 2))

    rows = []
    for frame in range(9):
        seen = (third < 0) | (frame >= 6)
        xy = pixels(X[seen], centres[frame])
        wrong = (third[seen] >= 0) & (third[seen] != frame - 6)
        xy[wrong] += rng.uniform(-40, 40, (wrong.sum(), 2))
        rows.append((frame, np.flatnonzero(seen), xy))
    for k in range(3):
        own = third == k
        rows.append((9, np.flatnonzero(own),
                     pixels(X[own], centres[9] + rng.uniform(-1.5, 1.5, 3))))
    tracks = Tracks(np.concatenate([np.full(len(track), frame) for frame, track, _ in rows]),
                    np.concatenate([track for _, track, _ in rows]),
                    np.concatenate([xy for *_, xy in rows]), (640, 480))
    graph = build_view_graph(tracks, rng)
    assert graph.frames.tolist() == list(range(9))
    assert np.isin(graph.frames, graph.tracks.frame).all()
    assert max(pair.second for pair in graph.pairs) == 8
