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
Errors of the camera's poses, where the calibration gives no covariance for them.

They are estimated together with those of the body's poses. The errors of a camera belong to its
own frame: they are larger along the optical axis, and errors of its rotation move the body at the
other end of the lever.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.mounting.camera_poses import CameraPoses
from selfcal_ros.calibration.mounting.model import State
from selfcal_ros.calibration.mounting.pose_errors import LEAST_M, LEAST_RAD, PoseErrors
from selfcal_ros.geometry.projective import cross_matrix

#: Fewer poses do not tell errors of the camera from those of the body.
LEAST_POSES = 8


def with_errors_of_camera(errors: PoseErrors, state: State, camera: CameraPoses) -> PoseErrors:
    """
    Add errors across the optical axis, along it, and of turns.

    Parameters
    ----------
    errors : PoseErrors
        Of the poses of the body.
    state : State
        Near enough for the arm from body to camera.
    camera : CameraPoses

    Returns
    -------
    PoseErrors
        As they were where the camera's poses have a covariance, or are few.

    """
    if camera.roots.shape[2] or not camera.has_path or len(camera) < LEAST_POSES:
        return errors
    turned = state.world_turn @ camera.rotation
    arm = turned @ state.turn.T @ state.place
    place, turn = np.zeros((2, len(camera), 6, 3))
    place[:, :3] = turned
    turn[:, :3], turn[:, 3:] = cross_matrix(arm) @ turned, turned
    slopes = place[:, :, :2], place[:, :, 2:], turn
    variances = np.array([errors.sigma(0), errors.sigma(0), errors.sigma(3)])**2
    return replace(
        errors, axes=(*errors.axes, (), (), ()),
        shapes=np.concatenate([errors.shapes,
                               [J @ np.swapaxes(J, 1, 2) for J in slopes]]),
        variances=np.concatenate([errors.variances, variances]),
        stated=np.concatenate([errors.stated, np.zeros(3, bool)]),
        floors=np.concatenate([errors.floors, np.array([LEAST_M, LEAST_M, LEAST_RAD])**2]))
