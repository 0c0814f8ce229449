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
"""Reprojection of a state's points into its views, with analytic derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.pixel_model import PixelModel
from selfcal_ros.calibration.bundle.state import BundleState, PER_VIEW, SHARED
from selfcal_ros.geometry.optimise import PointBlocks
from selfcal_ros.geometry.projective import tangent_basis
from selfcal_ros.geometry.rotation import left_jacobian, pad, rotation_matrix

#: Depth below which a point counts as behind the camera, relative to its distance.
MINIMUM_DEPTH = 1e-6


@dataclass(frozen=True)
class Linearisation:
    """Residuals (N, 2) in pixels and their Jacobians; `ahead` (N,) is false behind the camera."""

    residual: np.ndarray
    ahead: np.ndarray
    shared: np.ndarray
    view: np.ndarray
    point: np.ndarray


def linearise(state: BundleState, blocks: PointBlocks, xy: np.ndarray, free: np.ndarray,
              jacobians: bool = True) -> Linearisation:
    """
    Project every observation and differentiate.

    Parameters
    ----------
    state : BundleState
    blocks : PointBlocks
        Point and view of every observation.
    xy : ndarray, shape (N, 2)
        Observed pixels.
    free : ndarray of bool, shape (n,)
        Unknowns that are not held; derivatives of held ones may be left at zero.
    jacobians : bool
        False: residuals only.

    Returns
    -------
    Linearisation

    """
    planar = not free[SHARED:].reshape(-1, PER_VIEW)[:, 3:].any()
    rotations = state.rotations()
    translations = state.views[:, [1, 2, 5]]
    R = rotations[blocks.view]
    Y = state.points[blocks.point]
    turned = np.einsum('nij,nj->ni', R, Y[:, :3])
    Z = turned + translations[blocks.view] * Y[:, 3:]
    # a homogeneous point has no sign: take the one that most of its views see ahead
    X = Z @ state.mount.T
    sign = np.sign(blocks.sum_over_points(np.sign(X[:, 2])))[blocks.point]
    depth = X[:, 2]
    ahead = depth * np.where(sign == 0, 1, sign) > MINIMUM_DEPTH
    depth = np.where(np.abs(depth) > 1e-12, depth, 1e-12)
    x, y = X[:, 0] / depth, X[:, 1] / depth
    pixels = PixelModel(state.intrinsics, x, y)
    residual = pixels.uv - xy
    if not jacobians:
        empty = np.empty(0)
        return Linearisation(residual, ahead, empty, empty, empty)

    J_X = pixels.by_points(depth)
    shared = pixels.by_intrinsics(free, SHARED)
    J_Z = J_X @ state.mount
    shared[:, :, 9] = _along_cross(J_Z, np.array([1.0, 0, 0]), Z)
    shared[:, :, 10] = _along_cross(J_Z, np.array([0, 1.0, 0]), Z)

    own = np.empty((len(x), 2, PER_VIEW))
    tilt = pad(state.views[:, 3:5])
    axis = rotation_matrix(tilt)[:, :, 2]
    own[:, :, 0] = _along_cross(J_Z, axis[blocks.view], turned)
    own[:, :, 1] = J_Z[:, :, 0] * Y[:, 3:]
    own[:, :, 2] = J_Z[:, :, 1] * Y[:, 3:]
    if planar:
        own[:, :, 3:] = 0
    else:
        J_tilt = left_jacobian(tilt)
        own[:, :, 3] = _along_cross(J_Z, J_tilt[blocks.view, :, 0], turned)
        own[:, :, 4] = _along_cross(J_Z, J_tilt[blocks.view, :, 1], turned)
        own[:, :, 5] = J_Z[:, :, 2] * Y[:, 3:]

    J_Y = np.concatenate([J_Z @ R, J_Z @ translations[blocks.view][:, :, None]], axis=2)
    point = J_Y @ tangent_basis(state.points)[blocks.point]
    return Linearisation(residual, ahead, shared, own, point)


def _along_cross(J: np.ndarray, axis: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Derivative J (n, 2, 3) along axis × vector, shape (n, 2)."""
    return np.einsum('nij,nj->ni', J, np.cross(axis, vector))
