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
"""The state of a session as a diagnostic status."""

from __future__ import annotations

from typing import Any

from msg_adapters.diagnostics import OK, WARN

from selfcal_ros.pipeline.calibration_session import SessionSnapshot

#: What ~/calibrate answers, for those who tell its answers apart.
NOTHING_NEW = 'nothing new since the last result, which is published again'
UNDER_WAY = ('an estimate is under way; its result comes on ~/result',
             'the estimate under way is from before a change and is dropped; another follows, '
             'whose result comes on ~/result')


def calibration_status(state: SessionSnapshot) -> tuple[int, str, dict[str, Any]]:
    """
    Describe a session.

    Returns
    -------
    level : OK or WARN
    text : str
        What there is, or what is missing.
    values : dict
        Counts, and every parameter of the camera with its sigma.

    """
    values: dict[str, Any] = {
        'frames': state.frames, 'keyframes': state.keyframes, 'points': state.points,
        'estimates': state.estimates, 'estimating': state.estimating, 'resets': state.resets}
    if state.calibration is None:
        text = 'not calibrated yet: keep moving, with turns'
        return WARN, text if state.failure is None else str(state.failure), values
    sigma = state.calibration.sigma
    for name, value in zip(sigma, state.calibration.camera.parameters.tolist()):
        values[name] = value
        values[f'{name} sigma'] = sigma[name]
    values['motion'] = state.calibration.motion
    values['reprojection_rms_px'] = state.calibration.reprojection_rms_px
    shutter = state.calibration.shutter
    if shutter is not None and shutter.line_delay_s is not None:
        values['line_delay_s'] = shutter.line_delay_s
        values['line_delay_s sigma'] = shutter.sigma_s
    return OK, 'calibrated', values
