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
import numpy as np
import pytest
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.features.detection import most_features
from selfcal_ros.features.surplus import without_surplus
from selfcal_ros.synthetic.special_scenes import drive


def drawn(rng, images=30, tracks=2000):
    """Draw tracks of 2 to 12 images each, many more in the first third of the images."""
    image, track = [], []
    for one in range(tracks):
        begin = int(images * rng.random()**2)
        seen = np.arange(begin, min(begin + rng.integers(2, 13), images))
        image.append(seen)
        track.append(np.full(len(seen), 7 * one))
    return np.concatenate(image), np.concatenate(track)


def test_what_is_not_too_much_is_kept_whole():
    image, track = drawn(np.random.default_rng(0))
    assert without_surplus(image, track, len(track), np.random.default_rng(1)).all()


def test_every_image_keeps_its_share_in_whole_tracks():
    image, track = drawn(np.random.default_rng(0))
    kept = without_surplus(image, track, 3000, np.random.default_rng(1))
    before, after = np.bincount(image), np.bincount(image[kept])

    assert 2900 < kept.sum() <= 3000
    assert before.max() > 2 * before.min()
    assert after.min() > 0.7 * 100 and after.max() < 1.4 * 100
    for one in np.unique(track[kept]):
        assert kept[track == one].all()


def test_the_choice_is_that_of_its_generator():
    image, track = drawn(np.random.default_rng(0))
    first, again, other = (without_surplus(image, track, 3000, np.random.default_rng(seed))
                           for seed in (1, 1, 2))
    assert (first == again).all() and (first != other).any()


@pytest.mark.long
def test_the_camera_of_a_third_of_the_positions_agrees_with_that_of_all():
    scene = drive(np.random.default_rng(3), 0.3, 16, 1500)
    facts = CameraFacts(aspect_ratio=1.0, skew=0.0)
    kept = without_surplus(scene.tracks.frame, scene.tracks.track, len(scene.tracks) // 3,
                           np.random.default_rng(1))
    whole, part = (calibrate(tracks, facts=facts)
                   for tracks in (scene.tracks, scene.tracks.select(kept)))
    truth = scene.camera.K[0, 0]
    assert abs(part.camera.K[0, 0] - truth) < 3 * part.sigma['fx']
    assert part.sigma['fx'] < 3**0.5 * whole.sigma['fx']


def test_each_of_many_images_is_searched_for_fewer_features():
    assert [most_features(count) for count in (1, 24, 333)] == [3000, 3000, 3000]
    assert most_features(1000) == 1000 and most_features(100_000) == 600
    assert all(count * most_features(count) <= 1_000_000 for count in range(334, 1600))
