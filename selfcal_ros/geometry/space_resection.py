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
The pose of a camera of known lens from points that it sees, by the angles of their rays.

Where the lens is known, `resection` asks for five numbers too many. And it takes pixels for those
of a pinhole, which a fisheye's are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.resection import resect_linear
from selfcal_ros.geometry.robust_loss import huber_weights
from selfcal_ros.geometry.robust_scale import robust_sigma_of_lengths
from selfcal_ros.geometry.rotation import rotation_matrix

#: Three points leave four poses; one more tells them apart.
MIN_POINTS = 4
#: Angles beyond so many robust sigmas weigh less.
HUBER_SIGMAS = 2.0
#: Rays that lie so far ahead have a place in the image of a pinhole (cosine to its axis).
AHEAD = 0.1
#: Steps at most, and the one that is small enough (radians, and depths of the points).
ITERATIONS, SMALL = 40, 1e-9


@dataclass(frozen=True)
class RayPose:
    """
    A pose and how well it explains the rays.

    Attributes
    ----------
    pose : ndarray, shape (3, 4)
        [R | t] of the camera, from the points' frame.
    error_rad : float
        Median angle between measured rays and those to the points.

    """

    pose: np.ndarray
    error_rad: float


def pose_of_rays(points: np.ndarray, rays: np.ndarray) -> RayPose | NoEstimate:
    """
    Find the pose from which points lie along rays, least squares of the angles, gross errors held.

    Parameters
    ----------
    points : ndarray, shape (n, 4)
        Homogeneous; the sign of each puts its last number at or above zero.
    rays : ndarray, shape (n, 3)
        Unit vectors in the camera; NaN for a pixel without a ray.

    Returns
    -------
    RayPose or NoEstimate
        No pose from fewer than four points.

    """
    usable = np.isfinite(rays).all(axis=1)
    points, rays = points[usable], rays[usable]
    if len(points) < MIN_POINTS:
        return NoEstimate('too_few', what='pose', needed=MIN_POINTS, items='points',
                          found=len(points))
    points = points * np.where(points[:, 3:] < 0, -1.0, 1.0)
    return min((_descend(points, rays, start) for start in _starts(points, rays)),
               key=lambda one: one.error_rad)


def _starts(points: np.ndarray, rays: np.ndarray) -> list[np.ndarray]:
    """Return the linear pose, where there is one, and that of the points' frame, (3, 4) each."""
    starts = [np.eye(3, 4)]
    ahead = rays[:, 2] > AHEAD
    P = resect_linear(points[ahead], rays[ahead, :2] / rays[ahead, 2:])
    if isinstance(P, NoEstimate):
        return starts
    U, sizes, Vt = np.linalg.svd(P[:, :3])
    if not sizes[0] > 0:
        return starts
    sign = np.sign(np.linalg.det(U @ Vt))
    return [*starts, np.column_stack([sign * U @ Vt, sign * P[:, 3] / sizes.mean()])]


def _descend(points: np.ndarray, rays: np.ndarray, start: np.ndarray) -> RayPose:
    """Take steps of Gauss and Newton from a pose (3, 4), damped where they do not help."""
    R, t, damping = start[:, :3], start[:, 3], 1e-6
    X, w = points[:, :3], points[:, 3:]
    # lengths are in depths of the points, or steps of turns and of places have no common size
    depth = float(np.median(np.linalg.norm(X, axis=1) / np.maximum(w[:, 0], 1e-12)))
    depth = depth if np.isfinite(depth) and depth > 0 else 1.0
    residual, directions, reach = _angles(X @ R.T + w * t, rays)
    for _ in range(ITERATIONS):
        size = np.linalg.norm(residual, axis=1)
        sigma = max(robust_sigma_of_lengths(size), 1e-12)
        weight = huber_weights(size, HUBER_SIGMAS * sigma)
        across = (np.eye(3) - directions[:, :, None] * directions[:, None, :]) / reach[:, :, None]
        turned = X @ R.T
        slopes = np.concatenate([np.cross(turned[:, None], across),
                                 across * w[:, None] * depth], axis=2)
        H = np.einsum('nij,n,nik->jk', slopes, weight, slopes)
        g = np.einsum('nij,n,ni->j', slopes, weight, residual)
        cost, improved = float(np.sum(weight * size**2)), False
        while damping < 1e6 and not improved:
            step = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-300), -g)
            trial = rotation_matrix(step[:3]) @ R, t + depth * step[3:]
            found = _angles(X @ trial[0].T + w * trial[1], rays)
            improved = float(np.sum(weight * np.sum(found[0]**2, axis=1))) <= cost
            damping *= 0.1 if improved else 10
        if not improved:
            break
        (R, t), (residual, directions, reach) = trial, found
        damping = max(damping, 1e-9)
        if np.abs(step).max() < SMALL:
            break
    return RayPose(np.column_stack([R, t]),
                   float(np.median(np.linalg.norm(residual, axis=1))))


def _angles(seen: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return differences of directions to points (n, 3) from rays, directions and distances."""
    reach = np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-300)
    directions = seen / reach
    return directions - rays, directions, reach
