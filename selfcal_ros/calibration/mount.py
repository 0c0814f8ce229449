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
"""Where the camera sits on the body of the robot, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.estimate import NoEstimate

#: Degrees of freedom, in the order of `Mount.covariance`.
PLACE, TURN = ('x', 'y', 'z'), ('roll', 'pitch', 'yaw')
NAMES = (*PLACE, *TURN, 'scale', 'time_offset')


@dataclass(frozen=True)
class Mount:
    """
    The pose of the camera on the body, the scale of the scene and the offset of the clocks.

    Attributes
    ----------
    frame : str
        Name of the body's frame.
    T_body_camera : ndarray, shape (4, 4)
        Pose of the camera's optical frame in the body: takes points of the camera to the body.
        Entries that are not observable are those of a stated fact, or NaN.
    covariance : ndarray, shape (8, 8)
        Over `NAMES`: metres; small turns about the axes of the body (rad); the scale; seconds.
        Zero where held, infinite variance where unobservable.
    status : dict of str to str
        Per name 'estimated', 'held' or 'unobservable'.
    scale : float
        Metres in one step of the reconstruction's own unit, see
        `selfcal_ros.calibration.structure.camera_path`.
    time_offset_s : float
        Camera clock minus body clock; 0 and held where poses belong to images.
    missing : dict of str to str
        For what is not observable, the motion or the fact that would show it, in words.
    pose_count : int
        Poses of the body that were used.
    outlier_count : int
        Poses that contradict the others, and were set aside.
    sigma_position_m, sigma_rotation_rad : float
        What the misfit says of the poses of the body; see `BodyPoses`.

    """

    frame: str
    T_body_camera: np.ndarray
    covariance: np.ndarray
    status: dict[str, str]
    scale: float
    time_offset_s: float
    missing: dict[str, str]
    pose_count: int
    outlier_count: int
    sigma_position_m: float
    sigma_rotation_rad: float

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of each of `NAMES`: zero where held, infinite where unobservable."""
        return dict(zip(NAMES, np.sqrt(np.diag(self.covariance)).tolist()))


#: There is no mount, and why.
NoMount = NoEstimate
