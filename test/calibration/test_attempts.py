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
"""A search goes through its attempts in order, and ends with the first that is accepted."""

from dataclasses import dataclass, replace

import pytest
from selfcal_ros.calibration.estimators import motion_calibration, motion_choice
from selfcal_ros.calibration.estimators.attempts import always, Attempt, first_accepted
from selfcal_ros.geometry.no_estimate import NoEstimate


@dataclass(frozen=True)
class Made:
    """Names of the attempts that were made."""

    names: tuple[str, ...] = ()


def attempt(name, tried_when=always, accepted=None):
    """Return an attempt that enters its name."""
    return Attempt(name, tried_when, lambda made: replace(made, names=(*made.names, name)),
                   *([] if accepted is None else [accepted]))


def test_the_first_accepted_attempt_ends_the_search_with_its_result():
    refusal = NoEstimate('no_parallax')
    result, made = first_accepted((
        attempt('one'), attempt('none', tried_when=lambda _: False),
        attempt('two', tried_when=lambda made: made.names == ('one',), accepted=lambda _: refusal),
        attempt('three')), Made())
    # a refusal is falsy, and a result all the same
    assert result is refusal and made.names == ('one', 'two')


def test_without_an_accepted_attempt_all_that_was_found_comes_back():
    result, made = first_accepted((attempt('one'), attempt('two')), Made())
    assert result is None and made.names == ('one', 'two')


@pytest.mark.parametrize('module', [motion_calibration, motion_choice])
def test_attempts_are_told_apart_by_name_in_the_log(module):
    names = [one.name for one in module.ATTEMPTS]
    assert len(set(names)) == len(names)
