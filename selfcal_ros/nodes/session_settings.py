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
"""Parameters of a calibrator as settings of a session and of its monitor."""

from typing import cast

from selfcal_ros.calibration.monitoring.camera_change import MonitorSettings
from selfcal_ros.geometry.camera_facts import CameraFacts, FocalChoice, ShutterChoice
from selfcal_ros.geometry.lenses.catalogue import LensChoice
from selfcal_ros.nodes.parameters import CalibratorParameters
from selfcal_ros.pipeline.estimate_request import SessionSettings


def session_settings(parameters: CalibratorParameters) -> SessionSettings:
    """
    Translate; a parameter cannot be absent, so zero stands for an aspect ratio not known.

    Raises
    ------
    ArgumentError
        If values contradict each other.

    """
    facts = CameraFacts(aspect_ratio=parameters.aspect_ratio or None,
                        aspect_ratio_sigma=parameters.aspect_ratio_sigma,
                        skew=0.0 if parameters.zero_skew else None,
                        distortion=cast(LensChoice, parameters.distortion),
                        lens_population=parameters.lens_population,
                        trusted=parameters.trust_facts,
                        # a parameter is checked against these, and is a string for ROS
                        focal=cast(FocalChoice, parameters.focal),
                        shutter=cast(ShutterChoice, parameters.shutter))
    return SessionSettings(motion=parameters.motion, facts=facts,
                           parallax=parameters.keyframe_parallax,
                           max_keyframes=parameters.max_keyframes,
                           first_estimate=parameters.first_estimate)


def monitor_settings(parameters: CalibratorParameters) -> MonitorSettings | None:
    """Translate; None where nothing is to be watched."""
    if not parameters.monitor:
        return None
    return MonitorSettings(false_alarm_keyframes=parameters.false_alarm_keyframes)
