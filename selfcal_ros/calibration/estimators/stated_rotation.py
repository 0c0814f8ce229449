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
"""
A stated rotation against the images.

A pan-tilt head or a wrist holds the camera beside its axes. Taken for a rotation, such a turn has
another focal length, by more than its sigmas.
"""

from __future__ import annotations

from dataclasses import replace

from selfcal_ros.calibration.estimators.motion_choice import CLEARLY_LESS_NOISE, MotionsSeen
from selfcal_ros.calibration.estimators.moving_camera import MovingCamera
from selfcal_ros.calibration.estimators.rotation import judge_rotations
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.no_estimate import NoEstimate


def calibrate_said_to_rotate(case: MovingCamera) -> Calibration | NoEstimate:
    """
    Calibrate a camera that is said to rotate only; about a point beside it, if the images show it.

    Parameters
    ----------
    case : MovingCamera

    Returns
    -------
    Calibration or NoEstimate
        Its sigmas allow for a lever that the images do not show, unless facts were declared exact.

    """
    facts, rotations = case.facts, case.rotations_as_stated()
    if isinstance(rotations, NoEstimate):
        return rotations
    is_asked = not facts.trusted and facts.focal != 'varying' and case.has_enough_views
    turn = (case.about_a_point(rotations)
            if is_asked and MotionsSeen(case, rotations).is_near_turn else None)
    if turn is not None and turn.result:
        beside = () if turn.result.motion == 'rotation' else (Finding('not_exactly_rotation'),)
        return replace(turn.result, findings=(*beside, *turn.result.findings))
    rotating = judge_rotations(rotations, may_miss=not facts.trusted)
    # a zoom looks like a lever, too, and beside a lever it may leave the camera open
    if turn is None or (rotating
                        and CLEARLY_LESS_NOISE * rotating.noise_sigma_px < turn.noise_px):
        return rotating
    return turn.result
