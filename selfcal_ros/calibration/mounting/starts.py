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
Closed-form starts of the mount: rotations first, then place and scale, which are linear.

Relative poses of body (B, b) and camera (A, a) obey B = M A Mᵀ and (I - B) t + s M a = b. Turns
about two axes give M (Park and Martin 1994), the rest is linear (Andreff, Horaud and Espiau
2001). Turns about one axis leave an angle about it, which is
linear with the place and the scale; no turns leave directions. Each is made, robustly, and the
refinement tells which fits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.mounting.body_track import BodyAt
from selfcal_ros.calibration.mounting.camera_poses import CameraPoses
from selfcal_ros.calibration.mounting.model import State
from selfcal_ros.geometry.rotation import (align_z, nearest_rotation, rotation_matrix,
                                           rotation_vector)

#: Images so many apart make pairs.
LAGS = (1, 2, 3, 5, 8, 13, 21, 34)
#: Turns by more leave open which way they went.
HALF_TURN = np.deg2rad(170)
#: Rounds of the reweighted solutions, and the smallest misfit that a weight is taken of, as a
#: share of the median one.
_ROUNDS, _LEAST = 15, 1e-2
#: Singular values below this share of the largest are those of what is left open.
_OPEN = 1e-6


@dataclass(frozen=True)
class Pairs:
    """
    Relative poses of pairs of images.

    Attributes
    ----------
    camera_turn, body_turn : ndarray, shape (m, 3)
        Angle-axis vectors.
    camera_move, body_move : ndarray, shape (m, 3)
        Of the later pose in the axes of the earlier one.

    """

    camera_turn: np.ndarray
    camera_move: np.ndarray
    body_turn: np.ndarray
    body_move: np.ndarray


def pairs_of(camera: CameraPoses, body: BodyAt) -> Pairs:
    """Return relative poses of images that follow each other, near and far."""
    views = len(camera)
    first = np.concatenate([np.arange(views - lag) for lag in LAGS if lag < views])
    second = np.concatenate([np.arange(lag, views) for lag in LAGS if lag < views])

    def relative(rotation: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        back = np.swapaxes(rotation[first], 1, 2)
        return (rotation_vector(back @ rotation[second]),
                np.einsum('vij,vj->vi', back, place[second] - place[first]))
    found = [*relative(camera.rotation, camera.centre), *relative(body.rotation, body.position)]
    clear = (np.linalg.norm(found[0], axis=1) < HALF_TURN) & (
        np.linalg.norm(found[2], axis=1) < HALF_TURN)
    return Pairs(*(one[clear] for one in found))


def starts(camera: CameraPoses, body: BodyAt, offset: float) -> list[State]:
    """
    Return states to refine, one a way of starting.

    Parameters
    ----------
    camera : CameraPoses
    body : BodyAt
        At the same images.
    offset : float
        Of the clocks, by which `body` was asked.

    Returns
    -------
    list of State

    """
    return [_in_the_world(camera, body, M, place, scale, offset)
            for M, place, scale in closed_forms(camera, pairs_of(camera, body)) if scale > 0]


def closed_forms(camera: CameraPoses, pairs: Pairs) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """
    Solve for turn, place and scale, one a way of starting.

    Returns
    -------
    list of (ndarray of shape (3, 3), ndarray of shape (3,), float)
        A scale that is not positive is none.

    """
    turns = [_robust_rotation(pairs.camera_turn, pairs.body_turn)]
    if not camera.has_path:
        return [(turns[0], np.zeros(3), 1.0)]
    turns += _about_one_axis(pairs)
    unit = _size(pairs.body_move) / max(_size(pairs.camera_move), 1e-300)
    turns.append(_robust_rotation(
        np.concatenate([pairs.camera_move * unit, pairs.camera_turn]),
        np.concatenate([pairs.body_move, pairs.body_turn])))
    return [(M, *_place_and_scale(pairs, M, camera.is_metric)) for M in turns]


def _size(vectors: np.ndarray) -> float:
    """Return the root mean square length of vectors (m, 3)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _weights(misfit: np.ndarray) -> np.ndarray:
    """Return weights (m,) that make least squares a sum of lengths."""
    weights: np.ndarray = 1 / np.maximum(misfit, max(_LEAST * np.median(misfit), 1e-12))
    return weights


def _rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the rotation that takes vectors (m, 3) nearest to others (Kabsch)."""
    return nearest_rotation(target.T @ source)


def _robust_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the rotation with the least sum of distances between vectors (m, 3)."""
    weights = np.ones(len(source))
    for _ in range(_ROUNDS):
        M = _rotation(source * weights[:, None], target)
        weights = _weights(np.linalg.norm(target - source @ M.T, axis=1))
    return M


def _robust_solution(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Solve A (m, r, n) x = y (m, r) with the least sum of lengths; what is open is zero."""
    weights = np.ones(len(A))
    count = A.shape[2]
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)
        x = np.linalg.lstsq((A * root[:, None, None]).reshape(-1, count),
                            (y * root[:, None]).ravel(), rcond=_OPEN)[0]
        weights = _weights(np.linalg.norm(y - A @ x, axis=1))
    solved: np.ndarray = x
    return solved


def _place_and_scale(pairs: Pairs, M: np.ndarray, is_metric: bool) -> tuple[np.ndarray, float]:
    """Solve (I - B) t + s M a = b for t and s."""
    A = np.concatenate([np.eye(3) - rotation_matrix(pairs.body_turn),
                        (pairs.camera_move @ M.T)[:, :, None]], axis=2)
    if is_metric:
        return _robust_solution(A[:, :, :3], pairs.body_move - A[:, :, 3]), 1.0
    x = _robust_solution(A, pairs.body_move)
    return x[:3], float(x[3])


def _about_one_axis(pairs: Pairs) -> list[np.ndarray]:
    """Return the turn of the camera from motion whose turns share one axis: none, or one."""
    axes = []
    for turns in (pairs.camera_turn, pairs.body_turn):
        lengths = np.linalg.norm(turns, axis=1, keepdims=True)
        # a few wrong poses must not swing the axis
        steady = turns / np.sqrt(np.maximum(lengths, 1e-9))
        axes.append(np.linalg.svd(steady, full_matrices=False)[2][0])
    ahead = np.sum((pairs.camera_turn @ axes[0]) * (pairs.body_turn @ axes[1]))
    if ahead == 0:
        return []
    to_camera, to_body = align_z(axes[0] * np.sign(ahead)), align_z(axes[1])
    bases = to_body.T @ rotation_matrix(pairs.body_turn) @ to_body
    moves = pairs.camera_move @ to_camera
    A = np.zeros((len(moves), 2, 4))
    A[:, :, :2] = (np.eye(3) - bases)[:, :2, :2]
    A[:, :, 2] = moves[:, :2]
    A[:, 0, 3], A[:, 1, 3] = -moves[:, 1], moves[:, 0]
    x = _robust_solution(A, (pairs.body_move @ to_body)[:, :2])
    about = rotation_matrix(np.array([0, 0, np.arctan2(x[3], x[2])]))
    return [to_body @ about @ to_camera.T]


def _in_the_world(camera: CameraPoses, body: BodyAt, M: np.ndarray, place: np.ndarray,
                  scale: float, offset: float) -> State:
    """Return a state with the world of the images where most poses put it."""
    each = body.rotation @ M @ np.swapaxes(camera.rotation, 1, 2)
    # the pose that agrees with most, then a mean of those near it
    apart = np.linalg.norm(each[:, None] - each[None], axis=(2, 3))
    G = each[np.argmin(np.median(apart, axis=1))]
    for _ in range(_ROUNDS):
        weights = _weights(np.linalg.norm(each - G, axis=(1, 2)))
        G = _rotation(np.eye(3), np.einsum('v,vij->ji', weights, each))
    at = body.position + body.rotation @ place - scale * camera.centre @ G.T
    return State(place, M, float(np.log(scale)), offset, 0.0, G, np.median(at, axis=0),
                 np.zeros(camera.roots.shape[2]))
