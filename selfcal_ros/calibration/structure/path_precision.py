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
How the poses of a path move with the unknowns of the bundle adjustment.

The adjustment fixes the gauge in its own way; poses are told relative to the first view, in steps
between views. The chain rule carries one to the other. The world goes with the first view: which
way its axes point is a choice that was made once, and not an estimate.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.path import AxisPath, SHARED_NAMES
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.unknowns import Unknowns
from selfcal_ros.calibration.reconstruction import PosePrecision
from selfcal_ros.calibration.structure.metric_structure import middle_steps, world_and_scale
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.rotation import left_jacobian, pad


def pose_precision(fit: RobustFit, planar: bool) -> PosePrecision:
    """
    Take from an optimum what the covariance of the poses needs.

    Parameters
    ----------
    fit : RobustFit
        Of a rig the poses and the lens are those of its first camera.
    planar : bool
        The axes of the world are those of planar motion.

    Returns
    -------
    PosePrecision

    """
    unknowns = fit.bundle.unknowns
    turns, moves = path_slopes(fit.state.path, unknowns)
    slopes = in_the_world(fit.state.path.cam_from_world(), turns, moves, planar)
    views, n = len(fit.state.path), len(unknowns)
    independent = (unknowns.selection.T @ slopes.reshape(6 * views, n).T).T
    lens, _, _, free = fit.lenses()[0]
    return PosePrecision(lens.camera(), tuple(name for name in lens.names if name in free),
                         independent.reshape(views, 6, -1),
                         fit.covariance[np.ix_(unknowns.members, unknowns.members)])


def path_slopes(path: AxisPath, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """
    Differentiate the poses by all unknowns, in the world of the adjustment.

    Returns
    -------
    turns : ndarray, shape (V, 3, n)
        Small turns of the cameras about the axes of the world.
    moves : ndarray, shape (V, 3, n)
        Of the camera centres.

    """
    views, R = len(path), path.rotations()
    R_back = np.swapaxes(R, 1, 2)
    turns, moves = np.zeros((2, views, 3, len(unknowns)))
    rows = np.arange(views)
    # the mount turns all cameras and moves none
    turns[:, :, unknowns.places(SHARED_NAMES)] = -R_back[:, :, :2]
    place = {name: unknowns.of_views(name)[:, 0]
             for name in ('angle', 'tilt_x', 'tilt_y', 'x', 'y', 'height')}
    up = np.array([0.0, 0.0, 1.0])
    turns[rows, :, place['angle']] = -up
    moves[rows, :, place['angle']] = -np.cross(up, path.centres())
    swings = left_jacobian(pad(path.tilt))
    for axis, name in enumerate(('tilt_x', 'tilt_y')):
        swing = swings[:, :, axis]
        turns[rows, :, place[name]] = -np.einsum('vij,vj->vi', R_back, swing)
        moves[rows, :, place[name]] = np.einsum(
            'vij,vj->vi', R_back, np.cross(swing, path.translation))
    for axis, name in enumerate(('x', 'y', 'height')):
        moves[rows, :, place[name]] = -R_back[:, :, axis]
    return turns, moves


def in_the_world(poses: np.ndarray, turns: np.ndarray, moves: np.ndarray,
                 planar: bool) -> np.ndarray:
    """
    Carry derivatives of poses to the world and the unit of `metric_structure`.

    Parameters
    ----------
    poses : ndarray, shape (V, 3, 4)
        [R | t] in the world of the adjustment.
    turns, moves : ndarray, shape (V, 3, n)
        See `path_slopes`.
    planar : bool

    Returns
    -------
    ndarray, shape (V, 6, n)
        Of centre and turn.

    """
    world, scale = world_and_scale(poses, planar)
    W = world[:, :3]
    centres = -np.einsum('vji,vj->vi', poses[:, :, :3], poses[:, :, 3])
    placed = scale * (centres - centres[0]) @ W.T
    # the world turns with the first view
    of_world = -W @ turns[0]
    # and the unit of length goes with the middle step
    shrinks = np.zeros(turns.shape[2])
    steps = middle_steps(centres)
    for k in steps:
        along = centres[k + 1] - centres[k]
        shrinks -= scale * (along / np.linalg.norm(along)) @ (moves[k + 1] - moves[k]) / len(steps)
    turned = of_world + W @ turns
    moved = (scale * W @ (moves - moves[0]) + placed[:, :, None] * shrinks
             - cross_matrix(placed) @ of_world)
    return np.concatenate([moved, turned], axis=1)
