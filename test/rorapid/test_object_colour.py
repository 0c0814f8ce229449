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
"""The grey in which an object differs most: colours that are known."""

import cv2
import numpy as np
import pytest
from selfcal_ros.rorapid.region.object_colour import ObjectColour

YELLOW, SKIN, WHITE, BLACK = (30, 180, 225), (110, 150, 200), (205, 200, 195), (20, 22, 25)


def picture(inside, around, noise=4.0, seed=0):
    """A disc of one colour before sectors of others; the image, and its mask."""
    rng, mask = np.random.default_rng(seed), np.zeros((120, 160), np.uint8)
    cv2.circle(mask, (80, 60), 30, 255, -1)
    image = np.zeros((120, 160, 3))
    for k, colour in enumerate(around):
        image[:, k * 160 // len(around):(k + 1) * 160 // len(around)] = colour
    image[mask > 0] = inside
    return np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8), mask


def separation(grey, mask):
    """Difference of both sides over their scatter."""
    one, other = grey[mask > 0].astype(float), grey[mask == 0].astype(float)
    return abs(one.mean() - other.mean()) / np.hypot(one.std(), other.std())


def test_a_yellow_part_stands_out_before_skin_white_and_black():
    image, mask = picture(YELLOW, (SKIN, WHITE, BLACK))
    colour = ObjectColour()
    before = separation(colour.grey(image), mask)
    assert before < 1.0
    colour.learn(image, mask)
    grey = colour.grey(image)
    assert grey.shape == mask.shape and grey.dtype == np.uint8
    assert separation(grey, mask) > 3 * before
    # on every side, not on the mean alone: each background is clearly apart
    inner = np.median(grey[mask > 0])
    for x in (10, 80, 150):
        assert abs(inner - np.median(grey[:15, x - 5:x + 5])) > 25
    colour.forget()
    assert np.array_equal(colour.grey(image), cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


@pytest.mark.parametrize('inside, around', (
    ((210, 210, 210), (BLACK,)),                                  # bright before dark
    ((100, 120, 140), ((100, 120, 140),))))                       # no difference at all
def test_where_colours_tell_no_more_the_usual_grey_stays(inside, around):
    image, mask = picture(inside, around)
    colour = ObjectColour()
    colour.learn(image, mask)
    assert np.array_equal(colour.grey(image), cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def test_grey_images_and_specks_teach_nothing():
    image, mask = picture(YELLOW, (SKIN, WHITE))
    colour, grey = ObjectColour(), cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    colour.learn(grey, mask)
    colour.learn(image, np.zeros_like(mask))
    speck = np.zeros_like(mask)
    speck[60, 80] = 255
    colour.learn(image, speck)
    colour.learn(image, np.full_like(mask, 255))                  # nothing is around
    assert np.array_equal(colour.grey(image), grey)
    assert np.array_equal(colour.grey(grey), grey)


def test_weights_stay_while_they_are_nearly_the_best():
    """What was remembered of edges and texture is in the old grey."""
    colour = ObjectColour()
    colour.learn(*picture(YELLOW, (SKIN, WHITE, BLACK)))
    image = picture(YELLOW, (SKIN, WHITE, BLACK), seed=1)[0]
    before = colour.grey(image)
    colour.learn(*picture(YELLOW, (SKIN, WHITE, BLACK), seed=2))
    assert np.array_equal(colour.grey(image), before)


def test_no_colour_leaves_the_range_of_a_byte():
    colour = ObjectColour()
    colour.learn(*picture(YELLOW, (SKIN, WHITE, BLACK)))
    corners = np.array([[[b, g, r] for b in (0, 255) for g in (0, 255) for r in (0, 255)]],
                       np.uint8)
    grey = colour.grey(corners).astype(int)
    assert grey.min() == 0 and grey.max() == 255 and len(np.unique(grey)) == 8
