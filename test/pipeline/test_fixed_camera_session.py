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
"""A session beside a turntable: keyframes are chosen by what moves, while the camera stands."""

import numpy as np
from selfcal_ros.pipeline.calibration_session import CalibrationSession

SIZE = (640, 480)


def _frames(count, rng):
    """Yield points of a wall, and of a disc that turns by 3 degrees a frame."""
    wall = rng.uniform([5, 5], [635, 475], (450, 2))
    angle, radius = rng.uniform(0, 2 * np.pi, 50), rng.uniform(30, 120, 50)
    for k in range(count):
        turned = angle + np.radians(3.0) * k
        disc = np.stack([320 + radius * np.cos(turned), 300 + 0.5 * radius * np.sin(turned)], 1)
        yield np.concatenate([wall, disc])


def test_what_moves_before_a_camera_that_stands_chooses_keyframes():
    rng = np.random.default_rng(0)
    session = CalibrationSession()
    for k, xy in enumerate(_frames(40, rng)):
        session.add_tracks(33_000_000 * k, np.arange(500), xy + rng.normal(0, 0.1, xy.shape), SIZE)
    assert 8 <= session.snapshot().keyframes <= 30
    # once the camera moves, these are of no use
    for k in range(40, 80):
        xy += 15.0
        session.add_tracks(33_000_000 * k, np.arange(500), xy, SIZE)
    assert all(not one.of_part for one in session.keyframes) and len(session.keyframes) > 10
