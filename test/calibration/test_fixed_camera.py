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
"""A camera that is bolted to a bench, before a wall and something that turns."""

from dataclasses import replace

import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.synthetic.special_scenes import drive
from selfcal_ros.values.still_tracks import find_still_tracks, TrackExtents
from selfcal_ros.values.tracks import Tracks

SIZE, FOCAL, CENTRE = (640, 480), 620.0, (328.0, 235.0)
SQUARE = {'aspect_ratio': 1.0, 'skew': 0.0, 'distortion': 'none'}
#: Tracks of the wall begin here.
WALL = 10_000


def _project(places):
    """Pixels of a camera that looks down on the origin by 30 degrees, from 0.7 m away."""
    down = np.radians(30.0)
    forward = np.array([np.cos(down), 0.0, -np.sin(down)])
    right = np.array([0.0, -1.0, 0.0])
    seen = (places + 0.7 * forward) @ np.stack([right, np.cross(forward, right), forward]).T
    return FOCAL * seen[..., :2] / seen[..., 2:] + CENTRE


def _tracks(views=16, step_deg=9.0, points=60, wall=0, height_m=0.0, seed=0, life=10):
    """Return points of a disc that turns, and of a wall behind it, with 0.2 px of noise."""
    rng = np.random.default_rng(seed)
    count = points * views // life + points
    angle, radius = rng.uniform(0, 2 * np.pi, count), 0.2 * np.sqrt(rng.random(count))
    height = height_m * rng.random(count)
    turned = angle + np.radians(step_deg) * np.arange(views)[:, None]
    disc = _project(np.stack([radius * np.cos(turned), radius * np.sin(turned),
                              np.broadcast_to(height, turned.shape)], axis=-1))
    born = rng.integers(1 - life, views, count)
    view, track = np.nonzero((np.arange(views)[:, None] >= born)
                             & (np.arange(views)[:, None] < born + life))
    xy = [disc[view, track], np.tile(rng.uniform(5, 475, (wall, 2)) * [4 / 3, 1], (views, 1))]
    frame = np.concatenate([view, np.repeat(np.arange(views), wall)])
    names = np.concatenate([track, np.tile(WALL + np.arange(wall), views)])
    xy = np.concatenate(xy)
    return Tracks(frame, names, xy + rng.normal(0, 0.2, xy.shape), SIZE)


@pytest.mark.parametrize('step_deg', [1.0, 4.5])
def test_a_wall_with_most_of_the_points_is_found_and_the_disc_stays(step_deg):
    tracks = _tracks(40, step_deg, wall=540, life=16)
    still = find_still_tracks(tracks)
    assert still is not None and still.fixed_camera and 0.88 < still.share < 0.95
    assert (still.track >= WALL).sum() == 540
    assert (still.track < WALL).sum() < 0.1 * len(np.unique(tracks.track[tracks.track < WALL]))


def test_a_body_in_view_is_set_aside_and_the_camera_not_taken_as_fixed():
    rng = np.random.default_rng(3)
    body = np.tile(rng.uniform([5, 380], [635, 475], (60, 2)), (16, 1))
    scene = _tracks(points=200)
    tracks = Tracks(np.concatenate([scene.frame, np.repeat(np.arange(16), 60)]),
                    np.concatenate([scene.track, np.tile(WALL + np.arange(60), 16)]),
                    np.concatenate([scene.xy, body + rng.normal(0, 0.2, body.shape)]), SIZE)
    still = find_still_tracks(tracks)
    assert still is not None and not still.fixed_camera
    assert set(still.track[still.track >= WALL].tolist()) == set(range(WALL, WALL + 60))


def test_nothing_is_set_aside_where_the_camera_moves():
    rng = np.random.default_rng(4)
    place = rng.uniform([0, 0], SIZE, (300, 2))
    # of a scene at all distances, or half of it far away: seen by a camera that also turns, or
    # that stands for a while where people pass, or that never moves
    depth = 1 / rng.uniform(0.02, 1.0, (300, 1))
    far = np.where(np.arange(300)[:, None] < 150, 1e4, depth)
    view = np.arange(20)[:, None, None]
    forward = place + 8 * view * (place - [320, 240]) / 320 / depth
    turning = place + 8 * view * np.array([1.0, 0.1]) / far + 12 * np.sin(0.3 * view) * [1, 0]
    standing = place + 8 * np.maximum(view - 12, 0) * [1.0, 0.2] / depth
    standing[:, :40] += view * [6.0, 0.0]
    for seen in (forward, turning, standing, np.broadcast_to(place, (20, 300, 2))):
        tracks = Tracks(np.repeat(np.arange(20), 300), np.tile(np.arange(300), 20),
                        seen.reshape(-1, 2) + rng.normal(0, 0.2, (6000, 2)), SIZE)
        assert find_still_tracks(tracks) is None


@pytest.mark.parametrize('at_home', [(0, 2), (0, 1, 2, 5, 6, 7)])
def test_nothing_stands_still_before_a_camera_that_comes_back(at_home):
    """Two of three views were alike: what they show was taken for still, and refused."""
    rng = np.random.default_rng(4)
    views, points = max(at_home) + 1, 110
    home = rng.uniform([300, 100], [600, 400], (points, 2))
    away = home - [300, 40] + rng.uniform(-30, 30, (points, 2))
    frame, track = np.divmod(np.arange(views * points), points)
    xy = np.where(np.isin(frame, at_home)[:, None], home[track], away[track])
    xy += rng.normal(0, 0.2, xy.shape)
    xy[::25] += rng.uniform(-40, 40, xy[::25].shape)
    tracks = Tracks(frame, track, xy, (640, 480))

    assert find_still_tracks(tracks) is None
    assert not TrackExtents.measured(tracks).nothing_moves


@pytest.mark.long
def test_a_flat_disc_calibrates_with_the_principal_point_and_is_named_without():
    tracks = _tracks(8, 18.0, 50, wall=100)
    result = calibrate(tracks, facts=CameraFacts(principal_point=CENTRE, **SQUARE))
    assert result and result.findings[0].kind == 'fixed_camera'
    assert abs(result.camera.K[0, 0] / FOCAL - 1) < 0.01
    assert abs(result.camera.K[0, 0] - FOCAL) < 3 * result.sigma['fx']
    assert len(result.labels.of('still in the image')) >= 100
    refused = calibrate(tracks, facts=CameraFacts(**SQUARE))
    assert not refused and refused.kind == 'flat_turntable'
    assert 'principal point' in refused.advice


def test_things_of_some_height_on_the_disc_need_no_other_start():
    result = calibrate(_tracks(wall=200, height_m=0.1),
                       facts=CameraFacts(principal_point=CENTRE, **SQUARE))
    assert result and result.motion == 'circular'
    assert abs(result.camera.K[0, 0] - FOCAL) < 3 * result.sigma['fx'] < 0.01 * 3 * FOCAL


def test_a_camera_that_sees_nothing_move_is_still_refused():
    tracks = _tracks(4, wall=60)
    still = tracks.select(tracks.track >= WALL)
    assert not calibrate(still, facts=CameraFacts(**SQUARE))


def test_images_that_all_show_the_same_are_refused_as_such():
    rng = np.random.default_rng(4)
    place = rng.uniform(20, 460, (80, 2))
    for noise_px in (0.0, 0.3):
        xy = np.tile(place, (5, 1)) + noise_px * rng.standard_normal((400, 2))
        tracks = Tracks(np.repeat(np.arange(5), 80), np.tile(np.arange(80), 5), xy, (640, 480))
        assert TrackExtents.measured(tracks).nothing_moves
        refused = calibrate(tracks)
        assert not refused and refused.kind == 'nothing_moves'
    # a vehicle that turns by a degree in all
    slow = drive(rng, 0.3, 12, 100, 12).tracks
    drift = slow.xy * 0.01 + place[slow.track % 80]
    assert not TrackExtents.measured(replace(slow, xy=drift)).nothing_moves
