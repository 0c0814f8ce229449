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
"""Images that hold two views of one scene, and images that only look so."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.features.two_views import IMAGES_APART, IMAGES_ASKED, two_views, TwoViewsWatch
from test_support.feature_scenes import smooth_texture


def texture(seed, size=(240, 420)):
    """Draw smooth texture, (H, W)."""
    return smooth_texture(seed, size, 6)


def stereo(seed, shift=24, noise=4.0, brightness=1.1):
    """Cut two views of 320 pixels out of a texture, of cameras that are not quite alike."""
    rng = np.random.default_rng([seed, 1])
    whole = texture(seed)
    left, right = whole[:, :320], brightness * whole[:, shift:shift + 320]
    return [(one + rng.normal(0, noise, one.shape)).clip(0, 255).astype(np.uint8)
            for one in (left, right)]


def bricks(period):
    """Draw a wall that repeats itself, of one view."""
    image = np.full((240, 640), 150, np.uint8)
    for y in range(0, 240, period // 2):
        cv2.line(image, (0, y), (639, y), 90, 2)
        for x in range((2 * y // period % 2) * period // 2, 640, period):
            cv2.line(image, (x, y), (x, y + period // 2), 90, 2)
    noise = np.random.default_rng(period).normal(0, 4, image.shape)
    return (image + noise).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize('seed', range(4))
def test_two_views_beside_or_above_each_other_are_told(seed):
    views = stereo(seed)
    assert two_views([np.hstack(views), np.hstack(stereo(seed + 9))]) == 'left and right'
    assert two_views([np.vstack(views)]) == 'top and bottom'
    # one image of one view is enough to think otherwise
    assert two_views([np.hstack(views), texture(seed, (240, 640)).astype(np.uint8)]) is None
    assert two_views([np.hstack([views[0], stereo(seed + 1)[1]])]) is None


@pytest.mark.parametrize('image', [
    *(bricks(period) for period in (32, 40, 64)), np.zeros((240, 640), np.uint8),
    np.full((8, 8), 9, np.uint8), texture(5, (240, 640)).astype(np.uint8),
    cv2.rectangle(texture(6, (240, 640)).astype(np.uint8), (316, 0), (324, 240), 0, -1)])
def test_one_view_is_not_taken_for_two(image):
    assert two_views([image]) is None and two_views([]) is None


def test_a_stream_is_told_once_after_its_first_images():
    watch = TwoViewsWatch()
    told = [watch.see(np.hstack(stereo(k % 4))) for k in range(4 * IMAGES_APART)]
    assert [k for k, one in enumerate(told) if one] == [(IMAGES_ASKED - 1) * IMAGES_APART]
    # an edge in the middle that moves on
    watch = TwoViewsWatch()
    assert not any(watch.see(np.hstack(stereo(1)) if k < 5 else bricks(40)) for k in range(30))


def test_a_recorded_pair_is_told_and_recorded_views_are_not():
    folder = next((parent / 'shared/data' for parent in Path(__file__).resolve().parents
                   if (parent / 'shared/data').is_dir()), None)
    if folder is None:
        pytest.skip('the recorded sets shared/data are not there')
    pair = [[cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
             for file in sorted((folder / 'euroc_v101' / name).glob('*.*g'))[:50:20]]
            for name in ('cam0', 'cam1')]
    assert two_views([np.hstack(views) for views in zip(*pair)]) == 'left and right'
    assert two_views([np.vstack(views) for views in zip(*pair)]) == 'top and bottom'
    for name in ('fountain_p11', 'kitti00_turn_a', 'kuka_chess', 'rct_circles', 'vgg_corridor'):
        for file in sorted((folder / name / 'images').iterdir())[:3]:
            image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            assert image is None or two_views([image]) is None, file
