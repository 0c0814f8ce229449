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
"""Lenses whose polynomial is a stand-in for another model."""

import numpy as np
import pytest

from selfcal_ros import calibrate, Camera, CameraFacts
from selfcal_ros.synthetic.special_scenes import drive, hand_held

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)


def sigmas_off(found, truth):
    """Deviations of fx, cx, cy in stated sigmas."""
    error = found.camera.parameters[[0, 2, 3]] - truth.parameters[[0, 2, 3]]
    return np.abs(error / [found.sigma[name] for name in ('fx', 'cx', 'cy')])


# measured lenses as the rational model has them: 8 and 4 sigma off in silence before
@pytest.mark.long
@pytest.mark.parametrize('f, coefficients', [
    (327.45, (2.6641, -0.0341, -0.0005, 0.0006, -0.0092, 2.5853, 0, 0)),
    (453.29, (1.2685, -0.6677, 0.0003, 0.0014, 0.6132, 1.0964, 0, 0))])
def test_a_rational_lens_is_not_taken_for_a_polynomial(f, coefficients):
    truth = Camera([[f, 0, 322.0], [0, f, 240.5], [0, 0, 1]], coefficients, 640, 480,
                   'rational_polynomial')
    tracks = hand_held(np.random.default_rng(2), 0.3, 20, 600, 12, truth).tracks
    found = calibrate(tracks, facts=SQUARE)

    assert found.facts.distortion == 'rational'
    assert sigmas_off(found, truth).max() < 4


def test_what_a_wrong_start_leaves_is_no_noise_to_weigh_families_by():
    # the start was a fisheye, whose misfit passed for shared errors: 5.5 sigma off
    truth = Camera([[352.83, 0, 312.23], [0, 352.83, 246.26], [0, 0, 1]],
                   (0.7448, -0.0998, -0.0029, 0.0020, 0.0151, 1.0529, 0, 0), 640, 480,
                   'rational_polynomial')
    found = calibrate(hand_held(np.random.default_rng(3), 0.3, 20, 600, 12, truth).tracks,
                      facts=SQUARE)
    assert found.facts.distortion == 'rational'
    assert sigmas_off(found, truth).max() < 4


@pytest.mark.long
def test_a_fisheye_without_a_barrel_is_held_against_the_others():
    # a measured lens of a corner at 68 degrees that bulges outwards: rational, 8 sigma off
    truth = Camera([[212.38, 0, 321.85], [0, 212.38, 238.09], [0, 0, 1]],
                   (0.4635, 0.5518, -1.1237, 0.5179), 640, 480, 'equidistant')
    found = calibrate(drive(np.random.default_rng(2), 0.3, 16, 300, 12, truth).tracks,
                      facts=SQUARE)
    assert found.facts.distortion == 'equidistant'
    assert sigmas_off(found, truth).max() < 4
