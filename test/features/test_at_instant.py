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
"""Positions between the images of a camera with a clock of its own, against a true motion."""

import cv2
import numpy as np
import pytest
from selfcal_ros.features.at_instant import at_instant, ImagesBeside
from selfcal_ros.features.klt import corners

SIZE = (320, 240)


def _turned(time_s):
    """Return the map (3, 3) of a picture at a time: it turns, grows and speeds up."""
    angle, zoom = 0.4 * time_s + 2.0 * time_s**2, 1 + 0.3 * time_s
    c, s = zoom * np.cos(angle), zoom * np.sin(angle)
    centre = np.array([160.0, 120.0])
    shift = centre - np.array([[c, -s], [s, c]]) @ centre + [60 * time_s + 150 * time_s**2, 0]
    return np.array([[c, -s, shift[0]], [s, c, shift[1]], [0, 0, 1.0]])


@pytest.fixture(scope='module')
def picture():
    noise = sum(cv2.GaussianBlur(np.random.default_rng(4).normal(size=SIZE[::-1]), (0, 0), s) * s
                for s in (1.5, 3, 6))
    return np.clip(128 + 60 * noise, 0, 255).astype(np.uint8)


def _at(picture, time_s):
    return cv2.warpPerspective(picture, _turned(time_s), SIZE, flags=cv2.INTER_CUBIC,
                               borderMode=cv2.BORDER_REFLECT)


def _moved(xy, time_s):
    M = _turned(time_s)
    return xy @ M[:2, :2].T + M[:2, 2]


def _inside(xy):
    return ((xy > 40) & (xy < np.array(SIZE) - 40)).all(axis=1)


@pytest.mark.parametrize('late_s', [0.03, -0.02, 0.005])
def test_positions_are_those_of_the_instant(picture, late_s):
    # a picture that speeds up, 15 images a second
    truth = corners(picture, 12)
    truth = truth[_inside(truth)]
    beside = ImagesBeside(late_s, tuple((late, _at(picture, late)) for late in
                                        (late_s - 1 / 15, late_s + 1 / 15)))
    seen = _moved(truth, late_s)
    found, good = at_instant(_at(picture, late_s), beside, seen)
    assert good.mean() > 0.95
    left = np.linalg.norm(found - truth, axis=1)[good]
    assert np.sqrt(np.mean(left**2)) < 0.06
    assert np.median(np.linalg.norm(seen - truth, axis=1)) > 5 * np.median(left)


def test_a_point_that_is_lost_beyond_the_instant_is_not_used(picture):
    truth = corners(picture, 12)
    truth = truth[_inside(truth)]
    late_s = 0.03
    after = late_s + 1 / 15, _at(picture, late_s + 1 / 15)
    for others in ((after,), ((late_s - 1 / 15, np.full(SIZE[::-1], 128, np.uint8)), after)):
        _, good = at_instant(_at(picture, late_s), ImagesBeside(late_s, others),
                             _moved(truth, late_s))
        assert not good.any()
    before = late_s - 1 / 15, _at(picture, late_s - 1 / 15)
    found, good = at_instant(_at(picture, late_s), ImagesBeside(late_s, (before,)),
                             _moved(truth, late_s))
    # two positions make a line, and the picture speeds up
    assert good.mean() > 0.9
    assert 0.1 < np.median(np.linalg.norm(found - truth, axis=1)[good]) < 1.0
