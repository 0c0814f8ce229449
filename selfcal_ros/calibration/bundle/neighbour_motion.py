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

Views of a video are chosen far apart; the images between them say how fast the camera was. At
each view the points are known, so that velocity and acceleration of the camera, six numbers
each, follow from the positions in the two neighbouring images. Their rows count, too: those
images were read like all others.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.zoom import projection
from selfcal_ros.geometry.optimise import huber_weights, PointBlocks
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.geometry.rotation import rotation_matrix

#: Views with fewer points that were followed tell nothing of their motion.
LEAST_FOLLOWED = 15
#: Residuals beyond so many sigmas weigh less.
HUBER = 2.0
_ITERATIONS = 4


def motion_from_neighbours(state: SceneState, blocks: PointBlocks, xy: np.ndarray,
                           neighbours: np.ndarray,
                           delays_of: Callable[[np.ndarray], np.ndarray],
                           ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    delays_of : callable
        When pixels (M, 2) are read after the instant of their image, over the line delay, (M,).

    Returns
    -------
    velocity, acceleration : ndarray, shape (V, 6)
        Of rotation vector (3) and centre (3) in the frame of the view, before the mount.
    known : ndarray of bool, shape (V,)
        False where too few points were followed.

    """
    view, path = blocks.view, state.path
    placed, weight = state.placed_ahead(blocks, xy)
    there = np.isfinite(neighbours).all(axis=2)
    followed = there.all(axis=1)
    count = np.bincount(view[followed], minlength=blocks.view_count)
    motion = np.zeros((blocks.view_count, 12))
    own = state.line_delay * delays_of(xy)
    row = np.flatnonzero(followed)
    sum_of = csr_array((np.ones(len(row)), (view[row], np.arange(len(row)))),
                       shape=(blocks.view_count, len(row)))
    sides = [(neighbours[row, side, 2]
              + state.line_delay * delays_of(neighbours[row, side, :2]),
              neighbours[row, side, :2] - xy[row]) for side in (0, 1)]

    def seen(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (M, 2) at a time after the instant, and derivatives (M, 2, 12)."""
        powers = np.column_stack([time, 0.5 * time**2])
        moved = np.einsum('mp,mpk->mk', powers, motion[view[row]].reshape(-1, 2, 6))
        R = rotation_matrix(moved[:, :3])
        X = np.einsum('mij,mj->mi', R, placed[row] - weight[row] * moved[:, 3:])
        pixels = projection(state.lens, X @ path.mount.T, state.zoom, view[row])
        J = pixels.by_points() @ path.mount
        by_move = np.concatenate([-J @ cross_matrix(X), -J @ R * weight[row][:, :, None]], axis=2)
        return pixels.uv, np.concatenate([by_move * powers[:, :1, None],
                                          by_move * powers[:, 1:, None]], axis=2)

    for _ in range(_ITERATIONS):
        matrix, slope = np.zeros((blocks.view_count, 144)), np.zeros((blocks.view_count, 12))
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
        motion = motion - np.linalg.solve(normal, slope[:, :, None])[:, :, 0]
    return motion[:, :6], motion[:, 6:], count >= LEAST_FOLLOWED
