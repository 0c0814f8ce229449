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
Does a slight turn tell a camera from one that hangs upside down?

A vehicle that drives ahead shows where ahead is in the camera, and its path lies in a plane. Which
side of that plane is up comes from the sense of the turns alone: a camera that is turned by half a
turn about the way sees right for left. Odometry that errs by as much as the robot turned does not
tell the two apart. Locally both are sharp, so that no covariance shows it. Hence both are fitted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.mounting.adjustment import Adjustment
from selfcal_ros.calibration.mounting.body_track import BodyAt
from selfcal_ros.calibration.mounting.model import State
from selfcal_ros.calibration.mounting.optimum import Optimum
from selfcal_ros.calibration.mounting.pose_errors import SHOWS
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector

#: Bodies that turned by more tell right from left, radians.
TURNED_RAD = np.radians(30.0)
#: Twice the logarithm of how much likelier the one is must be more. Where the turns say s sigmas
#: of their sense, it is a Gaussian of mean 4 s² and sigma 4 s: it reaches the negative of this
#: for the wrong sense once in two million at most.
TOLD = 24.0
#: Among the components of a misfit.
HEADING = 5
#: Squared misfits (six components each, in sigmas) that most poses must not have.
IMPOSSIBLE = 36.0


def open_sense(adjustment: Adjustment, optimum: Optimum, body: BodyAt) -> np.ndarray | None:
    """
    Return the way along which the camera may as well be turned over, if there is one.

    Parameters
    ----------
    adjustment : Adjustment
    optimum : Optimum
    body : BodyAt
        Poses of the body at the images.

    Returns
    -------
    ndarray, shape (3,), or None
        Unit vector in the body; None where the turns tell.

    """
    turned = rotation_vector(np.swapaxes(body.rotation[:1], 1, 2) @ body.rotation)
    if np.linalg.norm(turned, axis=1).max() > TURNED_RAD:
        return None
    moves = np.diff(body.position, axis=0)
    ahead = np.einsum('vji,vj->vi', body.rotation[:-1], moves)
    way = np.linalg.svd(ahead, full_matrices=False)[2][0]
    # far from the body its lever would make an explanation of errors of the images
    near = adjustment.held_along(np.eye(3))
    upright = near.optimum(optimum.state, optimum.errors)
    state = _turned_over(upright.state, body, way)
    errors = upright.errors.from_medians(near.predict(state).residual, upright.keep)
    state, _ = near.descend(state, errors)
    if (np.median(near.distances(state, errors)) > IMPOSSIBLE
            or _apart_rad(state, upright.state) < np.pi / 2):
        return None
    over = near.optimum(state, errors)
    keep = upright.keep & over.keep
    alike = alike_in_a_row(upright)
    # errors that are alike tell as much as fewer ones
    gain = (near.misfit(over, keep) - near.misfit(upright, keep)) * (1 - alike) / (1 + alike)
    return way if gain < TOLD else None


def alike_in_a_row(optimum: Optimum) -> float:
    """Return the correlation of successive errors of the heading, zero where none shows."""
    errors = optimum.prediction.residual[optimum.keep, HEADING]
    ways = optimum.errors.shapes[:, optimum.keep, HEADING, HEADING].sum(axis=0)
    # of the same size, however long their ways are
    errors = errors / np.sqrt(ways)
    found = float(errors[1:] @ errors[:-1] / max(errors @ errors, 1e-300))
    return found if found > SHOWS / np.sqrt(len(errors)) else 0.0


def _apart_rad(one: State, other: State) -> float:
    """Return the angle between the turns of two mounts."""
    return float(np.linalg.norm(rotation_vector(one.turn @ other.turn.T)))


def _turned_over(state: State, body: BodyAt, way: np.ndarray) -> State:
    """Return a state whose camera is turned by half a turn about the way (3,) of the body."""
    over = rotation_matrix(np.pi * way)
    middle = len(body.rotation) // 2
    B, centre = body.rotation[middle], body.position.mean(axis=0)
    world = B @ over @ B.T
    return replace(state, turn=over @ state.turn, place=over @ state.place,
                   world_turn=world @ state.world_turn,
                   world_place=centre + world @ (state.world_place - centre))
