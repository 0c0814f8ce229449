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
"""From images to tracks, both ways, and what is refused."""

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.features.extraction import extract_tracks
from test_support.feature_scenes import drive, Room, transfer_errors


def _stream(images):
    return ((10 + k, image, 1000 * k) for k, image in enumerate(images))


@pytest.fixture(scope='module')
def room():
    """Return the room."""
    return Room()


@pytest.fixture(scope='module')
def photographs(room):
    """Return cameras and images far apart, with dirt on the lens."""
    cameras = drive(7, 0.3, 6.0)
    rng = np.random.default_rng(1)
    images = [room.image(camera) for camera in cameras]
    spots = rng.integers([20, 20], [380, 280], (25, 2))
    dirt = [cv2.resize(rng.integers(0, 255, (4, 4)).astype(np.uint8), (17, 17),
                       interpolation=cv2.INTER_CUBIC) for _ in spots]
    for image in images:
        for (x, y), patch in zip(spots.tolist(), dirt):
            image[y - 8:y + 9, x - 8:x + 9] = patch
    return cameras, images, spots


def test_photographs_are_matched_wide_and_exact(room, photographs):
    cameras, images, spots = photographs
    stages = []
    extraction = extract_tracks(_stream(images), progress=lambda text, done: stages.append(text))
    assert extraction.mode == 'wide'
    assert {'features', 'matching'} <= set(stages)
    tracks = extraction.tracks
    assert tracks.image_size == (400, 300)
    assert tracks.frames.tolist() == extraction.keyframes.tolist() == list(range(10, 17))
    assert tracks.stamps_ns == {10 + k: 1000 * k for k in range(7)}
    shifted = [None] * 10 + list(cameras)
    error, _ = transfer_errors(room, shifted, tracks)
    assert len(error) > 1500
    assert np.median(error) < 0.15
    assert np.mean(error > 2) < 0.01
    assert any('stay still' in note for note in extraction.notes)


def test_video_is_followed(room):
    cameras = drive(10, 0.04, 0.8)
    images = [room.image(camera) for camera in cameras]
    extraction = extract_tracks(_stream(images), max_keyframes=6)
    assert extraction.mode == 'video'
    assert 2 <= len(extraction.keyframes) <= 6
    assert set(extraction.tracks.frames) <= set(extraction.keyframes.tolist())
    error, _ = transfer_errors(room, [None] * 10 + cameras, extraction.tracks)
    assert np.median(error) < 0.1 and np.mean(error > 2) < 0.01


@pytest.mark.long
def test_the_same_seed_gives_the_same_tracks(photographs):
    images = photographs[1][:4]
    first, second = (extract_tracks(_stream(images), 'wide', rng=np.random.default_rng(3)).tracks
                     for _ in range(2))
    assert np.array_equal(first.xy, second.xy) and np.array_equal(first.track, second.track)


def test_images_of_which_none_resembles_the_next_are_said_to_be_far_apart():
    images = [cv2.GaussianBlur(np.random.default_rng(k).integers(0, 255, (120, 160), np.uint8),
                               None, 2) for k in range(6)]
    told = {one.kind: str(one) for one in extract_tracks(_stream(images)).findings}
    assert 'frames_far_apart' in told and 'inf' not in told['frames_far_apart']
    assert 'mode_chosen' not in told


@pytest.mark.parametrize('mode', ['auto', 'video', 'wide'])
def test_no_image_is_an_input_error(mode):
    with pytest.raises(InputError, match='no image'):
        extract_tracks(iter([]), mode)


@pytest.mark.parametrize('mode', ['video', 'wide'])
def test_blank_images_give_no_tracks(mode):
    blank = [np.full((120, 160), 90, np.uint8)] * 8
    assert len(extract_tracks(_stream(blank), mode).tracks) == 0


def test_bad_images_are_named():
    good = np.zeros((100, 120), np.uint8)
    for bad, word in ((np.zeros((100, 130), np.uint8), 'Frame 11 is 130x100'),
                      (np.zeros((100, 120, 3), np.uint8), 'Frame 11 must be a grey'),
                      (np.zeros((100, 120), np.uint16), 'Frame 11 must be a grey')):
        with pytest.raises(InputError, match=word):
            extract_tracks(_stream([good, bad]), 'video')
    with pytest.raises(InputError, match='64x64'):
        extract_tracks(_stream([np.zeros((20, 30), np.uint8)]))


def test_impossible_arguments_are_refused():
    with pytest.raises(ArgumentError, match='mode'):
        extract_tracks(iter([]), 'fast')
    with pytest.raises(ArgumentError, match='max_keyframes'):
        extract_tracks(iter([]), max_keyframes=1)
