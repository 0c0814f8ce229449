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
"""Masks: files, sizes, margins, and no track in what is masked."""

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import InputError
from selfcal_ros.features.extraction import extract_tracks
from selfcal_ros.features.klt import corners, KltTracker
from selfcal_ros.features.mask import ImageMask, PATCH_PX, read_mask
from selfcal_ros.features.detection import detect
from test_support.feature_scenes import drive, Room, transfer_errors

#: Where the logo is: columns and rows of the 400x300 images.
LOGO = (slice(180, 300), slice(0, 220))


@pytest.fixture(scope='module')
def mask():
    """Return a mask without the logo."""
    usable = np.full((300, 400), 255, np.uint8)
    usable[LOGO] = 0
    return ImageMask(usable)


@pytest.fixture(scope='module')
def room():
    """Return the room; painting it takes a while."""
    return Room()


def _with_logo(room, cameras, creeping_px=0.0):
    """Return images with a textured logo that stands still, or creeps to the right."""
    rng = np.random.default_rng(5)
    logo = cv2.resize(rng.integers(0, 255, (30, 80), dtype=np.uint8), (320, 120),
                      interpolation=cv2.INTER_CUBIC)
    images = [room.image(camera) for camera in cameras]
    for k, image in enumerate(images):
        shifted = cv2.warpAffine(logo, np.float32([[1, 0, creeping_px * k - 60], [0, 1, 0]]),
                                 (220, 120))
        image[LOGO] = shifted
    return images


def test_a_margin_keeps_patches_within(mask):
    xy = np.array([[100.0, 171.0], [100.0, 173.0], [300.0, 200.0], [227.4, 250.0], [-3.0, 5.0],
                   [2.0, 2.0]])
    # rows up to 179 are usable: a patch of half 8 fits around row 171, not around row 173
    assert mask.allows(xy).tolist() == [True, False, True, False, False, True]
    assert mask.allows_blobs(np.array([[100.0, 160.0]] * 2), np.array([2.0, 6.0])).tolist() == [
        True, False]
    assert mask.share == pytest.approx(1 - 120 * 220 / 120000)
    assert (mask & None) is mask
    other = np.ones((300, 400))
    other[:, 300:] = 0
    assert (mask & ImageMask(other)).share == pytest.approx(0.75 - 120 * 220 / 120000)


def test_nothing_is_found_or_followed_into_the_masked_part(room, mask):
    cameras = drive(5)
    images = _with_logo(room, cameras, 2.5)
    found = corners(images[0], 20, mask=mask)
    assert len(found) > 60 and mask.allows(found).all()
    features = detect(images[0], mask=mask)
    assert len(features.xy) > 100 and mask.allows(features.xy, PATCH_PX - 1).all()
    tracker = KltTracker(mask=mask)
    for image in images:
        _, xy = tracker.add(image)
        assert len(xy) > 100 and mask.allows(xy).all()


@pytest.mark.long
@pytest.mark.parametrize('mode, count, step', [('video', 8, 0.04), ('wide', 4, 0.3)])
def test_wrong_texture_does_no_harm_behind_a_mask(room, mask, mode, count, step):
    cameras = drive(count, step, 20 * step)
    images = _with_logo(room, cameras, 4.0)

    def error(**given):
        tracks = extract_tracks(((k, image, 0) for k, image in enumerate(images)), mode,
                                **given).tracks
        assert len(tracks) > 200
        return tracks, np.mean(transfer_errors(room, cameras, tracks)[0] > 2)

    tracks, share = error(mask=mask)
    assert share < 0.01 and mask.allows(tracks.xy, PATCH_PX - 4).all()
    assert error()[1] > 0.1


def test_a_mask_of_another_size_is_refused(mask):
    small = np.zeros((100, 120), np.uint8)
    sentence = 'The mask is 400x300 pixels, but the images are 120x100'
    for mode in ('auto', 'video', 'wide'):
        with pytest.raises(InputError, match=sentence):
            extract_tracks(iter([(0, small, 0)]), mode, mask=mask)
    with pytest.raises(InputError, match=sentence):
        KltTracker(mask=mask).add(small)


def test_mask_files(tmp_path):
    picture = np.zeros((60, 80, 3), np.uint8)
    picture[:, 40:] = 255
    picture[:, 20:40, 0] = 1
    for name, kept in (('mask.png', 0.75), ('mask.jpg', 0.5)):
        cv2.imwrite(str(tmp_path / name), picture)
        assert read_mask(tmp_path / name).share == kept
    cv2.imwrite(str(tmp_path / 'deep.png'), picture[:, :, 0].astype(np.uint16))
    assert read_mask(tmp_path / 'deep.png').share == 0.75
    cv2.imwrite(str(tmp_path / 'black.png'), 0 * picture)
    cv2.imwrite(str(tmp_path / 'photo.png'), np.random.default_rng(0).integers(
        20, 230, (60, 80), np.uint8))
    (tmp_path / 'text.png').write_text('white\n')
    (tmp_path / 'empty.png').write_bytes(b'')
    for name, words in (('black.png', 'is black all over'),
                        ('photo.png', 'is a photograph; give'), ('text.png', 'is no image'),
                        ('empty.png', 'is no image'), ('none.png', 'cannot be read: No such'),
                        ('', 'cannot be read: Is a directory')):
        with pytest.raises(InputError, match=words):
            read_mask(tmp_path / name)
