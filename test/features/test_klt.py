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
"""Corners followed through a rendered drive, compared with where they must appear."""

import numpy as np
import pytest
from selfcal_ros.features.klt import corners, followed_share, KltTracker
from selfcal_ros.values.tracks import Tracks
from test_support.feature_scenes import drive, Room, transfer_errors


@pytest.fixture(scope='module')
def video():
    """Return the room, its cameras and images."""
    room, cameras = Room(), drive(16)
    return room, cameras, [room.image(camera) for camera in cameras]


@pytest.fixture(scope='module')
def followed(video):
    """Return what the tracker says of every image."""
    tracker = KltTracker(most=400)
    return [tracker.add(image) for image in video[2]]


@pytest.mark.long
def test_positions_are_exact_and_do_not_drift(video, followed):
    room, cameras, _ = video
    tracks = Tracks(np.repeat(np.arange(len(followed)), [len(ids) for ids, _ in followed]),
                    np.concatenate([ids for ids, _ in followed]),
                    np.concatenate([xy for _, xy in followed]))
    error, age = transfer_errors(room, cameras, tracks)
    young, old = error[age <= 3], error[age >= 12]
    assert len(old) > 100
    assert np.median(young) < 0.08 and np.median(old) < 0.1
    assert np.mean(error > 1.0) < 0.01
    assert np.median(old) < 1.5 * np.median(young) + 0.02


def test_ids_are_ascending_unique_and_never_used_twice(followed):
    seen, before = set(), set()
    for ids, xy in followed:
        assert xy.shape == (len(ids), 2) and xy.dtype == np.float64
        assert (np.diff(ids) > 0).all()
        now = set(ids.tolist())
        assert not (now - before) & seen
        seen |= now
        before = now


def test_points_cover_the_image_and_are_replenished(followed):
    for ids, xy in followed:
        assert len(ids) > 200
        cells = np.unique((xy // [100, 100]).astype(int), axis=0)
        assert len(cells) == 12


def test_fewer_points_are_followed_from_the_image_on_where_fewer_are_asked_for(video):
    tracker = KltTracker(most=400)
    many, first = tracker.add(video[2][0])
    tracker.add(video[2][1])
    tracker.most = 60
    ids, xy = tracker.add(video[2][2])
    assert len(many) > 200 and 30 < len(ids) <= 80
    # those that stay are the same points, and cover the image
    assert np.isin(ids, many).mean() > 0.8 and (np.diff(ids) > 0).all()
    assert len(np.unique((xy // [100, 100]).astype(int), axis=0)) == 12
    further, _ = tracker.add(video[2][3])
    assert np.isin(ids, further).mean() > 0.7


@pytest.mark.long
def test_corners_leave_occupied_cells_alone(video):
    image = video[2][0]
    first = corners(image, 20)
    again = corners(image, 20, first)
    assert len(first) > 150
    assert len(again) == 0
    assert (first == np.round(first)).all()


def test_a_blank_image_loses_all_and_the_tracker_recovers(video):
    tracker = KltTracker(most=200)
    first, _ = tracker.add(video[2][0])
    nothing, xy = tracker.add(np.full_like(video[2][0], 70))
    assert len(nothing) == 0 and xy.shape == (0, 2)
    again, _ = tracker.add(video[2][0])
    assert len(again) == len(first) and again.min() > first.max()


def test_a_change_of_size_starts_anew(video):
    tracker = KltTracker(most=200)
    first, _ = tracker.add(video[2][0])
    second, _ = tracker.add(np.ascontiguousarray(video[2][1][:200, :300]))
    assert len(second) and second.min() > first.max()


def test_followed_share_tells_video_from_photographs(video):
    room, _, images = video
    share, step = followed_share(images[0], images[1])
    assert share > 0.85 and 1 < step < 12
    assert followed_share(images[0], np.ascontiguousarray(images[0][::-1, ::-1]))[0] < 0.3
