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
What a mount predicts of the body's poses, and the derivatives.

The camera is at (R, c) in the world of its images. That world has the scale s, and the turn G and
the place g in the world of the robot. With the mount (M, t) the body is turned by G R Mᵀ and
placed at

    (s G c + g - G R Mᵀ t) / κ,

with κ true metres in a metre of the poses. The images' own deviations w
are unknowns like the others, so that errors of both sides count where they arise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.mounting.body_track import BodyAt
from selfcal_ros.calibration.mounting.camera_poses import CameraPoses
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.rotation import rotation_matrix, rotation_vector

#: Columns of the unknowns: place of the camera, small turn of it about the body's axes, logarithm
#: of the scale, offset of the clocks, logarithm of κ, the world of the images in the robot's, and
#: how late the places of the poses are behind their turns.
T, TURN, SCALE, OFFSET, METRE = slice(0, 3), slice(3, 6), 6, 7, 8
WORLD_TURN, WORLD_PLACE, LAG, COUNT = slice(9, 12), slice(12, 15), 15, 16


@dataclass(frozen=True)
class State:
    """
    Values of the unknowns.

    Attributes
    ----------
    place : ndarray, shape (3,)
        Of the camera in the body, metres.
    turn : ndarray, shape (3, 3)
        Body from camera.
    log_scale : float
        Of metres in the unit of the camera's poses.
    offset : float
        Camera clock minus body clock, seconds.
    log_metre : float
        Of true metres in a metre of the body's poses.
    world_turn : ndarray, shape (3, 3)
        The robot's world from that of the images.
    world_place : ndarray, shape (3,)
    w : ndarray, shape (k,)
        See `CameraPoses`.
    lag : float
        By which the places of the poses are late, beside their turns, seconds.

    """

    place: np.ndarray
    turn: np.ndarray
    log_scale: float
    offset: float
    log_metre: float
    world_turn: np.ndarray
    world_place: np.ndarray
    w: np.ndarray
    lag: float = 0.0

    def moved(self, step: np.ndarray) -> State:
        """Return the state after a step (16 + k,)."""
        return replace(
            self, place=self.place + step[T], turn=rotation_matrix(step[TURN]) @ self.turn,
            log_scale=self.log_scale + step[SCALE], offset=self.offset + step[OFFSET],
            log_metre=self.log_metre + step[METRE],
            world_turn=rotation_matrix(step[WORLD_TURN]) @ self.world_turn,
            world_place=self.world_place + step[WORLD_PLACE], w=self.w + step[COUNT:],
            lag=self.lag + step[LAG])


@dataclass(frozen=True)
class Prediction:
    """
    Misfits of the body's poses to a state, and their derivatives.

    Attributes
    ----------
    residual : ndarray, shape (m, 6)
        Measured minus predicted: place (m), small turn (rad). Absolute poses: in the axes of the
        robot's world; odometry: in those of the earlier body of a pair.
    slopes : ndarray, shape (m, 6, 16 + k)
        Minus their derivatives: those of what is predicted.

    """

    residual: np.ndarray
    slopes: np.ndarray


def predict(state: State, camera: CameraPoses, body: BodyAt, odometry: bool) -> Prediction:
    """
    Hold a state against the poses of the body.

    Parameters
    ----------
    state : State
    camera : CameraPoses
        Of V images.
    body : BodyAt
        Measured, at `state.offset`.
    odometry : bool
        Compare each pose with the one before, not each by itself.

    Returns
    -------
    Prediction

    """
    rotation, position, turns, moves = _body_and_slopes(state, camera)
    # a measured pose moves with the offset, which the prediction does not
    turned, moved = np.zeros_like(turns), np.zeros_like(moves)
    turned[:, :, OFFSET], moved[:, :, OFFSET] = -body.turning, -body.velocity
    moved[:, :, LAG] = body.velocity
    places = body.position + state.lag * body.velocity
    if odometry:
        rotation, position, turns, moves = _steps(rotation, position, turns, moves)
        R, p, turned, moved = _steps(body.rotation, places, turned, moved)
    else:
        R, p = body.rotation, places
    off = rotation_vector(R @ np.swapaxes(rotation, 1, 2))
    return Prediction(np.concatenate([p - position, off], axis=1),
                      np.concatenate([moves - moved, turns - turned], axis=1))


def _body_and_slopes(state: State, camera: CameraPoses) -> tuple[
        np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rotations and positions of the body, small turns and moves by the unknowns."""
    views, count = len(camera), COUNT + camera.roots.shape[2]
    R, c = camera.moved(state.w)
    G, scale, metre = state.world_turn, np.exp(state.log_scale), np.exp(state.log_metre)
    rotation = G @ R @ state.turn.T
    spread = scale * c @ G.T
    arm = rotation @ state.place
    position = (spread + state.world_place - arm) / metre
    turns, moves = np.zeros((views, 3, count)), np.zeros((views, 3, count))
    turns[:, :, TURN] = -rotation
    turns[:, :, WORLD_TURN] = np.eye(3)
    turns[:, :, COUNT:] = G @ camera.roots[:, 3:]
    moves[:, :, T] = -rotation
    moves[:, :, SCALE] = spread
    moves[:, :, METRE] = -metre * position
    moves[:, :, WORLD_TURN] = -cross_matrix(spread)
    moves[:, :, WORLD_PLACE] = np.eye(3)
    moves[:, :, COUNT:] = scale * (G @ camera.roots[:, :3])
    # the arm from body to camera swings with the body
    moves += cross_matrix(arm) @ turns
    return rotation, position, turns, moves / metre


def _steps(rotation: np.ndarray, position: np.ndarray, turns: np.ndarray,
           moves: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the same of each pose in the frame of the one before."""
    back = np.swapaxes(rotation[:-1], 1, 2)
    ahead = np.diff(position, axis=0)
    return (back @ rotation[1:], np.einsum('vij,vj->vi', back, ahead),
            back @ (turns[1:] - turns[:-1]),
            back @ (moves[1:] - moves[:-1] + cross_matrix(ahead) @ turns[:-1]))
