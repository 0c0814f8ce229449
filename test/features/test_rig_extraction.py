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
"""Images of cameras that move together: points that both see have one number."""

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import InputError
from selfcal_ros.features.mask import ImageMask
from selfcal_ros.features.rig_extraction import extract_rig_tracks
from selfcal_ros.geometry.rotation import rotation_matrix

SIZE = (240, 180)
K = np.array([[220.0, 0, 120], [0, 220, 90], [0, 0, 1]])


def _picture(rng):
    """Blobs of several sizes, which SIFT finds."""
    noise = sum(cv2.GaussianBlur(rng.normal(size=(420, 560)), (0, 0), s) * s for s in (1.5, 3, 6))
    return np.clip(128 + 90 * noise, 0, 255).astype(np.uint8)


def _homography(turn, x):
    """Map the picture, a wall with a tilt, to a view."""
    wall = np.array([[1, 0, -280], [0, 1, -210], [0.0006, 0, 1]])
    return K @ rotation_matrix(np.array(turn)) @ np.diag([1, 1, 260.0]) @ np.array(
        [[1, 0, x], [0, 1, 0], [0, 0, 1]]) @ wall


@pytest.mark.long
def test_what_two_cameras_see_has_one_number():
    picture = _picture(np.random.default_rng(0))
    maps = {name: [_homography([0.02 * k, 0.05 * k - 0.1 + off, 0.03 * k], 12 * k + 15 * off)
                   for k in range(4)] for name, off in (('left', 0.0), ('right', 0.08))}
    images = {name: [cv2.warpPerspective(picture, H, SIZE) for H in some]
              for name, some in maps.items()}
    told = []
    found = extract_rig_tracks(images, [3, 5, 8, 9], rng=np.random.default_rng(1),
                               progress=lambda text, done: told.append((text, done)))
    # the last of each stage is all of it
    assert {text: done for text, done in told} == {
        'features of left': 4, 'matching of left': 1.0, 'features of right': 4,
        'matching of right': 1.0, 'registration': 0}
    left, right = found.tracks.values()
    assert found.shared > 30 and left.frames.tolist() == [3, 5, 8, 9]
    # one number is one place of the picture
    for frame, k in ((3, 0), (9, 3)):
        places = []
        _, a, b = np.intersect1d(left.track[left.frame == frame],
                                 right.track[right.frame == frame], return_indices=True)
        for name, tracks, rows in (('left', left, a), ('right', right, b)):
            xy = tracks.xy[tracks.frame == frame][rows]
            x = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(maps[name][k]).T
            places.append(x[:, :2] / x[:, 2:])
        assert len(a) > 15
        assert np.median(np.linalg.norm(places[0] - places[1], axis=1)) < 0.5


def test_a_mask_is_as_large_as_the_images_of_every_camera():
    # the mask of the larger images would leave out another part of the smaller ones
    rng = np.random.default_rng(0)
    images = {name: [rng.integers(0, 255, size, np.uint8) for _ in range(3)]
              for name, size in (('left', (48, 64)), ('right', (30, 40)))}
    with pytest.raises(InputError, match='mask is 64x48 pixels, but the images are 40x30'):
        extract_rig_tracks(images, range(3), mask=ImageMask(np.ones((48, 64))))


def test_images_of_one_camera_have_one_size():
    image = np.zeros((80, 100), np.uint8)
    with pytest.raises(InputError, match='left must all have one size'):
        extract_rig_tracks({'left': [image, image.T]}, [0, 1])
