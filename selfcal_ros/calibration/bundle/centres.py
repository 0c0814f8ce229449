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
"""Points where the rays from known camera centres meet."""

from __future__ import annotations

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Rays that meet at less than this angle (radians) say nothing of depth.
MINIMUM_PARALLAX = 2e-4
#: Steps from a pixel that has no ray to the middle of the image.
_INWARD_STEPS = 25


def all_rays(camera: Camera, xy: np.ndarray) -> np.ndarray:
    """
    Unit rays (N, 3) of pixels (N, 2); beyond the fold of the lens, those of the nearest inside.

    NaN only where not even the middle of the image has rays.
    """
    rays, middle = camera.rays(xy), camera.K[:2, 2]
    lost = ~np.isfinite(rays).all(axis=1)
    for inward in np.linspace(1, 0, _INWARD_STEPS, endpoint=False)[1:]:
        if not lost.any():
            break
        rays[lost] = camera.rays(middle + inward * (xy[lost] - middle))
        lost = ~np.isfinite(rays).all(axis=1)
    return rays


def points_from_centres(blocks: PointBlocks, directions: np.ndarray,
                        centres: np.ndarray) -> np.ndarray:
    """
    Intersect rays of known origin, least squares of their angles.

    Parameters
    ----------
    blocks : PointBlocks
    directions : ndarray, shape (N, 3)
        Unit world directions.
    centres : ndarray, shape (V, 3)

    Returns
    -------
    ndarray, shape (P, 4)
        Unit homogeneous points.

    """
    Q = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    origin = centres[blocks.view]
    weight = np.ones(len(directions))
    for _ in range(2):
        Qw = Q * weight[:, None, None]
        H = blocks.sum_over_points(Qw) + 1e-12 * np.eye(3)
        b = blocks.sum_over_points(np.einsum('nij,nj->ni', Qw, origin))
        points = np.linalg.solve(H, b[..., None])[..., 0]
        span = np.linalg.norm(points[blocks.point] - origin, axis=1)
        span = np.maximum(span, max(1e-3 * np.median(span), np.finfo(float).tiny))
        # of one for the nearest: else what keeps the equations of parallel rays regular is lost
        weight = (np.minimum.reduceat(span, blocks.first)[blocks.point] / span)**2
    return _homogeneous_points(blocks, directions, centres, points)


def _homogeneous_points(blocks: PointBlocks, directions: np.ndarray, centres: np.ndarray,
                        points: np.ndarray) -> np.ndarray:
    """Put points without parallax, or behind their cameras, far along their mean ray."""
    mean = blocks.sum_over_points(directions)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    spread = np.minimum.reduceat(
        np.einsum('ni,ni->n', directions, mean[blocks.point]), blocks.first)
    ray = points[blocks.point] - centres[blocks.view]
    depth = np.einsum('ni,ni->n', ray, directions)
    ahead = np.minimum.reduceat(depth, blocks.first) > 0
    usable = ahead & (spread < 1 - 0.5 * MINIMUM_PARALLAX**2) & np.isfinite(points).all(axis=1)
    reach = np.median(np.abs(depth[ahead[blocks.point]])) if ahead.any() else 1.0
    far = np.concatenate([mean * 20 * reach, np.ones((len(mean), 1))], axis=1)
    near = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    result: np.ndarray = np.where(usable[:, None], near, far)
    result /= np.linalg.norm(result, axis=1, keepdims=True)
    return result
