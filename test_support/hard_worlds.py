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
"""Calibrations of hard scenes with square pixels, each made once for all tests of a process."""

from __future__ import annotations

from functools import cache

import numpy as np
from selfcal_ros import calibrate, CameraFacts
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.synthetic.hard_scenes import HARD_SCENES
from selfcal_ros.synthetic.scenes import PointSequence

SQUARE = CameraFacts(aspect_ratio=1.0, skew=0.0)


@cache
def calibrated(name: str, seed: int) -> tuple[PointSequence, Calibration | NotCalibrated]:
    """Return a scene, and what comes of it."""
    sequence = HARD_SCENES[name](np.random.default_rng([seed, 5]))
    return sequence, calibrate(sequence.tracks, facts=SQUARE)
