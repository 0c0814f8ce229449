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
The known components of a pose that is partly unobservable: along which directions.

A motion leaves directions in space open, which need not be axes. A camera that is pitched may not
know its height, and so neither its y nor its z, but well a mixture of both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.rotation import angle_sigmas
from selfcal_ros.values.parameter_status import Status


@dataclass(frozen=True)
class PlaceAlong:
    """
    The place of a camera along a direction.

    Attributes
    ----------
    direction : ndarray, shape (3,)
        Unit vector in the frame in which the camera sits.
    value, sigma : float
        The place's component in this direction, in the unit of the pose.

    """

    direction: np.ndarray
    value: float
    sigma: float

    def as_dict(self) -> dict[str, object]:
        """Return it as values for JSON."""
        return {'direction': self.direction, 'value': self.value, 'sigma': self.sigma}


@dataclass(frozen=True)
class AxisInCamera:
    """
    An axis about which the turn of a camera is open, and where the camera has it.

    Attributes
    ----------
    axis : ndarray, shape (3,)
        Unit vector in the body.
    in_camera : ndarray, shape (3,)
        The same in the optical frame.
    sigma : float
        Of either small turn across the axis, radians.

    """

    axis: np.ndarray
    in_camera: np.ndarray
    sigma: float

    def as_dict(self) -> dict[str, object]:
        """Return it as values for JSON."""
        return {'axis': self.axis, 'in_camera': self.in_camera, 'sigma': self.sigma}


def places_along(place: np.ndarray, covariance: np.ndarray, open_along: np.ndarray,
                 limit: float) -> tuple[PlaceAlong, ...]:
    """
    Take a place apart into components whose errors are independent.

    Parameters
    ----------
    place : ndarray, shape (3,)
    covariance : ndarray, shape (3, 3)
        Of the place; what it says along open directions does not count.
    open_along : ndarray, shape (n, 3)
        Orthogonal unit vectors along which nothing is known.
    limit : float
        Components with a larger sigma are open, too.

    Returns
    -------
    tuple of PlaceAlong
        The best known first.

    """
    across = np.linalg.svd(open_along, full_matrices=True)[2][len(open_along):]
    squares, turns = np.linalg.eigh(across @ covariance @ across.T)
    found = []
    for square, direction in zip(squares, turns.T @ across):
        # the sign that looks along the axes
        direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
        if square < limit**2:
            found.append(PlaceAlong(direction, float(direction @ place),
                                    float(np.sqrt(max(square, 0.0)))))
    return tuple(found)


def sigmas_of_angles(angles: Mapping[str, float], covariance: np.ndarray,
                     status: Mapping[str, Status]) -> dict[str, float]:
    """
    Return the standard deviations of roll, pitch and yaw, radians.

    Parameters
    ----------
    angles : mapping of str to float
        Roll, pitch and yaw by name, radians.
    covariance : ndarray, shape (3, 3)
        Of a small turn about fixed axes, rad².
    status : mapping of str to str
        Where one is not 'estimated', those of the small turn are returned.

    """
    if any(status[name] != 'estimated' for name in angles):
        sigmas = np.sqrt(np.diag(covariance))
    else:
        _, pitch, yaw = angles.values()
        sigmas = angle_sigmas(pitch, yaw, covariance)
    return dict(zip(angles, sigmas.tolist()))
