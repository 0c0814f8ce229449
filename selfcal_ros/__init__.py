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
"""Camera self-calibration from a robot's own motion."""

from __future__ import annotations

from importlib import import_module
import logging
from typing import Any, TYPE_CHECKING

from selfcal_ros.version import __version__

if TYPE_CHECKING:
    from selfcal_ros.calibration.calibrate import calibrate
    from selfcal_ros.calibration.known_object.point_calibration import calibrate_known_object
    from selfcal_ros.calibration.reconstruction import Measured
    from selfcal_ros.calibration.result import Calibration, NotCalibrated
    from selfcal_ros.calibration.rigs.rig_calibration import calibrate_rig
    from selfcal_ros.calibration.structure.angular_measurement import ray_angles
    from selfcal_ros.calibration.structure.structure_measurement import (length_ratio,
                                                                         structure_angle)
    from selfcal_ros.geometry.camera import Camera
    from selfcal_ros.geometry.camera_facts import CameraFacts
    from selfcal_ros.values.known_object import KnownObject
    from selfcal_ros.values.tracks import Tracks

__all__ = ['Calibration', 'Camera', 'CameraFacts', 'KnownObject', 'Measured', 'NotCalibrated',
           'Tracks', '__version__', 'calibrate', 'calibrate_known_object', 'calibrate_rig',
           'length_ratio', 'ray_angles', 'structure_angle']

_HOMES = {
    'Calibration': 'calibration.result',
    'Camera': 'geometry.camera',
    'CameraFacts': 'geometry.camera_facts',
    'KnownObject': 'values.known_object',
    'Measured': 'calibration.reconstruction',
    'NotCalibrated': 'calibration.result',
    'Tracks': 'values.tracks',
    'calibrate': 'calibration.calibrate',
    'calibrate_known_object': 'calibration.known_object.point_calibration',
    'calibrate_rig': 'calibration.rigs.rig_calibration',
    'length_ratio': 'calibration.structure.structure_measurement',
    'ray_angles': 'calibration.structure.angular_measurement',
    'structure_angle': 'calibration.structure.structure_measurement',
}


# silent until the program that uses this says otherwise
logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    """Load what is asked for (PEP 562): `selfcal --help` must not wait for SciPy."""
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'selfcal_ros.{_HOMES[name]}'), name)
