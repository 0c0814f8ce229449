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
"""The filter at a start: how uncertain a guess is, in place and in velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError
from selfcal_ros.rorapid.estimation.kalman_filter import ConstantVelocityFilter
from selfcal_ros.rorapid.options import TrackerOptions
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, Projection
from selfcal_ros.rorapid.projection.motion_models import recentring

#: Uncertainty of a first guess: share of the distance, diameters across, and radians.
_START_FRACTION, _START_DIAMETERS, _START_RAD = 0.02, 0.1, 0.05
#: Unknown first velocity: diameters of the object, and radians, per second.
_START_SPEED, _START_TURN = 2.0, 1.0
#: Random walk of what a restricted motion does not change, per square root of a second.
_RANDOM_WALK_RAD, _RANDOM_WALK_DIAMETERS = 2e-3, 1e-3
#: Takes (theta, Delta) to (t, r), and back.
TURN_LAST = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])


def checked_start(rotation: ArrayLike, translation: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a pose as arrays, its rotation made exactly orthogonal.

    Raises
    ------
    ArgumentError
        If it is no pose.

    """
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    if rotation.shape != (3, 3) or translation.shape != (3,) or not (
            np.isfinite(rotation).all() and np.isfinite(translation).all()):
        raise ArgumentError('A start pose is a 3x3 rotation and three finite metres.')
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-2 or np.linalg.det(rotation) < 0:
        raise ArgumentError('The rotation of the start pose is not a rotation matrix.')
    U, _, Vt = np.linalg.svd(rotation)
    return U @ Vt, translation


def start_covariance(rotation: np.ndarray, centred: np.ndarray, centre: np.ndarray,
                     diameter_m: float, covariance: ArrayLike | None) -> np.ndarray:
    """
    Covariance (6, 6) of (theta, Delta) of a guess, about the object's middle.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
    centred, centre : ndarray, shape (3,)
        The object's middle, in the frame of the camera and in its own.
    diameter_m : float
    covariance : array_like, shape (6, 6), optional
        Of (tx ty tz rx ry rz); None: what guesses are worth.

    Raises
    ------
    ArgumentError
        If the object is behind the camera, or the covariance is none.

    """
    if not centred[2] > 0:
        raise ArgumentError('The start pose puts the object behind the camera (z is not '
                            'positive).')
    if covariance is None:
        # a guess is right to some pixels, however far away the object is
        depth = _START_FRACTION * centred[2]
        lateral = min(depth, _START_DIAMETERS * diameter_m)
        return np.diag(np.square([_START_RAD] * 3 + [lateral, lateral, depth]))
    given = np.asarray(covariance, float)
    if given.shape != (6, 6) or not np.isfinite(given).all():
        raise ArgumentError('The covariance of a start pose is a finite 6x6 matrix.')
    back = np.linalg.inv(recentring(rotation @ centre))
    given = back @ given[TURN_LAST] @ back.T
    spread: np.ndarray = given + np.diag([1e-8] * 3 + [(1e-4 * centred[2])**2] * 3)
    return spread


def started_filter(projection: Projection, basis: np.ndarray, free: int, options: TrackerOptions,
                   diameter: float, state: ObjectPose,
                   covariance: np.ndarray) -> ConstantVelocityFilter:
    """
    Return a Kalman filter at a state with a covariance (6, 6) of (theta, Delta).

    Parameters
    ----------
    projection : Projection
    basis : ndarray, shape (size, m)
        Of the corrections; the object moves in the first `free` of them.
    free : int
    options : TrackerOptions
    diameter : float
        Of the object, metres.
    state : ObjectPose
    covariance : ndarray, shape (6, 6)

    """
    size = projection.size
    full = np.zeros((size, size))
    turn, speed = np.zeros(size), np.zeros(size)
    if size == 8:
        scale = 1 / state.translation[2]
        full[:6, :6] = np.eye(6) * (_START_RAD * scale)**2
        full[6:, 6:] = np.eye(2) * (_START_FRACTION)**2
        speed[:6], speed[6:] = _START_TURN * scale, _START_SPEED * diameter * scale
        turn[:6] = options.acceleration_rad_s2 * scale
        turn[6:] = options.acceleration_m_s2 * scale
    else:
        full[:6, :6] = covariance
        speed[:6] = [_START_TURN] * 3 + [_START_SPEED * diameter] * 3
        turn[:6] = [options.acceleration_rad_s2] * 3 + [options.acceleration_m_s2] * 3
        if size == 7:
            full[6, 6] = 0.15**2
            speed[6], turn[6] = options.zoom_rate_s, options.zoom_rate_s
    B = basis
    speed, turn = (np.sqrt(np.einsum('im,i->m', B**2, sigma**2)) for sigma in (speed, turn))
    random_walk = np.zeros(B.shape[1])
    if free < B.shape[1]:
        wide = np.r_[[_RANDOM_WALK_RAD] * 3, [_RANDOM_WALK_DIAMETERS * diameter] * 3,
                     [0.0] * (size - 6)]
        if size == 8:
            wide = np.full(8, _RANDOM_WALK_DIAMETERS * diameter * scale)
        random_walk[free:] = np.sqrt(np.einsum('im,i->m', B**2, wide**2))[free:]
        speed[free:] = turn[free:] = 0
    return ConstantVelocityFilter(projection, B, state, B.T @ full @ B, speed, turn,
                                  random_walk)
