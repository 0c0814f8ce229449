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
from scipy.sparse import block_diag, csr_array, vstack

from selfcal_ros.calibration.bundle.path import AxisPath, SHARED_NAMES
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.unknowns import Unknowns
from selfcal_ros.calibration.reconstruction import PosePrecision
from selfcal_ros.calibration.structure.metric_structure import middle_steps, world_and_scale
from selfcal_ros.geometry.projective import camera_centres, cross_matrix
from selfcal_ros.geometry.rotation import left_jacobian, pad

#: What moves a view, in the order of the derivatives.
_OWN = ('angle', 'tilt_x', 'tilt_y', 'x', 'y', 'height')


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
    lens, _, _, free = fit.lenses()[0]
    return PosePrecision(lens.camera(), tuple(name for name in lens.names if name in free),
                         csr_array(slopes @ unknowns.selection), fit.independent_covariance)


def path_slopes(path: AxisPath, unknowns: Unknowns) -> tuple[csr_array, csr_array]:
    """
    Differentiate the poses by all unknowns, in the world of the adjustment.

    Returns
    -------
    turns : csr_array, shape (3 V, n)
        Small turns of the cameras about the axes of the world.
    moves : csr_array, shape (3 V, n)
        Of the camera centres.

    """
    views, R = len(path), path.rotations()
    R_back = np.swapaxes(R, 1, 2)
    # the mount turns all cameras and moves none
    axis = np.broadcast_to(unknowns.places(SHARED_NAMES), (views, 2))
    turns, moves = np.zeros((2, views, 3, 8))
    turns[:, :, :2] = -R_back[:, :, :2]
    up = np.array([0.0, 0.0, 1.0])
    turns[:, :, 2] = -up
    moves[:, :, 2] = -np.cross(up, path.centres())
    swings = left_jacobian(pad(path.tilt))
    for k in range(2):
        swing = swings[:, :, k]
        turns[:, :, 3 + k] = -np.einsum('vij,vj->vi', R_back, swing)
        moves[:, :, 3 + k] = np.einsum('vij,vj->vi', R_back, np.cross(swing, path.translation))
    moves[:, :, 5:] = -R_back
    # what no view of such a motion has does not move it
    own = {name: 2 + k for k, name in enumerate(_OWN) if name in unknowns.view_names}
    columns = np.repeat(np.hstack([axis, unknowns.of_views(*own)])[:, None], 3, axis=1).ravel()
    some = [0, 1, *own.values()]
    rows = np.repeat(np.arange(3 * views), len(some))
    by_turns, by_moves = (csr_array((one[..., some].ravel(), (rows, columns)),
                                    (3 * views, len(unknowns))) for one in (turns, moves))
    return by_turns, by_moves


def in_the_world(poses: np.ndarray, turns: csr_array, moves: csr_array,
                 planar: bool) -> csr_array:
    """
    Carry derivatives of poses to the world and the unit of `metric_structure`.

    Parameters
    ----------
    poses : ndarray, shape (V, 3, 4)
        [R | t] in the world of the adjustment.
    turns, moves : csr_array, shape (3 V, n)
        See `path_slopes`.
    planar : bool

    Returns
    -------
    csr_array, shape (6 V, n)
        Of centre and turn.

    """
    views = len(poses)
    world, scale = world_and_scale(poses, planar)
    W = world[:, :3]
    centres = camera_centres(poses)
    placed = scale * (centres - centres[0]) @ W.T
    # the world turns with the first view
    of_world = csr_array(-W) @ turns[:3]
    # and the unit of length goes with the middle step
    shrinks = csr_array((1, turns.shape[1]))
    steps = middle_steps(centres)
    for k in steps:
        along = centres[k + 1] - centres[k]
        along = scale * along / np.linalg.norm(along) / len(steps)
        shrinks -= csr_array(along[None]) @ (moves[3 * k + 3:3 * k + 6] - moves[3 * k:3 * k + 3])
    turned = _for_all(views, np.eye(3)) @ of_world + block_diag([W] * views) @ turns
    moved = (scale * (block_diag([W] * views) @ moves - _for_all(views, W) @ moves[:3])
             + csr_array(placed.reshape(-1, 1)) @ shrinks
             - csr_array(cross_matrix(placed).reshape(-1, 3)) @ of_world)
    # of every view, the centre comes before the turn
    place = np.arange(6 * views).reshape(2, views, 3).swapaxes(0, 1).ravel()
    return csr_array(vstack([moved, turned], format='csr')[place])


def _for_all(views: int, matrix: np.ndarray) -> csr_array:
    """Stack a matrix (3, 3) once for every view, (3 V, 3)."""
    return csr_array(np.tile(matrix, (views, 1)))
