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
How the camera moves at a view, from where its points were in the images just before and after.

Views of a video are chosen far apart; the images between them say how fast the camera was. At each
view the points are known. So velocity and acceleration of the camera, six numbers each, follow
from the positions in the two neighbouring images. Their rows count, too: those images were read
like all others. A swing of 1 Hz filmed at 30 Hz is slower by 0.7 % between two images than at the
one in their middle. So the third derivative counts, which the velocities and accelerations at the
views around tell.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.calibration.bundle.clock import Clock
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.zoom import projection
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.robust_loss import huber_weights
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Views with fewer points that were followed tell nothing of their motion.
LEAST_FOLLOWED = 15
#: Residuals beyond so many sigmas weigh less.
HUBER = 2.0
_ITERATIONS = 6
#: Before which of them the third derivatives are renewed.
_RENEWED = (1, 2, 3, 4)
#: Views around one that tell its third derivative.
_STENCIL = 3


def followed(neighbours: np.ndarray) -> np.ndarray:
    """Tell which observations were followed to both sides; neighbours (N, 2, 3), shape (N,)."""
    found: np.ndarray = np.isfinite(neighbours).all(axis=(1, 2))
    return found


def motion_from_neighbours(state: SceneState, blocks: PointBlocks, xy: np.ndarray,
                           neighbours: np.ndarray, clock: Clock, motion: np.ndarray,
                           ) -> np.ndarray:
    """
    Estimate how the camera moves at the instant of each view.

    Parameters
    ----------
    state : SceneState
    blocks : PointBlocks
        Point and view of every observation.
    xy : ndarray, shape (N, 2)
        Observed pixels.
    neighbours : ndarray, shape (N, 2, 3)
        Pixels in the images before and after, and intervals from this one; NaN where the point
        was not followed.
    clock : Clock
    motion : ndarray, shape (3, V, 6)
        What the views around tell (`shutter.local_motion`).

    Returns
    -------
    ndarray, shape (3, V, 6)
        Velocity, acceleration and jerk of rotation vector (3) and centre (3) in the frame of the
        view, before the mount; as given where too few points were followed.

    """
    # the last of them may have no observation
    view, path, views = blocks.view, state.path, len(clock.times)
    placed, weight = state.placed_ahead(blocks, xy)
    row = np.flatnonzero(followed(neighbours))
    count = np.bincount(view[row], minlength=views)
    known = count >= LEAST_FOLLOWED
    twist, jerk = np.zeros((views, 12)), np.zeros((views, 6))
    own = state.line_delay * clock.delays(xy)
    sum_of = csr_array((np.ones(len(row)), (view[row], np.arange(len(row)))),
                       shape=(views, len(row)))
    sides = [(neighbours[row, side, 2]
              + state.line_delay * clock.delays(neighbours[row, side, :2]),
              neighbours[row, side, :2] - xy[row]) for side in (0, 1)]

    def seen(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (M, 2) at a time after the instant, and derivatives (M, 2, 12)."""
        powers = np.column_stack([time, 0.5 * time**2])
        moved = np.einsum('mp,mpk->mk', powers, twist[view[row]].reshape(-1, 2, 6))
        moved += (time**3 / 6)[:, None] * jerk[view[row]]
        R = rotation_matrix(moved[:, :3])
        X = np.einsum('mij,mj->mi', R, placed[row] - weight[row] * moved[:, 3:])
        pixels = projection(state.lens, X @ path.mount.T, state.zoom, view[row])
        J = pixels.by_points() @ path.mount
        by_move = np.concatenate([-J @ cross_matrix(X), -J @ R * weight[row][:, :, None]], axis=2)
        return pixels.uv, np.concatenate([by_move * powers[:, :1, None],
                                          by_move * powers[:, 1:, None]], axis=2)

    for k in range(_ITERATIONS):
        if k in _RENEWED:
            jerk = _jerk(path, clock.times, *np.where(known[:, None], [twist[:, :6], twist[:, 6:]],
                                                      motion[:2]))
        matrix, slope = np.zeros((views, 144)), np.zeros((views, 12))
        now, by_now = seen(own[row])
        for time, step in sides:
            later, by_later = seen(time)
            residual, J = later - now - step, by_later - by_now
            sound = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(residual).all(axis=1)
            residual, J = np.where(sound[:, None], residual, 0), np.where(
                sound[:, None, None], J, 0)
            length = np.linalg.norm(residual, axis=1)
            share = sound * huber_weights(
                length / max(robust_sigma(residual.ravel()), 1e-6), HUBER)
            J_weighted = np.swapaxes(J, 1, 2) * share[:, None, None]
            matrix += sum_of @ (J_weighted @ J).reshape(-1, 144)
            slope += sum_of @ (J_weighted @ residual[:, :, None])[:, :, 0]
        normal = matrix.reshape(-1, 12, 12)
        scale = np.einsum('vii->vi', normal)
        floor = 1e-9 * scale.max(axis=1, keepdims=True) + 1e-300
        normal = normal + (1e-9 * scale + floor)[:, :, None] * np.eye(12)
        twist = twist - np.linalg.solve(normal, slope[:, :, None])[:, :, 0]
    found: np.ndarray = np.where(known[:, None], [twist[:, :6], twist[:, 6:], jerk], motion)
    return found


def _jerk(path: AxisPath, times: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray,
          ) -> np.ndarray:
    """
    Return the third derivatives (V, 6) from the first two (V, 6) at each view and its neighbours.

    Of the rotation vector θ from the pose of a view, angular velocity is ω = dθ + θ x dθ / 2 + ...
    So the third derivative of θ there is d²ω - ω x dω / 2.
    """
    views = len(times)
    if views < _STENCIL:
        return np.zeros_like(velocity)
    near = np.clip(np.arange(views) - 1, 0, views - _STENCIL)[:, None] + np.arange(_STENCIL)
    apart = times[near] - times[:, None]
    reach = np.abs(apart).max(axis=1)
    # a polynomial with these values and slopes, in units of the reach
    power, degree = (apart / reach[:, None])[:, None, :], np.arange(2 * _STENCIL)[:, None]
    rows = np.concatenate([power**degree, degree * power**np.maximum(degree - 1, 0)], axis=2)
    weights = np.linalg.solve(rows, np.broadcast_to(
        2.0 * (degree == 2), (views, 2 * _STENCIL, 1)))[:, :, 0] / reach[:, None]**2
    weights[:, _STENCIL:] *= reach[:, None]
    R = path.rotations()

    def second(rate: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Differentiate a rate (V, 3) twice, of which the first derivative is known."""
        known = np.concatenate([rate[near], change[near]], axis=1)
        found: np.ndarray = np.einsum('vs,vsk->vk', weights, known)
        return found

    spin, moving = velocity[:, :3], np.einsum('vji,vj->vi', R, velocity[:, 3:])
    turned = second(spin, acceleration[:, :3]) - np.cross(spin, acceleration[:, :3]) / 2
    moved = second(moving, np.einsum('vji,vj->vi', R, acceleration[:, 3:]))
    return np.concatenate([turned, np.einsum('vij,vj->vi', R, moved)], axis=1)
