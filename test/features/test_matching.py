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
"""Wide-baseline matching against known geometry."""

import cv2
import numpy as np
import pytest
from selfcal_ros.features.epipolar import (choose_division, EpipolarImages, estimate_fundamental,
                                           sampson_distance)
from selfcal_ros.features import detection, matching
from selfcal_ros.features.detection import detect, Features
from selfcal_ros.features.likeness import (MIN_SIMILARITY, mutual_nearest, perhaps_alike,
                                           similarity)
from selfcal_ros.features.linking import link
from selfcal_ros.features.matching import ImagePairMatches, match_pairs, moving_part
from selfcal_ros.features.neighbours import agrees_with_neighbours, local_turns
from selfcal_ros.features.pairs import propose_pairs
from selfcal_ros.geometry.division import DivisionModel
from test_support.feature_scenes import chessboard, HEIGHT, pose, Room, true_fundamental, WIDTH

SIZE = (WIDTH, HEIGHT)
STRAIGHT = DivisionModel((0.0,), SIZE)


def test_keypoints_lie_on_the_centres_of_blobs():
    y, x = np.mgrid[:120, :160].astype(float)
    centres = np.array([[40.3, 50.6], [101.8, 61.1]])
    image = np.full(x.shape, 30.0)
    for cx, cy in centres:
        image += 180 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * 4.0 ** 2))
    found = detect(np.round(image).astype(np.uint8)).xy
    for centre in centres:
        assert np.linalg.norm(found - centre, axis=1).min() < 0.1


@pytest.mark.parametrize('largest', [2_500_000, 200_000])
def test_half_and_quarter_size_search_keep_the_coordinates(monkeypatch, largest):
    monkeypatch.setattr(detection, '_LARGEST_SEARCH_PIXELS', largest)
    y, x = np.mgrid[:1100, :1200].astype(float)
    image = 30 + 180 * np.exp(-((x - 600.4) ** 2 + (y - 500.7) ** 2) / (2 * 7.0 ** 2))
    found = detect(np.round(image).astype(np.uint8)).xy
    # a pixel of the search may be four of the image
    assert np.linalg.norm(found - [600.4, 500.7], axis=1).min() < 0.15 * (
        1 if largest > 200_000 else 2)


@pytest.mark.parametrize('ahead, wrong', [(None, 0.002), (chessboard(), 0.02)])
def test_matches_obey_the_true_geometry_even_with_a_chessboard_in_view(ahead, wrong):
    room = Room(ahead=ahead)
    cameras = [pose(0, 0, 0, 10), pose(0.4, 0.3, 8, 10)]
    features = [detect(room.image(camera)) for camera in cameras]
    (pair,), _, static = match_pairs(features, [(0, 1)], SIZE)
    a, b = features[0].xy[pair.a], features[1].xy[pair.b]
    assert len(a) > 200 and static == 0
    expected = room.transfer(a, *cameras)
    assert np.mean(np.linalg.norm(b - expected, axis=1) > 3) < wrong
    residual = sampson_distance(true_fundamental(*cameras), a, b)
    assert 1.4826 * np.median(np.abs(residual)) < 0.35


def test_distorted_matches_lie_on_curves():
    rng = np.random.default_rng(4)
    points = rng.uniform([-3, -2, 3], [3, 2, 9], (600, 3))
    pairs = []
    for turn in (0.05, 0.15):
        R = cv2.Rodrigues(np.array([0.02, turn, 0.0]))[0]
        views = []
        for moved in (points, points @ R.T + [0.5, 0.0, 0.3]):
            n = moved[:, :2] / moved[:, 2:]
            r2 = (n ** 2).sum(axis=1, keepdims=True)
            views.append(n * (1 - 0.25 * r2 + 0.05 * r2 ** 2) * 260 + [200, 150])
        inside = np.all([(v > 0).all(axis=1) & (v < SIZE).all(axis=1) for v in views], axis=0)
        pairs.append(tuple(v[inside] + rng.normal(0, 0.1, v[inside].shape) for v in views))
    epipolar = EpipolarImages(choose_division(pairs, SIZE))
    assert epipolar.model.coefficients[0] < -0.05
    for a, b in pairs:
        plain = sampson_distance(estimate_fundamental(a, b), a, b)
        bent = epipolar.distance(epipolar.fit(a, b), a, b)
        assert np.mean(np.abs(bent) < 0.75) > 0.97
        assert np.std(bent) < np.std(plain)


def test_sampson_distance_has_the_sigma_of_the_noise():
    rng = np.random.default_rng(6)
    F = true_fundamental(pose(), pose(0.5, 0.1, 5))
    room = Room()
    a = rng.uniform([20, 20], [380, 280], (3000, 2))
    b = room.transfer(a, pose(), pose(0.5, 0.1, 5))
    assert np.abs(sampson_distance(F, a, b)).max() < 1e-6
    noisy = [v + rng.normal(0, 0.5, v.shape) for v in (a, b)]
    assert abs(sampson_distance(F, *noisy).std() - 0.5) < 0.03


def test_static_background_does_not_vote():
    a = np.random.default_rng(0).uniform(0, 300, (60, 2))
    b = a.copy()
    b[:30] += 9
    assert moving_part(a, b).sum() == 30
    assert moving_part(a, a + 0.2).all()


def _features(count):
    none = np.empty(0, int)
    return Features(np.zeros((count, 2)), np.ones(count), np.zeros((count, 128), np.uint8),
                    none, (none, none, np.empty(0, np.float32)))


def test_link_joins_pairs_and_drops_contradictions():
    features = [_features(5)] * 3
    F = np.eye(3)
    pairs = [ImagePairMatches(0, 1, np.array([0, 1, 2]), np.array([0, 1, 2]), F, STRAIGHT),
             ImagePairMatches(1, 2, np.array([0, 1, 2]), np.array([0, 1, 2]), F, STRAIGHT),
             # place 1 of image 0 is said to be place 3 of image 2, which it is not
             ImagePairMatches(0, 2, np.array([0, 1, 2]), np.array([0, 3, 2]), F, STRAIGHT)]
    image, place, track, dropped = link(features, pairs)
    assert dropped == 0
    rows = {tuple(sorted(zip(image[track == k].tolist(), place[track == k].tolist())))
            for k in np.unique(track)}
    assert ((0, 0), (1, 0), (2, 0)) in rows and ((0, 2), (1, 2), (2, 2)) in rows
    for row in rows:
        assert len({i for i, _ in row}) == len(row)


@pytest.mark.parametrize('degrees', [0, 40, 110, 180])
def test_neighbours_agree_however_the_camera_is_rolled(degrees):
    rng = np.random.default_rng(8)
    a = rng.uniform([0, 0], SIZE, (120, 2))
    turn = cv2.Rodrigues(np.array([0, 0, np.deg2rad(degrees)]))[0][:2, :2]
    b = a @ turn.T + rng.normal(0, 1, a.shape)
    b[:20] = rng.uniform([0, 0], SIZE, (20, 2))
    agrees = agrees_with_neighbours(a, b)
    assert agrees[20:].all() and agrees[:20].mean() < 0.3

    image, reference = np.repeat([0, 1], 120), np.tile(np.arange(120), 2)
    turns = local_turns(image, np.vstack([a, b]), reference)
    assert np.array_equal(turns[:120], np.tile(np.eye(2), (120, 1, 1)))
    assert np.median(np.abs(turns[120:] - turn)) < 0.05


def test_images_without_features_match_nothing():
    blank = detect(np.full((120, 160), 80, np.uint8))
    assert len(blank.xy) == 0
    assert propose_pairs([blank] * 12)
    matches, bend, _ = match_pairs([blank] * 3, propose_pairs([blank] * 3), (160, 120))
    assert matches == [] and bend.straight
    assert link([blank] * 3, matches)[0].size == 0


def test_matches_that_contradict_nothing_are_linked_as_they_are():
    image = np.random.default_rng(0).integers(0, 255, (120, 160)).astype(np.uint8)
    features = [detect(cv2.GaussianBlur(image, (0, 0), 2))] * 2
    count = len(features[0].xy)
    assert count > 20
    every = np.arange(count)
    pair = ImagePairMatches(0, 1, every, every, np.eye(3), STRAIGHT)
    at, place, track, dropped = link(features, [pair])
    assert dropped == 0 and len(at) == 2 * count and len(np.unique(track)) == count
    assert (place[at == 0] == place[at == 1]).all() and (track[at == 0] == track[at == 1]).all()


def test_relatives_are_found_among_many_photographs_in_no_order():
    rng = np.random.default_rng(2)
    none = np.empty(0, int)
    scenes = rng.integers(0, 256, (35, 60, 128))
    photographs = [Features(np.zeros((60, 2)), np.ones(60),
                            np.clip(scenes[k % 35] + rng.normal(0, 8, (60, 128)), 0,
                                    255).astype(np.uint8),
                            none, (none, none, np.empty(0, np.float32))) for k in range(70)]
    pairs = propose_pairs(photographs, neighbours=1)
    assert {(k, k + 35) for k in range(35)} <= set(pairs)
    assert len(pairs) < 70 * 4


def test_blocks_of_curves_find_what_every_pair_of_places_gives():
    room, cameras = Room(), [pose(0, 0, 0, 10), pose(0.4, 0.3, 8, 10)]
    features = [detect(room.image(camera)) for camera in cameras]
    first, second = features
    F, band_px = true_fundamental(*cameras), 2.0
    epipolar = EpipolarImages(choose_division([], SIZE))
    found = matching._Gallery(features).along_curves((0, 1), epipolar, F, band_px)
    look, other = first.described(), second.described()
    alike = similarity(look, np.arange(look.count), other)[:, np.argsort(other.order)]
    a, b = np.nonzero(alike > MIN_SIMILARITY)
    near = np.abs(epipolar.distance(F, first.xy[a], second.xy[b])) < band_px
    near &= np.abs(np.log2(first.size_px[a] / second.size_px[b])) < 1
    assert near.sum() > 500
    assert set(zip(found[0], found[1])) == set(zip(a[near], b[near]))
    assert found[2] == pytest.approx(alike[found[0], found[1]], abs=1e-5)
    # mutual neighbours and their runners-up, as the whole table has them
    a, b, best, runner_up = mutual_nearest(look, other)
    assert len(a) > 500 and (best > MIN_SIMILARITY).all()
    assert np.array_equal(alike[a].argmax(axis=1), b)
    assert np.array_equal(alike[:, b].argmax(axis=0), a)
    assert best == pytest.approx(alike[a, b], abs=1e-5)
    alike[a, b] = -1
    assert runner_up == pytest.approx(np.maximum(alike[a].max(axis=1), alike[:, b].max(axis=0)),
                                      abs=1e-5)
    # what sketches let pass is little more than what is alike, and holds all of it
    rows, columns = perhaps_alike(look.sketch, other.sketch)
    assert set(zip(*np.nonzero(look.vectors @ other.vectors.T > MIN_SIMILARITY))) <= set(
        zip(rows, columns))
    assert len(rows) < 0.05 * len(look.vectors) * len(other.vectors)
