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
"""What the calibration of a rig returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from selfcal_ros.calibration.known_directions import PlaceAlong, sigmas_of_angles
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration, NotCalibrated
from selfcal_ros.findings.finding import Finding, sentences
from selfcal_ros.geometry.rotation import roll_pitch_yaw
from selfcal_ros.values.motion import Motion
from selfcal_ros.values.parameter_status import Status

#: Degrees of freedom of a camera in its rig: place, and small turns about the rig's axes (rad).
PLACE, TURN = ('x', 'y', 'z'), ('roll', 'pitch', 'yaw')
POSE = (*PLACE, *TURN)


@dataclass(frozen=True)
class CameraInRig:
    """
    Where a camera sits in the rig.

    The frame of the rig is the optical frame of its first camera: x right, y down, z forward.

    Attributes
    ----------
    T_rig_camera : ndarray, shape (4, 4)
        Takes points of the camera to the rig. NaN where it is not observable.
    covariance : ndarray, shape (6, 6)
        Of x, y, z (in `RigCalibration.unit`) and of small turns roll, pitch, yaw about the x, y
        and z axes of the rig (rad); infinite variance where not observable.
    status : dict of str to str
        Of each of these 'estimated', 'held' or 'unobservable'.
    shared_points : int
        Scene points that this camera and another saw.
    remark : Finding, optional
        What is not observable, and the motion that would show it.
    places : tuple of PlaceAlong
        Where part of the place is open: what is known of it, by directions in the rig.

    """

    T_rig_camera: np.ndarray
    covariance: np.ndarray
    status: dict[str, Status]
    shared_points: int = 0
    remark: Finding | None = None
    places: tuple[PlaceAlong, ...] = ()

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of x, y, z, roll, pitch, yaw; infinite where not observable."""
        return dict(zip(POSE, np.sqrt(np.diag(self.covariance)).tolist()))

    @property
    def angles(self) -> dict[str, float]:
        """Angles about the fixed x, y and z axes of the rig that turn it to the camera, rad."""
        return dict(zip(TURN, roll_pitch_yaw(self.T_rig_camera[:3, :3]).tolist()))

    @property
    def angles_sigma(self) -> dict[str, float]:
        """Standard deviations of `angles` (rad); those of `sigma` where one is not estimated."""
        return sigmas_of_angles(self.angles, self.covariance[3:, 3:], self.status)

    @property
    def baseline(self) -> float:
        """Distance from the first camera, in the unit of the rig; NaN if it is not observable."""
        return float(np.linalg.norm(self.T_rig_camera[:3, 3]))


@dataclass(frozen=True)
class RigCalibration:
    """
    Cameras that move together; true in a condition.

    Attributes
    ----------
    cameras : mapping of str to Calibration
        Each as if it had been calibrated by itself, from the images of all; its reconstruction
        has the unit of the rig.
    poses : mapping of str to CameraInRig
        The first is at the origin.
    parameter_names : tuple of str
        'left.fx', ..., 'right.yaw': all that is estimated, in the order of `covariance`.
    covariance : ndarray, shape (n, n)
        One for all lenses and poses; zero rows for what is held.
    unit : str
        'm' where a length was stated, else 'path': the root mean square distance between
        successive instants.
    scale : float
        Units in one such distance: 1 without a stated length.
    motion : str
        How the rig moved, see `selfcal_ros.calibration.result.MOTIONS`.
    frames : tuple of int
    noise_sigma_px, reprojection_rms_px : float
    observation_count, outlier_count : int
    reconstruction : Reconstruction
        The path of the first camera, and all points.
    alone : mapping of str to Calibration or NotCalibrated
        What the images of each camera say without the others.
    findings : tuple of Finding
    software : str

    """

    cameras: Mapping[str, Calibration]
    poses: Mapping[str, CameraInRig]
    parameter_names: tuple[str, ...]
    covariance: np.ndarray
    unit: str
    scale: float
    motion: Motion
    frames: tuple[int, ...]
    noise_sigma_px: float
    reprojection_rms_px: float
    observation_count: int
    outlier_count: int
    reconstruction: Reconstruction = field(repr=False)
    alone: Mapping[str, Calibration | NotCalibrated] = field(repr=False)
    findings: tuple[Finding, ...] = ()
    software: str = ''

    def __bool__(self) -> Literal[True]:
        """Be true: there is a calibration."""
        return True

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings in words, one sentence each."""
        return sentences(self.findings)

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of each of `parameter_names`, zero where held."""
        return dict(zip(self.parameter_names, np.sqrt(np.diag(self.covariance)).tolist()))

    def between(self, first: str, second: str) -> np.ndarray:
        """Return T_first_second (4, 4), which takes points of the second camera to the first."""
        between: np.ndarray = (np.linalg.inv(self.poses[first].T_rig_camera)
                               @ self.poses[second].T_rig_camera)
        return between
