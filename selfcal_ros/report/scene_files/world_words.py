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
"""What the world of exported poses is, in a few words."""

from __future__ import annotations

from selfcal_ros.calibration.structure.camera_path import CameraPath, OF_AN_OBJECT
from selfcal_ros.calibration.structure.metric_structure import IN_A_PLANE


def world_in_words(path: CameraPath) -> str:
    """Say where the world begins, and how its axes lie."""
    if path.motion == OF_AN_OBJECT:
        return 'that of the known object'
    up = ('z up, along the axis of the motion' if path.motion in IN_A_PLANE
          else 'z up as the first image has it')
    return f'origin at the first image; x forward, y left, {up}'


def unit_in_words(path: CameraPath) -> str:
    """Say what the unit of length is."""
    if path.metres_a_step is not None:
        return 'metre, by the poses of the robot'
    return {'m': 'metre', '': 'none, for the camera only turned'}.get(
        path.unit, 'median step between successive images, for images show no metres')
