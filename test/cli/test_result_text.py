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
"""What a calibration says of itself in a terminal."""

from dataclasses import replace

import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.cli.result_text import result_text
from selfcal_ros.synthetic.hard_scenes import s_curve, vehicle


def test_a_sigma_that_nobody_knows_is_no_number():
    sequence = vehicle(np.random.default_rng(3), s_curve(7), count=100)
    found = calibrate(sequence.tracks, facts=CameraFacts(aspect_ratio=1.0, skew=0.0,
                                                         distortion='radial2'))
    assert f'{found.camera.K[0, 0]:.1f} px ± ' in result_text(found)
    covariance = found.covariance.copy()
    covariance[0, 0] = np.inf
    unknown = result_text(replace(found, covariance=covariance))
    assert 'px (sigma unknown)' in unknown and 'inf' not in unknown.splitlines()[0]
