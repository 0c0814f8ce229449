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
The path of the camera as others read it: where it was, and how well that is known.

Poses are those of the camera's optical frame in the world (world_T_camera). World and unit are
those of `metric_structure`: the body frame of the first view, z up, and the median step between
successive views. Where the poses of a robot tell the scale, it is the metre. A known object is its
own world, in metres. A camera that only turns has the body frame of its first view, and no unit.

A covariance is that of the pose relative to the first view, whose own is zero; before a known
object, relative to the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens, to_intrinsics
from selfcal_ros.calibration.reconstruction import PosePrecision
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.metric_structure import (
    IN_A_PLANE, metres_a_step, world_and_scale)
from selfcal_ros.calibration.structure.structure_measurement import regression
from selfcal_ros.geometry.chain_inverse import carried_blocks
from selfcal_ros.values.motion import Motion

#: Motion before a known object, and without a path.
OF_AN_OBJECT, TURNING = 'known-object', 'rotation'


@dataclass(frozen=True)
class CameraPath:
    """
    Poses of a camera.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
    rotation : ndarray, shape (V, 3, 3)
        World from camera.
    centre : ndarray, shape (V, 3)
        Of the camera, in the world.
    covariance : ndarray, shape (V, 6, 6), or None
        Of x, y, z, and of small turns about the axes of the world (rad). None where it is not
        known.
    motion : str
        See `Calibration.motion`; it says what the world is.
    metres_a_step : float, optional
        Of the median step between successive views, where the poses of a robot tell: then
        lengths are in metres. Its own error, common to all of them, is not in `covariance`.

    """

    frames: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    covariance: np.ndarray | None
    motion: Motion
    metres_a_step: float | None = None

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.frames)

    @property
    def unit(self) -> str:
        """Of length: 'm', 'step', or '' where there is no length."""
        return {OF_AN_OBJECT: 'm', TURNING: ''}.get(self.motion,
                                                    'step' if self.metres_a_step is None else 'm')


def camera_path(calibration: Calibration) -> CameraPath:
    """
    Return the poses of the camera in every image that was used.

    Parameters
    ----------
    calibration : Calibration
        With its reconstruction.

    Returns
    -------
    CameraPath

    Raises
    ------
    ArgumentError
        If the calibration comes without its reconstruction.

    """
    shape = calibration.reconstructed
    poses = np.asarray(shape.cam_from_world, float)
    rotation = np.swapaxes(poses[:, :, :3], 1, 2)
    centre = -np.einsum('vij,vj->vi', rotation, poses[:, :, 3])
    metres = None
    if calibration.motion != OF_AN_OBJECT:
        metres = metres_a_step(calibration)
        world, scale = world_and_scale(poses, calibration.motion in IN_A_PLANE)
        rotation = world[:, :3] @ rotation
        centre = scale * (metres or 1.0) * (centre - centre[0]) @ world[:, :3].T
    if calibration.motion == TURNING:
        centre = np.zeros_like(centre)
    precision = shape.pose_precision
    covariance = None if precision is None else pose_covariances(precision,
                                                                 calibration.covariance)
    if covariance is not None and metres is not None:
        unit = np.repeat([metres, 1.0], 3)
        covariance = covariance * np.outer(unit, unit)
    return CameraPath(np.asarray(shape.frames), rotation, centre, covariance, calibration.motion,
                      metres)


def pose_covariances(precision: PosePrecision, stated: np.ndarray) -> np.ndarray:
    """
    Return the covariance of every pose.

    Parameters
    ----------
    precision : PosePrecision
    stated : ndarray, shape (k, k)
        Of the camera's parameters: it holds the errors that observations share, too.

    Returns
    -------
    ndarray, shape (V, 6, 6)

    """
    J, C = precision.by_unknowns, precision.covariance
    views = J.shape[0] // 6
    covariance = carried_blocks(J, C, 6)
    lens = Lens.of(precision.camera)
    known, places = len(precision.lens), lens.places(precision.lens)
    inner = C[:known, :known]
    pull = regression(inner, (J @ C[:known].T).T).T.reshape(views, 6, known)
    more = to_intrinsics(stated, lens)[np.ix_(places, places)] - inner
    covariance += np.einsum('vik,kl,vjl->vij', pull, more, pull)
    if precision.own is not None:
        covariance += precision.own
    symmetric: np.ndarray = (covariance + np.swapaxes(covariance, 1, 2)) / 2
    return symmetric


def with_shared_errors(precision: PosePrecision, stated: np.ndarray) -> np.ndarray:
    """
    Return the covariance of the unknowns of the adjustment, errors that observations share in it.

    Parameters
    ----------
    precision : PosePrecision
    stated : ndarray, shape (k, k)
        Of the camera's parameters, with these errors.

    Returns
    -------
    ndarray, shape (n, n)
        What the lens gains the other unknowns follow, as they follow the lens.

    """
    C = np.asarray(precision.covariance)
    lens = Lens.of(precision.camera)
    known, places = len(precision.lens), lens.places(precision.lens)
    pull = regression(C[:known, :known], C[:known]).T
    more = to_intrinsics(stated, lens)[np.ix_(places, places)] - C[:known, :known]
    covariance: np.ndarray = C + pull @ more @ pull.T
    return covariance
