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
"""Panoramas, whose edges meet, and images that only look so."""

import cv2
import numpy as np
import pytest
from selfcal_ros.errors import InputError
from selfcal_ros.features.panorama import are_panoramas
from selfcal_ros.pipeline.calibrate_input import calibrate_input, CalibrationSettings


def strip(seed, turn=0, noise=3.0):
    """Draw what is seen all the way round, (160, 480), turned by some columns."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0, 255, (20, 60)).astype(np.float32)
    whole = cv2.resize(np.hstack([coarse] * 3), (1440, 160), interpolation=cv2.INTER_CUBIC)
    round_about = np.roll(whole[:, 480:960], turn, axis=1)
    drawn = round_about + np.random.default_rng([seed, turn]).normal(0, noise, round_about.shape)
    return drawn.clip(0, 255).astype(np.uint8)


def test_images_that_go_round_are_told_and_parts_of_them_are_not():
    images = [strip(seed, turn) for seed in range(3) for turn in (0, 7, 200)]
    assert are_panoramas(images)
    assert not are_panoramas([one[:, 5:] for one in images])
    assert not are_panoramas([*images, images[0][:, :400]]) and not are_panoramas([])
    assert not are_panoramas([np.vstack([one] * 3) for one in images])


@pytest.mark.parametrize('image', [
    np.zeros((100, 300), np.uint8), np.full((100, 300), 120, np.uint8),
    np.random.default_rng(0).integers(0, 255, (100, 300), np.uint8),
    np.tile(np.linspace(0, 255, 100)[:, None], (1, 300)).astype(np.uint8)])
def test_flat_dark_and_noisy_images_are_none(image):
    noisy = (image + np.random.default_rng(1).normal(0, 4, image.shape)).clip(0, 255)
    assert not are_panoramas([image]) and not are_panoramas([noisy.astype(np.uint8)])


def test_a_recording_of_panoramas_is_one_sentence(tmp_path):
    for k in range(4):
        cv2.imwrite(str(tmp_path / f'{k}.png'), strip(1, 9 * k))
    with pytest.raises(InputError, match='panoramas') as caught:
        calibrate_input(tmp_path, CalibrationSettings())
    assert str(caught.value).count('.') == 1 + str(tmp_path).count('.')
