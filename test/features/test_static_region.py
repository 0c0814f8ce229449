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
"""The body of the robot, which shakes in the image, is dropped as a region."""

import cv2
import numpy as np
import pytest
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.features.selection import drop_static, KeyframeSelector
from selfcal_ros.features.static_region import drop_static_regions
from selfcal_ros.values.tracks import Tracks
from test_support.feature_scenes import drive, HEIGHT, Room, transfer_errors, WIDTH

VIEWS = 8
#: Rows of the image from which on there is the robot.
BODY_TOP = 200


@pytest.fixture(scope='module')
def room():
    """Return the room; painting it takes a while."""
    return Room()


def _scene(room, far=False):
    """Return tracks of the room; or of something far, which drifts slowly."""
    rng = np.random.default_rng(8)
    cameras = drive(VIEWS, 0.15, 3.0)
    xy = rng.uniform([20, 20], [WIDTH - 20, HEIGHT - 20], (500, 2))
    rows = []
    for k, camera in enumerate(cameras):
        at = room.transfer(xy, cameras[0], camera)
        if far:
            at[xy[:, 1] < 90] = xy[xy[:, 1] < 90] + [0.6 * k, 0]
        inside = ((at > 0) & (at < [WIDTH, HEIGHT])).all(axis=1)
        rows.append(np.column_stack([np.full(inside.sum(), k), np.flatnonzero(inside),
                                     at[inside] + rng.normal(0, 0.1, (inside.sum(), 2))]))
    rows = np.concatenate(rows)
    return Tracks(rows[:, 0], rows[:, 1], rows[:, 2:], (WIDTH, HEIGHT))


def _with_body(scene, shake_px):
    """Hide the lower part behind a body that shakes, some of whose points slide."""
    rng = np.random.default_rng(1)
    seen = scene.select(scene.xy[:, 1] < BODY_TOP)
    place = rng.uniform([5, BODY_TOP + 5], [WIDTH - 5, HEIGHT - 5], (200, 2))
    xy = np.stack([place + rng.normal(0, shake_px, 2) for _ in range(VIEWS)])
    xy[:, :20] += np.arange(VIEWS)[:, None, None] * [2.0, 0.5]
    return Tracks(np.concatenate([seen.frame, np.repeat(np.arange(VIEWS), 200)]),
                  np.concatenate([seen.track, np.tile(1000 + np.arange(200), VIEWS)]),
                  np.concatenate([seen.xy, xy.reshape(-1, 2)]), scene.image_size)


def _dropped(tracks):
    return drop_static_regions(tracks, drop_static(tracks)[0])


@pytest.mark.parametrize('shake_px', [0.05, 0.4, 1.2])
def test_a_body_that_shakes_goes_whole_and_the_scene_stays(room, shake_px):
    scene = _scene(room)
    left, findings = _dropped(_with_body(scene, shake_px))
    assert [finding.kind for finding in findings] == ['static_region']
    values = findings[0].values
    assert values['left_px'] == 0 and values['bottom_px'] == HEIGHT
    assert abs(values['top_px'] - BODY_TOP) <= 1.5 * WIDTH / 24
    # what slides along the edge of the region may stay
    assert np.count_nonzero(left.track >= 1000) < 0.03 * 200 * VIEWS
    above = scene.xy[:, 1] < BODY_TOP - 1.5 * WIDTH / 24
    assert np.isin(scene.track[above], left.track).mean() > 0.99


def test_what_is_far_or_moves_is_no_body(room):
    for scene in (_scene(room), _scene(room, far=True)):
        left, findings = _dropped(scene)
        assert not findings and len(left) == len(drop_static(scene)[0])
    still = Tracks(np.repeat(np.arange(VIEWS), 300), np.tile(np.arange(300), VIEWS), np.tile(
        np.random.default_rng(0).uniform(0, 300, (300, 2)), (VIEWS, 1)), (WIDTH, HEIGHT))
    # a camera that stands sees nothing move
    assert not _dropped(still)[1]


def test_keyframes_are_chosen_by_what_moves_beside_a_large_body():
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 300, (300, 2))
    step = np.where(np.arange(300)[:, None] < 200, 0.0, [[6.0, 0.0]])
    selector = KeyframeSelector(15.0)
    chosen = [selector.offer(np.arange(300), xy + k * step + rng.normal(0, 0.3, xy.shape))
              for k in range(7)]
    assert chosen == [True, False, False, True, False, False, True]
    # little may move before a camera that stands
    few = KeyframeSelector(15.0)
    step[:280] = 0
    assert sum(few.offer(np.arange(300), xy + k * step) for k in range(7)) == 1


@pytest.mark.long
def test_a_body_over_more_than_half_of_a_video_leaves_the_scene_right(room):
    cameras = drive(16, 0.06, 1.2)
    rng = np.random.default_rng(0)
    body = cv2.resize(rng.integers(0, 255, (25, 60), dtype=np.uint8), (WIDTH, 170),
                      interpolation=cv2.INTER_CUBIC)
    images = [room.image(camera) for camera in cameras]
    for image in images:
        shift = np.float32([[1, 0, rng.normal(0, 0.4)], [0, 1, rng.normal(0, 0.4)]])
        image[130:] = cv2.warpAffine(body, shift, (WIDTH, 170), borderMode=cv2.BORDER_REFLECT)
    extraction = extract_tracks(((k, image, 0) for k, image in enumerate(images)), 'video')
    assert 'static_region' in [finding.kind for finding in extraction.findings]
    assert len(extraction.keyframes) >= 4
    error, _ = transfer_errors(room, cameras, extraction.tracks)
    assert len(error) > 600 and np.mean(error > 2) < 0.02
