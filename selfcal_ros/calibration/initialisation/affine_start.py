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
A start for scenes that are small beside their distance, where pairs of views tell no rotation.

There the views are affine images, and three or more of them give shape and motion by factoring
(Tomasi, Kanade 1992). Every view is first turned to look at the middle of what it sees. What is
left open is the reversal of depth, in which a cube drawn in outline seems to turn inside out.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.affine.diac import conic_matrix
from selfcal_ros.calibration.bundle.centres import all_rays
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.scene_model import rescaled
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.initialisation.initial_structure import common_axis
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.projective import euclidean, homogeneous, unit
from selfcal_ros.geometry.rotation import align_z
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Views that factoring needs at least, and tracks that a view must share with those that stand.
MIN_VIEWS, MIN_SHARED = 3, 6
#: Alternations between views and points once all views stand.
ALTERNATIONS = 30
#: Least eigenvalue of the metric against the largest: noise may make it smaller, or negative.
LEAST_METRIC = 1e-2
#: Depths the other way round.
_REVERSED = np.diag([1.0, 1.0, -1.0])


def affine_starts(blocks: PointBlocks, xy: np.ndarray, camera: Camera) -> list[SceneState]:
    """
    Start from affine images, under a supposed calibration.

    Parameters
    ----------
    blocks : PointBlocks
    xy : ndarray, shape (N, 2)
        Pixels of the observations in `blocks`.
    camera : Camera

    Returns
    -------
    list of SceneState
        Two, each the other with depths reversed. None where views share too few tracks, or one
        sees all of them at one place.

    """
    rays = all_rays(camera, xy)
    if blocks.view_count < MIN_VIEWS or not np.isfinite(rays).all():
        return []
    facing = _facing(blocks, rays)
    seen = np.einsum('nij,nj->ni', facing[blocks.view], rays)
    if (seen[:, 2] <= 0).any():
        return []
    factors = _factored(blocks, euclidean(seen))
    if factors is None or not factors[0].any(axis=(1, 2)).all():
        return []
    views, offsets, points = _metric(*factors)
    # the nearest scaled rotations
    U, scale, Vt = np.linalg.svd(views, full_matrices=False)
    rows = U @ Vt
    R = np.concatenate([rows, np.cross(rows[:, :1], rows[:, 1:])], axis=1)
    middles = homogeneous(offsets) / scale.mean(axis=1)[:, None]
    places = np.einsum('vji,vj->vi', facing, middles)
    found = []
    for mirror in (np.eye(3), _REVERSED):
        # of a rotation and a point both mirrored, the first two coordinates are the same
        turned = facing.transpose(0, 2, 1) @ mirror @ R @ mirror
        mount = align_z(common_axis(turned[1:] @ turned[0].T))
        to_world = turned[0].T @ mount
        poses = np.concatenate([turned @ to_world, places[..., None]], axis=2)
        found.append(rescaled(SceneState(
            Lens.of(camera), AxisPath.of_poses(mount, poses),
            unit(homogeneous(points @ mirror @ to_world)))))
    return found


def _facing(blocks: PointBlocks, rays: np.ndarray) -> np.ndarray:
    """Rotations (V, 3, 3) that turn each view's z axis to the middle of its unit rays (N, 3)."""
    return np.stack([align_z(one).T for one in blocks.sum_over_views(rays)])


def _factored(blocks: PointBlocks, u: np.ndarray,
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """
    Factor affine images, tracks of which may be seen in some views only.

    The two views that share the most tracks give a frame; others join where they share enough.
    Views and points then give each other by least squares in turns, gross errors with less weight.

    Parameters
    ----------
    blocks : PointBlocks
    u : ndarray, shape (N, 2)

    Returns
    -------
    views : ndarray, shape (V, 2, 3)
    offsets : ndarray, shape (V, 2)
    points : ndarray, shape (P, 3)
        u = views · point + offset. None where views do not hang together.

    """
    sees = np.zeros((blocks.view_count, blocks.point_count), bool)
    sees[blocks.view, blocks.point] = True
    shared = (sees.astype(float) @ sees.T) * (1 - np.eye(len(sees)))
    a, b = np.unravel_index(int(np.argmax(shared)), shared.shape)
    both = sees[a] & sees[b]
    if both.sum() < MIN_SHARED:
        return None
    at = np.zeros((*sees.shape, 2))
    at[blocks.view, blocks.point] = u
    points = np.zeros((blocks.point_count, 3))
    of_two = np.concatenate([at[a, both], at[b, both]], axis=1)
    left, _, _ = np.linalg.svd(of_two - of_two.mean(axis=0), full_matrices=False)
    points[both] = left[:, :3] * np.sqrt(len(left))
    is_placed, stands = both, np.zeros(len(sees), bool)
    stands[[a, b]] = True
    weight = np.ones(len(u))
    while True:
        joined = stands | ((sees & is_placed).sum(axis=1) >= MIN_SHARED)
        cameras = _resected(blocks, u, points, weight * is_placed[blocks.point])
        seen_often = sees[joined].sum(axis=0) >= 2
        points = _intersected(blocks, u, cameras, weight * joined[blocks.view])
        if (joined == stands).all() and (seen_often == is_placed).all():
            break
        stands, is_placed = joined, seen_often
    if not stands.all():
        return None
    for _ in range(ALTERNATIONS):
        cameras = _resected(blocks, u, points, weight)
        points = _intersected(blocks, u, cameras, weight)
        square = np.sum((_affine(blocks, cameras, points) - u)**2, axis=1)
        weight = 1 / (1 + square / (9 * np.median(square) + 1e-300))
    return cameras[:, :, :3], cameras[:, :, 3], points


def _affine(blocks: PointBlocks, cameras: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Images (N, 2) of points (P, 3) by affine cameras (V, 2, 4)."""
    seen: np.ndarray = np.einsum('nij,nj->ni', cameras[blocks.view, :, :3], points[blocks.point])
    seen += cameras[blocks.view, :, 3]
    return seen


def _resected(blocks: PointBlocks, u: np.ndarray, points: np.ndarray, weight: np.ndarray,
              ) -> np.ndarray:
    """Affine cameras (V, 2, 4) from points (P, 3) and their images."""
    known = homogeneous(points[blocks.point])[:, None]
    weighted = weight[:, None, None] * known
    square = blocks.products_by_views(weighted, known)
    right = blocks.products_by_views(weighted, u[:, None])
    solved: np.ndarray = (np.linalg.pinv(square, hermitian=True) @ right).transpose(0, 2, 1)
    return solved


def _intersected(blocks: PointBlocks, u: np.ndarray, cameras: np.ndarray, weight: np.ndarray,
                 ) -> np.ndarray:
    """Points (P, 3) from affine cameras (V, 2, 4) and their images."""
    M = cameras[blocks.view, :, :3]
    weighted = weight[:, None, None] * M.transpose(0, 2, 1)
    square = blocks.sum_over_points(weighted @ M)
    right = blocks.sum_over_points(weighted @ (u - cameras[blocks.view, :, 3])[:, :, None])
    points: np.ndarray = (np.linalg.pinv(square, hermitian=True) @ right)[:, :, 0]
    return points


def _metric(views: np.ndarray, offsets: np.ndarray, points: np.ndarray,
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Choose the frame in which both rows of every view are orthogonal and equally long.

    Linear in the metric L = A Aᵀ of the frame (Hartley, Zisserman, 2nd ed., 18.2.1 and 10.4.2).
    """
    middle = points.mean(axis=0)
    offsets, points = offsets + views @ middle, points - middle
    m, n = views[:, 0], views[:, 1]
    rows = np.concatenate([_products(m, m) - _products(n, n), 2 * _products(m, n)])
    size = np.sum(views**2, axis=(1, 2))
    _, _, Vt = np.linalg.svd(rows / np.concatenate([size, size])[:, None])
    values, vectors = np.linalg.eigh(conic_matrix(Vt[-1]))
    if values.sum() < 0:
        values, vectors = -values[::-1], vectors[:, ::-1]
    frame = vectors * np.sqrt(np.maximum(values, LEAST_METRIC * values[-1]))
    return views @ frame, offsets, points @ np.linalg.inv(frame).T


def _products(m: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return coefficients (V, 6) of mᵀ L n for a symmetric L, upper triangle row by row."""
    i, j = np.triu_indices(3)
    outer = m[:, :, None] * n[:, None]
    both: np.ndarray = (outer + outer.transpose(0, 2, 1))[:, i, j]
    # on the diagonal these are one entry of L, not two
    return both / np.where(i == j, 2, 1)
