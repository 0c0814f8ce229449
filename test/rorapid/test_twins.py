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
"""An object that is hidden is not taken for its twin, which stands beside it in plain view."""

from functools import lru_cache

import numpy as np
import pytest

from selfcal_ros.rorapid.estimation.twin_watch import TWIN
from selfcal_ros.rorapid.tracker import RorapidTracker, TrackerState
from selfcal_ros.synthetic.several_objects import objects_beside

VIEWS, HIDDEN, BACK = 6, 9, 6


@lru_cache(maxsize=None)
def scene(seed):
    made = objects_beside(('cube', 'cube'), VIEWS, supersampling=1, seed=seed)
    return made.objects, made.frames()


def hidden(image, one):
    """Cover one of the objects, at its last pose, (H, W) uint8."""
    x, y = one.camera.project(one.translations[-1][None])[0].astype(int)
    image = image.copy()
    image[max(y - 75, 0):y + 75, max(x - 75, 0):x + 75] = 110
    return image


def away_m(frame, one):
    return float(np.linalg.norm(frame.translation - one.translations[-1]))


@pytest.mark.long
@pytest.mark.parametrize('seed', (5, 21))
def test_a_hidden_object_is_not_found_in_its_twin_and_comes_back(seed):
    (own, twin), images = scene(seed)
    tracker = RorapidTracker(own.model, own.camera, rng=np.random.default_rng(0))
    tracker.start(own.rotations[0], own.translations[0])
    assert all([tracker.track(image) for image in images])
    covered = [tracker.track(hidden(images[-1], own)) for _ in range(HIDDEN)]
    assert covered[-1].state is TrackerState.LOST
    assert any(frame.reason == TWIN for frame in covered)
    assert not any(frame and away_m(frame, twin) < 0.03 for frame in covered)
    back = [tracker.track(images[-1]) for _ in range(BACK)]
    assert back[-1] and away_m(back[-1], own) < 0.01


def test_without_a_twin_what_comes_back_elsewhere_is_the_object():
    (own, other), images = scene(5)
    tracker = RorapidTracker(own.model, own.camera, rng=np.random.default_rng(0))
    tracker.start(own.rotations[0], own.translations[0])
    for image in images:
        tracker.track(hidden(image, other))
    for _ in range(5):
        lost = tracker.track(hidden(hidden(images[-1], own), other))
    assert lost.state is TrackerState.LOST
    elsewhere = [tracker.track(hidden(images[-1], own)) for _ in range(BACK)]
    assert elsewhere[-1] and away_m(elsewhere[-1], other) < 0.01
