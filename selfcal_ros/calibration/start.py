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
A start for the bundle adjustment, in closed form, once a calibration is supposed.

Pairs of views give rotations (E = Kᵀ F K), all rotations together give the axis, and with
rotations known the camera centres follow from one linear system in which the points are
eliminated. Nothing here depends on which pair is taken first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import lsqr

from selfcal_ros.calibration.bundle import BundleState, rescale
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.optimise import PointBlocks
from selfcal_ros.geometry.rotation import align_z, rotation_vector, swing_twist, twist_matrix

#: Matches of a pair that vote on which of the four decompositions lies ahead of both cameras.
VOTERS = 48
#: Rays that meet at less than this angle (radians) say nothing of depth.
MINIMUM_PARALLAX = 2e-4


@dataclass(frozen=True)
class PairGeometry:
    """
    Epipolar geometry of a pair of views.

    Attributes
    ----------
    first, second : int
        View indices.
    F : ndarray, shape (3, 3)
        x_secondᵀ F x_first = 0, pixels.
    xy_first, xy_second : ndarray, shape (M, 2)
        Inlying matches, pixels.

    """

    first: int
    second: int
    F: np.ndarray
    xy_first: np.ndarray
    xy_second: np.ndarray


def relative_rotations(pairs: list[PairGeometry], camera: Camera) -> np.ndarray:
    """
    Rotation of every pair's second view against its first, for a supposed calibration.

    Parameters
    ----------
    pairs : list of PairGeometry
    camera : Camera

    Returns
    -------
    ndarray, shape (len(pairs), 3, 3)

    """
    E = camera.K.T @ np.array([pair.F for pair in pairs]) @ camera.K
    U, _, Vt = np.linalg.svd(E)
    U = U * np.sign(np.linalg.det(U))[:, None, None]
    Vt = Vt * np.sign(np.linalg.det(Vt))[:, None, None]
    W = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    candidates = np.stack([U @ W @ Vt, U @ W.T @ Vt], axis=1)          # (n, 2, 3, 3)
    rays = np.full((2, len(pairs), VOTERS, 3), np.nan)
    for k, pair in enumerate(pairs):
        chosen = np.linspace(0, len(pair.xy_first) - 1, VOTERS).astype(int)
        for side, xy in enumerate((pair.xy_first, pair.xy_second)):
            rays[side, k] = homogeneous(camera.normalised(xy[chosen]))
    turned = np.einsum('kcij,knj->kcni', candidates, rays[0])
    other = np.broadcast_to(rays[1][:, None], turned.shape)
    t = np.broadcast_to(U[:, None, None, :, 2], turned.shape)
    normal = np.cross(other, turned)
    with np.errstate(invalid='ignore'):
        ahead_first = np.sum(np.cross(other, t) * normal, axis=-1) < 0     # z x' × Rx = -x' × t
        ahead_second = np.sum(np.cross(turned, t) * normal, axis=-1) < 0
    # of ±t the better one counts
    votes = np.maximum((ahead_first & ahead_second).sum(-1),
                       (~ahead_first & ~ahead_second).sum(-1))
    return candidates[np.arange(len(pairs)), np.argmax(votes, axis=1)]


def common_axis(rotations: np.ndarray) -> np.ndarray:
    """
    Axis that rotations (n, 3, 3) share best, unit, its sign that of the first large rotation.

    The principal direction of the rotation vectors, so that small rotations weigh little.
    """
    vectors = rotation_vector(rotations)
    _, directions = np.linalg.eigh(vectors.T @ vectors)
    axis = directions[:, -1]
    # one re-weighting: pairs whose axis is far off are wrong pairs
    length = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
    off = np.linalg.norm(np.cross(axis, vectors), axis=1) / length
    weighted = vectors / (1 + (off / 0.2)**2)[:, None]
    _, directions = np.linalg.eigh(weighted.T @ weighted)
    axis = directions[:, -1]
    return axis * (np.sign(axis @ vectors[np.argmax(length)]) or 1.0)


def planar_angles(pairs: list[PairGeometry], rotations: np.ndarray, axis: np.ndarray,
                  views: int) -> np.ndarray:
    """
    Angle of every view about the axis, view 0 at zero, from all pairs at once.

    Parameters
    ----------
    pairs : list of PairGeometry
    rotations : ndarray, shape (len(pairs), 3, 3)
    axis : ndarray, shape (3,)
    views : int

    Returns
    -------
    ndarray, shape (views,)
        Radians.

    """
    frame = align_z(axis)
    twist, _ = swing_twist(frame.T @ rotations @ frame)
    n = len(pairs)
    rows = np.repeat(np.arange(n), 2)
    columns = np.array([[p.first, p.second] for p in pairs]).ravel()
    weight = np.sqrt([len(p.xy_first) for p in pairs])
    # wide pairs wrap: chain the narrow ones first, then bring all to the same turn
    angles = _chain(pairs, twist, views)
    expected = np.array([angles[p.second] - angles[p.first] for p in pairs])
    twist = twist + 2 * np.pi * np.round((expected - twist) / (2 * np.pi))
    for _ in range(4):
        matrix = coo_matrix((np.tile([-1.0, 1.0], n) * np.repeat(weight, 2), (rows, columns)),
                            shape=(n, views)).tocsr()
        angles = lsqr(matrix, twist * weight, atol=1e-12, btol=1e-12)[0]
        angles -= angles[0]
        error = np.array([angles[p.second] - angles[p.first] for p in pairs]) - twist
        spread = 1.5 * np.median(np.abs(error)) + 1e-6
        weight = np.sqrt([len(p.xy_first) for p in pairs]) / (1 + (error / (3 * spread))**2)
    return angles


def _chain(pairs, twist, views) -> np.ndarray:
    """Angles along the best-supported path from view 0."""
    angles = np.zeros(views)
    known = {0}
    order = sorted(range(len(pairs)), key=lambda k: (abs(pairs[k].second - pairs[k].first),
                                                     -len(pairs[k].xy_first)))
    progress = True
    while progress:
        progress = False
        for k in order:
            a, b = pairs[k].first, pairs[k].second
            if (a in known) != (b in known):
                if a in known:
                    angles[b] = angles[a] + twist[k]
                else:
                    angles[a] = angles[b] - twist[k]
                known |= {a, b}
                progress = True
                break
    return angles


def homogeneous(xy: np.ndarray) -> np.ndarray:
    """Append one to points (..., 2)."""
    return np.concatenate([xy, np.ones(xy.shape[:-1] + (1,))], axis=-1)


def centres_and_points(blocks: PointBlocks, directions: np.ndarray, dimensions: int = 2,
                       iterations: int = 4) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Camera centres and points from rays of known direction, in one linear system.

    Minimises Σ weight² |(I - d dᵀ)(Y_j - C_i)|² with C_0 = 0 and Σ|C_i|² = 1: the points are
    eliminated, the centres are the least eigenvector. Weights turn distances into angles and
    drop rays that do not meet, and are found in a few rounds.

    Parameters
    ----------
    blocks : PointBlocks
    directions : ndarray, shape (N, 3)
        Unit world directions of the rays.
    dimensions : {2, 3}
        2: the centres lie in the plane z = 0.
    iterations : int

    Returns
    -------
    centres : ndarray, shape (V, 3)
    points : ndarray, shape (P, 4)
        Unit homogeneous.

    """
    n, views = len(directions), blocks.view_count
    Q = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    weight = np.ones(n)
    none = np.zeros((n, 3, 0))
    centres = points = None
    for _ in range(iterations):
        Qw = Q * weight[:, None, None]
        system = blocks.reduce(none, -Qw[:, :, :dimensions], Qw, np.zeros((n, 3)))
        S = system.matrix[dimensions:, dimensions:]
        if not np.isfinite(S).all():
            return None
        _, vectors = np.linalg.eigh(S)
        step = np.r_[np.zeros(dimensions), vectors[:, 0]]
        points = system.point_steps(step)
        centres = np.zeros((views, 3))
        centres[:, :dimensions] = step.reshape(views, dimensions)
        ray = points[blocks.point] - centres[blocks.view]
        depth = np.einsum('ni,ni->n', ray, directions)
        if np.sum(np.sign(depth) * weight / weight.max()) < 0:
            centres, points, ray, depth = -centres, -points, -ray, -depth
        span = np.linalg.norm(ray, axis=1)
        miss = np.linalg.norm(np.einsum('nij,nj->ni', Q, ray), axis=1) / np.maximum(span, 1e-12)
        scale = 2.5 * np.median(miss) + 1e-7
        reach = np.median(span)
        weight = 1 / np.clip(span, 0.05 * reach, 50 * reach) / (1 + (miss / scale)**2)
        weight = np.where(depth > 0, weight, 0.05 * weight)
    return centres, _homogeneous_points(blocks, directions, centres, points)


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
        weight = 1 / np.maximum(span, 1e-3 * np.median(span))**2
    return _homogeneous_points(blocks, directions, centres, points)


def centres_from_state(state: BundleState) -> np.ndarray:
    """Camera centres in the world, shape (V, 3)."""
    return -np.einsum('vji,vj->vi', state.rotations(), state.views[:, [1, 2, 5]])


def _homogeneous_points(blocks, directions, centres, points) -> np.ndarray:
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
    result = np.where(usable[:, None], near, far)
    return result / np.linalg.norm(result, axis=1, keepdims=True)


def planar_start(pairs: list[PairGeometry], blocks: PointBlocks, xy: np.ndarray,
                 camera: Camera) -> BundleState | None:
    """
    Start for planar motion under a supposed calibration.

    Parameters
    ----------
    pairs : list of PairGeometry
        They must connect all views.
    blocks : PointBlocks
    xy : ndarray, shape (N, 2)
        Pixels of the observations in `blocks`.
    camera : Camera

    Returns
    -------
    BundleState or None
        None where the calibration cannot be (points that cannot be undistorted, no solution).

    """
    views = blocks.view_count
    rotations = relative_rotations(pairs, camera)
    axis = common_axis(rotations)
    angles = planar_angles(pairs, rotations, axis, views)
    mount = align_z(axis)
    rays = homogeneous(camera.normalised(xy))
    if not np.isfinite(rays).all():
        return None
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    turn = twist_matrix(angles)
    directions = np.einsum('nji,nj->ni', turn[blocks.view], rays @ mount)
    solved = centres_and_points(blocks, directions)
    if solved is None:
        return None
    centres, points = solved
    values = np.zeros((views, 6))
    values[:, 0] = angles
    values[:, [1, 2]] = -np.einsum('vij,vj->vi', turn, centres)[:, :2]
    f, fy, cx, cy, skew, k1, k2, p1, p2 = camera.parameters
    state = BundleState(np.array([f, fy / f, cx, cy, skew, k1, k2, p1, p2]), mount, values,
                        points)
    return rescale(state)
