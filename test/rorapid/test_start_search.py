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
"""Which start is believed: the counts of `StartSearch`, without images."""

import numpy as np
import pytest

from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.estimation.pose_search import best_turned
from selfcal_ros.rorapid.estimation.start_check import StartCheck, Support
from selfcal_ros.rorapid.estimation.start_search import StartSearch
from selfcal_ros.rorapid.projection.camera_models import ObjectPose


class Seen:
    """A method whose test sees what it is told to."""

    def __init__(self, supports):
        """Take the supports of the poses, image after image."""
        self._supports = iter(supports)
        self.check = StartCheck.__new__(StartCheck)
        self.check.forget()
        self.check.support = lambda image, state: next(self._supports)
        self.search = self

    def rivals(self, image, guess, found, spread):
        """Find nothing but a pose that is turned, and seen badly."""
        return [(TURNED, BAD)]


def turned_about_x(angle_deg):
    return ObjectPose(rotation_matrix(np.deg2rad([angle_deg, 0, 0])), np.array([0, 0, 1.0]))


class Measured:
    state = turned_about_x(0)


SURE, WEAK, BAD = Support(0.95, 0.95), Support(0.6, 0.7), Support(0.1, 0.2)
TURNED = turned_about_x(20)


@pytest.mark.parametrize('outline, supports, confirmed', (
    (False, (SURE,), [True]), (True, (SURE,), [True]), (False, (WEAK, SURE), [False, True]),
    # an outline that was denied once must be sure for three images in a row
    (True, (WEAK, SURE, SURE, SURE), [False, False, False, True]),
    (True, (WEAK, SURE, WEAK, SURE, SURE, SURE), [False] * 5 + [True])))
def test_an_outline_that_was_denied_must_be_sure_for_longer(outline, supports, confirmed):
    method, start = Seen(supports), StartSearch(None, np.eye(6), outline)
    for wanted in confirmed:
        _, other = start.look(method, None, Measured, np.eye(6))
        assert not other and start.confirmed(method) is wanted
    assert start.support is supports[-1] and 'along their length' in start.reason()


def test_a_start_is_given_up_after_fifteen_images():
    method, start = Seen([WEAK] * 15), StartSearch(None, np.eye(6), True)
    for count in range(15):
        assert start.tries == count and not start.given_up(missed=True)
        start.look(method, None, Measured, np.eye(6))
    assert start.given_up(missed=False)


def test_a_painted_object_is_confirmed_where_no_turned_pose_comes_near():
    """Its edges change their polarity with the pictures beside them; other poses show less."""
    painted = Support(0.67, 0.79)
    method, start = Seen([painted]), StartSearch(None, np.eye(6), False)
    start.look(method, None, Measured, np.eye(6))
    assert start.confirmed(method) and start.sure
    check = method.check
    assert not check.alone(painted, Support(0.6, 0.7)) and not check.alone(BAD, Support())


def test_the_same_pose_and_one_a_quarter_further_are_no_rivals():
    """A cube looks the same from six sides; what a start comes back to is no other pose."""
    found = Measured.state
    poses = [(turned_about_x(1), SURE), (turned_about_x(90), SURE), (TURNED, BAD)]
    assert best_turned(poses, found) is BAD
    assert best_turned(poses[:2], found) == Support()
