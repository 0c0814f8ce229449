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

from selfcal_ros.calibration.known_directions import AxisInCamera, PlaceAlong, sigmas_of_angles
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.camera_facts import is_sigma, LARGEST_SIGMA, LEAST_SIGMA
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.rotation import roll_pitch_yaw, rotation_matrix
from selfcal_ros.values.parameter_status import Status

#: The optical frame (x right, y down, z forward) of a level camera that looks straight ahead, in
#: the axes of the body (x forward, y left, z up).
FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])

#: Degrees of freedom, in the order of `Mount.covariance`.
PLACE, TURN = ('x', 'y', 'z'), ('roll', 'pitch', 'yaw')
NAMES = (*PLACE, *TURN, 'scale', 'time_offset')


#: An axis of the body is its vertical from this cosine on: half a degree.
UPRIGHT = float(np.cos(np.radians(0.5)))
#: No part of a mount is larger: metres, radians, a factor, and seconds between two clocks.
_LARGEST = {'x': 100.0, 'y': 100.0, 'z': 100.0, 'roll': 2 * np.pi, 'pitch': 2 * np.pi,
            'yaw': 2 * np.pi, 'scale': 1000.0, 'time_offset': 1e10}
#: A value and its standard deviation; zero holds it.
Fact = tuple[float, float]


@dataclass(frozen=True)
class MountFacts:
    """
    What is known of the mount beforehand, each as (value, sigma); a sigma of zero holds it.

    Attributes
    ----------
    x, y, z : (float, float), optional
        Place of the camera in the body (x forward, y left, z up), metres.
    roll, pitch, yaw : (float, float), optional
        Of the camera against one that looks straight ahead, radians: its optical frame is
        Rz(yaw) Ry(pitch) Rx(roll) times that of the level one. A positive pitch looks down.
    scale : (float, float), optional
        True metres in a metre of the poses: what is known of the wheels' own scale.
    time_offset : (float, float), optional
        Camera clock minus body clock, seconds.

    Raises
    ------
    ArgumentError
        If a value is not finite or beyond all mounts, a sigma is negative, or the scale is not
        positive.

    """

    x: Fact | None = None
    y: Fact | None = None
    z: Fact | None = None
    roll: Fact | None = None
    pitch: Fact | None = None
    yaw: Fact | None = None
    scale: Fact | None = None
    time_offset: Fact | None = None

    def __post_init__(self) -> None:
        """Check the facts."""
        for name, (value, sigma) in self.stated.items():
            if not (np.isfinite(value) and is_sigma(sigma)):
                raise ArgumentError(f'A known {name} needs a finite value and a sigma, which is 0 '
                                    f'or from {LEAST_SIGMA:g} to {LARGEST_SIGMA:g}, not {value} '
                                    f'and {sigma}.')
            _check_size(name, value)
        if self.scale is not None and self.scale[0] < 1 / _LARGEST['scale']:
            raise ArgumentError('The scale of the poses must be positive, from 0.001 to 1000; '
                                'it is the true metres in a metre of the poses.')

    @property
    def stated(self) -> dict[str, Fact]:
        """Those that are stated, by name."""
        found = {name: getattr(self, name) for name in NAMES}
        return {name: fact for name, fact in found.items() if fact is not None}


def _check_size(name: str, value: float) -> None:
    """Refuse a part that no mount has."""
    if abs(value) <= _LARGEST[name]:
        return
    if name in TURN:
        raise ArgumentError(f'A {name} of {np.degrees(value):g} degrees is more than a whole '
                            'turn; state degrees from -360 to 360.')
    if name in PLACE:
        raise ArgumentError(f'A camera whose {name} is {value:g} m is on no robot; state metres '
                            'up to 100.')
    if name == 'scale':
        raise ArgumentError(f'A scale of {value:g} is impossible; state the true metres in a '
                            'metre of the poses, from 0.001 to 1000.')
    raise ArgumentError(f'Clocks that are {value:g} s apart are impossible; state seconds up to '
                        '1e10.')


@dataclass(frozen=True)
class Floor:
    """
    The floor that the camera sees, and how high it sits above it.

    Attributes
    ----------
    height_m, sigma_m : float
        Of the camera above the floor, midway along its path; the metre is that of the robot.
    points : int
        Points of the floor.
    tilt_rad : float
        Of the floor against the plane of the motion.

    """

    height_m: float
    sigma_m: float
    points: int
    tilt_rad: float


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
    floor : Floor or NoEstimate, optional
        The floor in view, or why it tells no height; None where it was not asked.
    places : tuple of PlaceAlong
        Where part of the place is open: what is known of it, by directions in the body.
    axis : AxisInCamera, optional
        Where the turn is open about one axis alone: that axis in the camera.
    pose_sigmas : tuple of float
        Standard deviations of x, y, z (m), roll, pitch and yaw (rad) of a pose of the body. Of
        odometry they are those for a metre or a radian of the way.
    camera_frame : str
        Frame of the images; '' where they name none.

    """

    frame: str
    T_body_camera: np.ndarray
    covariance: np.ndarray
    status: dict[str, Status]
    scale: float
    time_offset_s: float
    missing: dict[str, str]
    pose_count: int
    outlier_count: int
    sigma_position_m: float
    sigma_rotation_rad: float
    floor: Floor | NoEstimate | None = None
    places: tuple[PlaceAlong, ...] = ()
    axis: AxisInCamera | None = None
    pose_sigmas: tuple[float, ...] = ()
    camera_frame: str = ''

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of each of `NAMES`: zero where held, infinite where unobservable."""
        return dict(zip(NAMES, np.sqrt(np.diag(self.covariance)).tolist()))

    @property
    def angles(self) -> dict[str, float]:
        """
        Roll, pitch and yaw (rad) against a level camera that looks straight ahead.

        Where only the turn about the vertical of the body is open, roll and pitch are those that
        `axis` tells.
        """
        if self._upright_in_camera is not None:
            return dict(zip(TURN, (*_roll_and_pitch(self._upright_in_camera), np.nan)))
        return dict(zip(TURN, mount_angles(self.T_body_camera[:3, :3])))

    @property
    def _upright_in_camera(self) -> np.ndarray | None:
        """Where the camera has the vertical of the body, if only the turn about it is open."""
        if (self.axis is None or abs(self.axis.axis[2]) <= UPRIGHT
                or not np.isnan(self.T_body_camera[:3, :3]).any()):
            return None
        upright: np.ndarray = self.axis.in_camera * np.sign(self.axis.axis[2])
        return upright

    @property
    def angles_sigma(self) -> dict[str, float]:
        """Standard deviations of `angles` (rad); those of `sigma` where one is not estimated."""
        found = sigmas_of_angles(self.angles, self.covariance[3:6, 3:6], self.status)
        if self._upright_in_camera is not None and self.axis is not None:
            # small turns about axes of the body are none of a camera whose yaw is open
            found['pitch'] = self.axis.sigma
            found['roll'] = self.axis.sigma / max(float(np.cos(self.angles['pitch'])), 1e-9)
        return found


def mount_angles(rotation: np.ndarray) -> tuple[float, float, float]:
    """
    Return roll, pitch and yaw of a camera.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
        Body from optical frame.

    Returns
    -------
    roll, pitch, yaw : float
        Radians; rotation = Rz(yaw) Ry(pitch) Rx(roll) FORWARD. NaN where a matrix has them.

    """
    roll, pitch, yaw = roll_pitch_yaw(rotation @ FORWARD.T).tolist()
    return roll, pitch, yaw


def _roll_and_pitch(upright: np.ndarray) -> tuple[float, float]:
    """Return roll and pitch (rad) of a camera that has the vertical (3,) there."""
    ahead, left, up = (FORWARD @ upright).tolist()
    return float(np.arctan2(left, up)), float(np.arctan2(-ahead, np.hypot(left, up)))


def mount_rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Return the rotation (3, 3) that `mount_angles` takes apart."""
    turns: np.ndarray = rotation_matrix(np.diag([roll, pitch, yaw]))
    about_x, about_y, about_z = turns
    rotation: np.ndarray = about_z @ about_y @ about_x @ FORWARD
    return rotation
