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
"""Keyframes, static points and epipolar verification on exact point scenes."""

import numpy as np
import pytest
from selfcal_ros.features.selection import drop_static, KeyframeSelector, verify
from selfcal_ros.values.tracks import Tracks
from test_support.feature_scenes import drive, HEIGHT, Room, WIDTH


@pytest.fixture(scope='module')
def scene():
    """Return exact tracks of 300 points over 8 views with 0.1 px of noise."""
    rng = np.random.default_rng(8)
    room, cameras = Room(), drive(8, 0.15, 3.0)
    xy = rng.uniform([120, 20], [WIDTH - 20, HEIGHT - 20], (300, 2))
    rows = []
    for k, camera in enumerate(cameras):
        at = room.transfer(xy, cameras[0], camera)
        inside = ((at > 0) & (at < [WIDTH, HEIGHT])).all(axis=1)
        rows.append(np.column_stack([np.full(inside.sum(), k), np.flatnonzero(inside),
                                     at[inside] + rng.normal(0, 0.1, (inside.sum(), 2))]))
    rows = np.concatenate(rows)
    return Tracks(rows[:, 0], rows[:, 1], rows[:, 2:], (WIDTH, HEIGHT))


def _with(tracks, frame, track, xy):
    return Tracks(np.concatenate([tracks.frame, frame]), np.concatenate([tracks.track, track]),
                  np.concatenate([tracks.xy, xy]), tracks.image_size)


def test_dirt_is_dropped_and_the_scene_is_kept(scene):
    rng = np.random.default_rng(9)
    spots = rng.uniform(50, 250, (40, 2))
    frames = np.repeat(np.arange(8), 40)
    dirty = _with(scene, frames, np.tile(1000 + np.arange(40), 8),
                  np.tile(spots, (8, 1)) + rng.normal(0, 0.1, (320, 2)))
    clean, dropped = drop_static(dirty)
    assert dropped == 40
    assert set(clean.track.tolist()) == set(scene.track.tolist())


def test_a_static_majority_goes_too(scene):
    spots = np.random.default_rng(1).uniform(0, 300, (900, 2))
    turntable = _with(scene, np.repeat(np.arange(8), 900), np.tile(1000 + np.arange(900), 8),
                      np.tile(spots, (8, 1)))
    clean, dropped = drop_static(turntable)
    assert dropped == 900 and clean.track.max() < 1000


def test_nothing_is_static_while_the_robot_stands():
    xy = np.random.default_rng(2).uniform(0, 300, (100, 2))
    still = Tracks(np.repeat(np.arange(5), 100), np.tile(np.arange(100), 5), np.tile(xy, (5, 1)))
    clean, dropped = drop_static(still)
    assert dropped == 0 and len(clean) == 500


def test_a_far_scene_that_moves_less_than_the_near_one_stays():
    xy = np.random.default_rng(3).uniform(0, 300, (100, 2))
    speed = np.where(np.arange(100) < 50, 12.0, 0.8)
    frame = np.repeat(np.arange(6), 100)
    moving = np.tile(xy, (6, 1))
    moving[:, 0] += frame * np.tile(speed, 6)
    assert drop_static(Tracks(frame, np.tile(np.arange(100), 6), moving))[1] == 0


def test_verification_removes_jumps_and_keeps_good_points(scene):
    rng = np.random.default_rng(4)
    xy = scene.xy.copy()
    wrong = rng.choice(len(scene), 60, replace=False)
    xy[wrong] += rng.choice([-1, 1], (60, 2)) * rng.uniform(10, 30, (60, 2))
    found = verify(Tracks(scene.frame, scene.track, xy, scene.image_size))
    verified, removed = found.tracks, found.removed
    assert removed >= 45
    left = {(int(f), tuple(p)) for f, p in zip(verified.frame, verified.xy.round(6))}
    bad_left = sum((int(scene.frame[k]), tuple(xy[k].round(6))) in left for k in wrong)
    assert bad_left < 15
    assert len(verified) > 0.93 * (len(scene) - 60)


def test_a_track_that_slips_to_another_point_is_cut(scene):
    count = np.bincount(scene.track)
    victim, donor = np.flatnonzero(count == count.max())[[0, -1]]
    xy = scene.xy.copy()
    late = scene.frame >= 4
    xy[late & (scene.track == victim)] = scene.xy[late & (scene.track == donor)] + [0.0, 0.05]
    whole = Tracks(scene.frame, scene.track, xy, scene.image_size)
    verified = verify(whole).tracks
    kept = verified.frame[verified.track == victim]
    assert not ((kept < 4).any() and (kept >= 4).any())
    # numbers that are taken, as by another camera's tracks, are left alone
    beyond = verify(whole, fresh=5000).tracks.track
    assert beyond.max() >= 5000 and set(beyond[beyond < 5000]) <= set(scene.track)


def test_keyframes_follow_parallax_and_loss():
    selector = KeyframeSelector(10.0, 0.4)
    ids, xy = np.arange(50), np.random.default_rng(0).uniform(0, 300, (50, 2))
    assert not KeyframeSelector(10.0).offer(ids[:0], xy[:0])
    assert selector.offer(ids, xy)
    assert not selector.offer(ids, xy + [6.0, 0])
    assert selector.offer(ids, xy + [11.0, 0])
    assert not selector.offer(ids[:35], xy[:35] + [12.0, 0])
    assert selector.offer(ids[:25], xy[:25] + [12.0, 0])
