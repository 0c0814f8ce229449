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
"""View graphs of wide lenses: the lens first, then which observations fit."""

import numpy as np
import pytest
from selfcal_ros.calibration.initialisation.view_graph import build_view_graph
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.division import DivisionModel
from selfcal_ros.geometry.lifted_homography import lifted_homography_cost
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.values.tracks import Tracks

SIZE = (640, 480)


def fisheye(degrees):
    """Return an equidistant camera with its circle about the image, 4 px off the centre."""
    focal = np.hypot(*SIZE) / 2 / np.deg2rad(degrees / 2)
    K = np.array([[focal, 0, 322.0], [0, focal, 236.0], [0, 0, 1]])
    return Camera(K, np.zeros(4), *SIZE, 'equidistant')


def walk(rng, camera, steps, turns, noise_px=0.2, outliers=0.2):
    """Tracks of a room seen on the way, and which observations are wrong."""
    frame, track, xy = [], [], []
    points = rng.normal(size=(700, 3))
    points *= rng.uniform(3, 8, (700, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    widest = 0.5 * np.hypot(*SIZE) / camera.K[0, 0]
    for k, (centre, turn) in enumerate(zip(np.cumsum(steps, axis=0), np.cumsum(turns, axis=0))):
        local = (points - centre) @ rotation_matrix(turn).T
        angle = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
        seen = camera.project(np.where((angle < widest)[:, None], local, np.nan))
        with np.errstate(invalid='ignore'):
            inside = np.flatnonzero((seen >= 0).all(axis=1) & (seen < SIZE).all(axis=1))
        frame.append(np.full(len(inside), k))
        track.append(inside)
        xy.append(seen[inside])
    frame, track, xy = (np.concatenate(part) for part in (frame, track, xy))
    wrong = rng.random(len(xy)) < outliers
    xy = xy + rng.normal(0, noise_px, xy.shape) + wrong[:, None] * rng.normal(0, 25, xy.shape)
    order = np.lexsort((frame, track))
    return Tracks(frame, track, xy, SIZE), wrong[order]


@pytest.mark.parametrize('degrees', [120, 150, 185])
def test_a_wide_lens_is_found_and_gross_errors_go(degrees):
    rng = np.random.default_rng(degrees)
    camera = fisheye(degrees)
    tracks, wrong = walk(rng, camera, rng.normal(0, 0.3, (6, 3)), rng.normal(0, 0.1, (6, 3)))
    graph = build_view_graph(tracks, rng)
    kept = np.isin(tracks.frame * 1000 + tracks.track,
                   graph.tracks.frame * 1000 + graph.tracks.track)
    square = (0.5 * np.hypot(639, 479) / camera.K[0, 0]) ** 2
    assert -0.42 * square < graph.division < -0.33 * square
    assert len(graph.frames) == 6
    # with what one lens about the image centre cannot express
    assert 0.17 < graph.noise_px < 0.3
    assert graph.parallax > 20
    assert np.mean(kept[wrong]) < 0.12
    assert np.mean(kept[~wrong]) > 0.85


def test_a_turning_wide_camera_has_no_parallax():
    rng = np.random.default_rng(1)
    tracks, _ = walk(rng, fisheye(150), np.zeros((6, 3)), rng.normal(0, 0.15, (6, 3)),
                     outliers=0.0)
    graph = build_view_graph(tracks, rng)
    # through straight lines it is 30
    assert graph.parallax < 2
    assert graph.division == pytest.approx(-0.33 * np.deg2rad(75) ** 2, rel=0.05)


def test_equal_images_make_no_pair():
    rng = np.random.default_rng(2)
    tracks, _ = walk(rng, fisheye(150), rng.normal(0, 0.3, (6, 3)), rng.normal(0, 0.1, (6, 3)),
                     outliers=0.1)
    first = tracks.in_frames([0])
    again = Tracks(np.append(tracks.frame, np.full(len(first), 6)),
                   np.append(tracks.track, first.track), np.vstack([tracks.xy, first.xy]), SIZE)
    graph = build_view_graph(again, rng)
    assert len(graph.frames) == 7
    assert (0, 6) not in {(pair.first, pair.second) for pair in graph.pairs}


def test_F_of_a_bent_lens_is_that_of_straightened_pixels():
    rng = np.random.default_rng(3)
    tracks, _ = walk(rng, fisheye(150), rng.normal(0, 0.3, (6, 3)), rng.normal(0, 0.1, (6, 3)))
    graph = build_view_graph(tracks, rng)
    pair = graph.pairs[0]
    a, b = (graph.lens.lifted(xy) @ np.linalg.inv(graph.lens.to_units).T
            for xy in (pair.xy_first, pair.xy_second))
    ahead = (a[:, 2] > 0.5) & (b[:, 2] > 0.5)
    a, b = (x[ahead] / x[ahead, 2:] for x in (a, b))
    line = a @ pair.F.T
    assert np.median(np.abs((line * b).sum(axis=1)) / np.hypot(line[:, 0], line[:, 1])) < 1


def test_a_homography_of_lifted_points_reaches_beyond_90_degrees():
    rng = np.random.default_rng(4)
    model = DivisionModel((-1.2,), SIZE)
    a = rng.uniform([0, 0], SIZE, (200, 2))
    b = model.pixels(model.lifted(a) @ rotation_matrix(np.array([0.1, 0.2, 0.3])).T)
    assert lifted_homography_cost(model, a, b) < 1e-6
    noisy = b + rng.normal(0, 0.5, b.shape)
    assert lifted_homography_cost(model, a, noisy) / 800 == pytest.approx(0.25, rel=0.35)
