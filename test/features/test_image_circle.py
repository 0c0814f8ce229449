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
"""The circle of a fisheye image is found, and only there."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from selfcal_ros.features.image_circle import CircleWatch, find_circle, within_circle
from selfcal_ros.features.mask import ImageMask, read_mask

DATA = next((p / 'shared/data' for p in Path(__file__).resolve().parents
             if (p / 'shared/data').is_dir()), None)
ORDINARY = ('cs_synthetic/images', 'euroc_v101/cam0', 'euroc_v101/cam1', 'fountain_p11/images',
            'kitti00_turn_a/images', 'kuka_chess/images', 'mb_temple_ring/images',
            'opencv_left/images', 'rct_circles/images', 'vamr_tags3d/images',
            'vgg_corridor/images', 'vgg_dino/images', 'visp_mbt_cube/images', 'visp_rbt/images')


def _images(folder, most):
    if DATA is None or not (DATA / folder).is_dir():
        pytest.skip(f'the recorded images shared/data/{folder} are not beside the repository')
    files = sorted(path for path in (DATA / folder).iterdir()
                   if path.suffix in ('.png', '.jpg', '.ppm', '.pgm'))
    assert files
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in files[:most]]


def _drawn(size, centre, radius, fall_px=3.0, count=4):
    """Draw moving texture in a circle whose light falls off within a few pixels."""
    rng = np.random.default_rng(2)
    width, height = size
    texture = cv2.resize(rng.uniform(20, 250, (40, 60)).astype(np.float32), (width + 80, height))
    y, x = np.mgrid[:height, :width]
    light = np.clip((radius - np.hypot(x - centre[0], y - centre[1])) / fall_px, 0, 1)
    return [np.clip(light * texture[:, 20 * k:20 * k + width] + 6 + rng.normal(0, 1, light.shape),
                    0, 255).astype(np.uint8) for k in range(count)]


@pytest.mark.parametrize('size, centre, radius', [
    ((640, 480), (330.0, 236.0), 210.0), ((752, 480), (381.0, 242.0), 293.0),
    ((1600, 1200), (812.0, 590.0), 560.0)])
def test_a_drawn_circle_is_found_to_a_pixel_or_two(size, centre, radius):
    circle = find_circle(_drawn(size, centre, radius))
    assert np.hypot(circle.x_px - centre[0], circle.y_px - centre[1]) < 1.0
    assert abs(circle.radius_px - radius) < 2.0
    mask = circle.mask(size)
    y, x = np.nonzero(mask.usable)
    assert np.hypot(x - centre[0], y - centre[1]).max() < radius - 1


def test_what_only_looks_like_a_circle_is_none():
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 255, (240, 320), dtype=np.uint8) for _ in range(4)]
    # vignetting, a spot of light in the dark, a scene that goes on in the dark, and a square
    vignette = _drawn((640, 480), (320.0, 240.0), 420.0, 400.0)
    spot = _drawn((640, 480), (320.0, 240.0), 200.0, 160.0)
    beyond = [np.maximum(image, dim // 3) for image, dim in zip(
        _drawn((640, 480), (320.0, 240.0), 200.0), _drawn((640, 480), (320.0, 240.0), 900.0))]
    square = [np.zeros((480, 640), np.uint8) for _ in range(3)]
    for image in square:
        image[100:400, 150:450] = cv2.resize(noise[0], (300, 300))
    for images in ([], noise, [np.zeros((240, 320), np.uint8)] * 3, vignette, spot, beyond,
                   square):
        assert find_circle(images) is None


def test_the_circle_narrows_a_mask_unless_nothing_would_be_left():
    images = _drawn((640, 480), (330.0, 236.0), 210.0)
    usable = np.ones((480, 640), bool)
    usable[300:] = False
    mask, findings = within_circle(images, ImageMask(usable))
    assert [finding.kind for finding in findings] == ['image_circle']
    assert 'circle of radius 210 px about (330, 236)' in findings[0].sentence
    assert mask.allows(np.array([[330.0, 236.0], [330.0, 310.0], [20.0, 20.0]])).tolist() == [
        True, False, False]
    corner = np.zeros((480, 640), bool)
    corner[:20, :20] = True
    watch = CircleWatch(2)
    assert watch.see(images[0]) is None and watch.narrowed(None) is None
    assert watch.see(images[1]).kind == 'image_circle' and watch.see(images[2]) is None
    only = ImageMask(corner)
    assert watch.narrowed(only) is only
    assert watch.narrowed(None) is watch.narrowed(None)
    assert watch.see(images[0][:400]) is None and watch.narrowed(None) is None


@pytest.mark.parametrize('most', [6, 16])
def test_the_circle_of_a_recorded_fisheye_is_found(most):
    circle = find_circle(_images('fisheye_room/images', most))
    # the mask beside the images keeps 6 px from the rim
    usable = read_mask(DATA / 'fisheye_room/mask.png').usable
    columns = np.flatnonzero(usable.any(axis=0))
    assert circle.x_px == pytest.approx(382.1, abs=3)
    assert circle.y_px == pytest.approx(240.1, abs=3)
    assert circle.radius_px == pytest.approx((columns[-1] - columns[0] + 1) / 2 + 6, abs=3)


@pytest.mark.parametrize('folder', ORDINARY)
def test_ordinary_images_have_no_circle(folder):
    assert find_circle(_images(folder, 6)) is None
