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
from selfcal_ros.synthetic.special_scenes import hand_held

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)


# measured lenses as the rational model has them: 8 and 4 sigma off in silence before
@pytest.mark.parametrize('f, coefficients', [
    (327.45, (2.6641, -0.0341, -0.0005, 0.0006, -0.0092, 2.5853, 0, 0)),
    (453.29, (1.2685, -0.6677, 0.0003, 0.0014, 0.6132, 1.0964, 0, 0))])
def test_a_rational_lens_is_not_taken_for_a_polynomial(f, coefficients):
    truth = Camera([[f, 0, 322.0], [0, f, 240.5], [0, 0, 1]], coefficients, 640, 480,
                   'rational_polynomial')
    tracks = hand_held(np.random.default_rng(2), 0.3, 20, 600, 12, truth).tracks
    found = calibrate(tracks, facts=SQUARE)

    assert found.facts.distortion == 'rational'
    error = found.camera.parameters[[0, 2, 3]] - truth.parameters[[0, 2, 3]]
    assert np.abs(error / [found.sigma[name] for name in ('fx', 'cx', 'cy')]).max() < 4
