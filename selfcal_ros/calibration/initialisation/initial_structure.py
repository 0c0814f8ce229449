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

Pairs of views give rotations (E = Kᵀ F K), and all rotations together give the axis and the
angles. With rotations known the direction of every step of the camera follows from rays, and its
length from the points that are known already.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np

from selfcal_ros.calibration.bundle.centres import (all_rays, MINIMUM_PARALLAX,
                                                    points_from_centres)
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.scene_model import rescaled
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.projective import cross_matrix
from selfcal_ros.geometry.rotation import align_z, rotation_vector, swing_twist
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Matches of a pair that vote on which of the four decompositions lies ahead of both cameras.
VOTERS = 48
#: Matches of a pair whose rays tell how it turned.
WITNESSES = 300


@dataclass(frozen=True)
class PairGeometry:
    """
    Epipolar geometry of a pair of views.

    Attributes
    ----------
    first, second : int
        View indices.
    F : ndarray, shape (3, 3)
        x_secondᵀ F x_first = 0, pixels; of straightened ones where the graph's lens is bent
        (homogeneous: `to_units`⁻¹ times what `DivisionModel.lifted` gives).
    track : ndarray of int, shape (M,)
        Index of each inlying match among the tracks that are compared, not its identity.
    xy_first, xy_second : ndarray, shape (M, 2)
        Inlying matches, pixels.

    """

    first: int
    second: int
    F: np.ndarray
    track: np.ndarray
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
    spread = [np.linspace(0, len(pair.track) - 1, VOTERS).astype(int) for pair in pairs]
    if camera.is_pinhole:
        E = camera.K.T @ np.array([pair.F for pair in pairs]) @ camera.K
        rays = _rays_of([(pair.xy_first[rows], pair.xy_second[rows])
                         for pair, rows in zip(pairs, spread)], camera)
    else:
        # a start needs no more; the adjustment of all views follows
        every = [slice(None, None, len(pair.track) // WITNESSES + 1) for pair in pairs]
        of_pairs = _rays_of([(pair.xy_first[rows], pair.xy_second[rows])
                             for pair, rows in zip(pairs, every)], camera)
        E = np.array([essential(*one) for one in of_pairs])
        rays = [(first[rows // step.step], second[rows // step.step])
                for (first, second), rows, step in zip(of_pairs, spread, every)]
    U, _, Vt = np.linalg.svd(E)
    U = U * np.sign(np.linalg.det(U))[:, None, None]
    Vt = Vt * np.sign(np.linalg.det(Vt))[:, None, None]
    W = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    candidates = np.stack([U @ W @ Vt, U @ W.T @ Vt], axis=1)          # (n, 2, 3, 3)
    before, after = (np.array(side) for side in zip(*rays))
    turned = np.einsum('kcij,knj->kcni', candidates, before)
    other = np.broadcast_to(after[:, None], turned.shape)
    t = np.broadcast_to(U[:, None, None, :, 2], turned.shape)
    normal = np.cross(other, turned)
    with np.errstate(invalid='ignore'):
        ahead_first = np.sum(np.cross(other, t) * normal, axis=-1) < 0     # z x' × Rx = -x' × t
        ahead_second = np.sum(np.cross(turned, t) * normal, axis=-1) < 0
    # of ±t the better one counts
    votes = np.maximum((ahead_first & ahead_second).sum(-1),
                       (~ahead_first & ~ahead_second).sum(-1))
    chosen: np.ndarray = candidates[np.arange(len(pairs)), np.argmax(votes, axis=1)]
    return chosen


def _rays_of(pairs: list[tuple[np.ndarray, np.ndarray]], camera: Camera,
             ) -> list[tuple[np.ndarray, np.ndarray]]:
    """Unit rays of the matches (M, 2), (M, 2) of every pair, all at once."""
    if not pairs:
        return []
    parts = np.cumsum([len(side) for pair in pairs for side in pair])[:-1]
    rays = np.split(camera.rays(np.concatenate([side for pair in pairs for side in pair])), parts)
    return list(zip(rays[::2], rays[1::2]))


def essential(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """
    Essential matrix of a pair from rays, which a distorted lens or a wide one has and F has not.

    The linear solution (Longuet-Higgins 1981), weighed anew by the angles between rays and
    epipolar planes.

    Parameters
    ----------
    first, second : ndarray, shape (M, 3)
        Unit rays; those that are NaN count nothing.

    Returns
    -------
    ndarray, shape (3, 3)
        x_secondᵀ E x_first = 0; not projected on the manifold. Zero where no ray counts.

    """
    good = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    if not good.any():
        # a supposed lens that bends back may have rays for none of a pair's matches
        return np.zeros((3, 3))
    a, b = first[good], second[good]
    rows = (b[:, :, None] * a[:, None, :]).reshape(len(a), 9)
    weight = np.ones(len(a))
    for _ in range(5):
        _, vectors = np.linalg.eigh((rows * weight[:, None]).T @ rows)
        E = vectors[:, 0].reshape(3, 3)
        Ea, Eb = a @ E.T, b @ E
        # slopes across the rays alone: along them nothing was measured
        value = np.sum(b * Ea, axis=1)
        square = (np.sum(Ea**2, axis=1) + np.sum(Eb**2, axis=1) - 2 * value**2)
        angle = np.abs(value) / np.sqrt(np.maximum(square, 1e-12))
        weight = 1 / np.maximum(square, 1e-3) / (1 + (angle / (2 * np.median(angle) + 1e-9))**2)
    return E


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
    first, second = np.array([[p.first, p.second] for p in pairs]).T
    matches = np.array([len(p.xy_first) for p in pairs], float)
    weight = matches
    # wide pairs wrap: chain the narrow ones first, then bring all to the same turn
    angles = np.zeros(views)
    for k, old, new in spanning_order(pairs, views):
        angles[new] = angles[old] + (twist[k] if pairs[k].first == old else -twist[k])
    expected = angles[second] - angles[first]
    twist = twist + 2 * np.pi * np.round((expected - twist) / (2 * np.pi))
    for _ in range(4):
        # normal equations: each pair ties two views, and the first view stays
        matrix = np.diag(np.bincount(first, weight, views) + np.bincount(second, weight, views))
        np.subtract.at(matrix, (first, second), weight)
        np.subtract.at(matrix, (second, first), weight)
        matrix += 1e-12 * np.diag(matrix).max() * np.eye(views)
        pull = (np.bincount(second, weight * twist, views)
                - np.bincount(first, weight * twist, views))
        angles = np.append(0.0, np.linalg.solve(matrix[1:, 1:], pull[1:]))
        error = angles[second] - angles[first] - twist
        spread = 1.5 * np.median(np.abs(error)) + 1e-6
        weight = matches / (1 + (error / (3 * spread))**2)**2
    return angles


def spanning_order(pairs: list[PairGeometry], views: int) -> list[tuple[int, int, int]]:
    """
    Order in which views can be attached, each to one that stands already.

    Returns
    -------
    list of (pair index, standing view, new view)
        Neighbours in time first, then pairs with many matches.

    """
    ranked = sorted(range(len(pairs)), key=lambda k: (pairs[k].second - pairs[k].first,
                                                      -len(pairs[k].track)))
    beside: dict[int, list[tuple[int, int, int]]] = {}
    for rank, k in enumerate(ranked):
        for old, new in ((pairs[k].first, pairs[k].second), (pairs[k].second, pairs[k].first)):
            beside.setdefault(old, []).append((rank, old, new))
    # Prim's algorithm: of the pairs that lead on, the first goes next
    order, standing, leading = [], {0}, list(beside.get(0, ()))
    while leading and len(standing) < views:
        rank, old, new = heappop(leading)
        if new in standing:
            continue
        order.append((ranked[rank], old, new))
        standing.add(new)
        for one in beside[new]:
            heappush(leading, one)
    return order


def chained_rotations(pairs: list[PairGeometry], relative: np.ndarray, views: int) -> np.ndarray:
    """Rotations of all views against view 0 along the spanning order, shape (V, 3, 3)."""
    rotations = np.tile(np.eye(3), (views, 1, 1))
    for k, old, new in spanning_order(pairs, views):
        step = relative[k] if pairs[k].first == old else relative[k].T
        rotations[new] = step @ rotations[old]
    return rotations


def chained_centres(pairs: list[PairGeometry], camera: Camera, rotations: np.ndarray, planar: bool,
                    ) -> np.ndarray:
    """
    Camera centres from known rotations, view by view.

    The direction of each step is that of the epipole; its length makes the depths of the points
    that are known already agree (median ratio), and no view can collapse onto another. In a linear
    system for all of them it can.

    Parameters
    ----------
    pairs : list of PairGeometry
    camera : Camera
    rotations : ndarray, shape (V, 3, 3)
        Camera from world; for planar motion the world's z axis is the rotation axis.
    planar : bool
        Keep the centres in the plane z = 0.

    Returns
    -------
    ndarray, shape (V, 3)

    """
    views = len(rotations)
    centres = np.zeros((views, 3))
    last = max(int(pair.track.max()) for pair in pairs) + 1
    position, placed = np.zeros((last, 3)), np.zeros(last, dtype=bool)
    steps: list[float] = []
    steps_to_go = spanning_order(pairs, views)
    seen = _rays_of([(pairs[k].xy_first, pairs[k].xy_second) for k, *_ in steps_to_go], camera)
    for (k, old, new), sides in zip(steps_to_go, seen):
        pair = pairs[k]
        # in directions of the world
        d_old, d_new = (side @ rotations[view] for side, view in zip(
            sides if pair.first == old else sides[::-1], (old, new)))
        valid = np.isfinite(d_old).all(axis=1) & np.isfinite(d_new).all(axis=1)
        d_old, d_new, track = d_old[valid], d_new[valid], pair.track[valid]
        direction = _step_direction(d_old, d_new, planar)
        # depths along the old ray for a step of unit length
        normal = np.cross(d_old, d_new)
        square = np.maximum(np.einsum('ij,ij->i', normal, normal), 1e-18)
        turned = normal @ cross_matrix(direction)
        depth = np.einsum('ij,ij->i', turned, d_new) / square
        depth_new = np.einsum('ij,ij->i', turned, d_old) / square
        if np.sum(np.sign(depth) * square) < 0:
            direction, depth, depth_new = -direction, -depth, -depth_new
        good = (depth > 0) & (depth_new > 0) & (square > MINIMUM_PARALLAX**2)
        both = good & placed[track]
        length = 1.0
        if both.sum() >= 3:
            before = np.sum((position[track[both]] - centres[old]) * d_old[both], axis=1)
            ratio = before / depth[both]
            ratio = ratio[ratio > 0]
            if len(ratio):
                length = float(np.median(ratio))
        elif steps:
            # nothing in common with what stands: the usual step, for the adjustment to mend
            length = float(np.median(steps))
        steps.append(length)
        centres[new] = centres[old] + length * direction
        fresh = good & ~placed[track]
        position[track[fresh]] = centres[old] + length * depth[fresh, None] * d_old[fresh]
        placed[track[fresh]] = True
    return centres


def _step_direction(d_old: np.ndarray, d_new: np.ndarray, planar: bool) -> np.ndarray:
    """Unit direction (3,) of a translation that all rays agree with, by re-weighting."""
    if not len(d_old):
        # a supposed lens that sees no match of the pair: any direction, for the adjustment to mend
        return np.array([1.0, 0.0, 0.0])
    normal = np.cross(d_old, d_new)
    if planar:
        normal = normal[:, :2]
    length = np.sqrt(np.einsum('ij,ij->i', normal, normal))
    weight = np.ones(len(normal))
    for _ in range(5):
        weighted = normal * weight[:, None]
        _, vectors = np.linalg.eigh(weighted.T @ weighted)
        direction = vectors[:, 0]
        # angle of the ray out of the epipolar plane, about
        miss = np.abs(normal @ direction) / np.maximum(length, 1e-4)
        weight = 1 / (1 + (miss / (2 * np.median(miss) + 1e-9))**2)
        weight /= np.maximum(length, 1e-3)
    return np.append(direction, 0.0) if planar else direction


def planar_start(pairs: list[PairGeometry], blocks: PointBlocks, xy: np.ndarray,
                 camera: Camera, exact: bool, relative: np.ndarray | None = None,
                 ) -> SceneState | None:
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
    exact : bool
        True: rotations about one axis only, which noise disturbs least. False: keep the tilt
        that the images show, which a road vehicle's pitch needs.
    relative : ndarray, shape (len(pairs), 3, 3), optional
        Rotation of every pair where it is known; `relative_rotations` by default.

    Returns
    -------
    SceneState or None
        None where the calibration cannot be (points that cannot be undistorted, no solution).

    """
    views = blocks.view_count
    if relative is None:
        relative = relative_rotations(pairs, camera)
    axis = common_axis(relative)
    mount = align_z(axis)
    if exact:
        path = AxisPath.at_origin(mount, planar_angles(pairs, relative, axis, views))
    else:
        twist, swing = swing_twist(mount.T @ chained_rotations(pairs, relative, views) @ mount)
        path = AxisPath.at_origin(mount, np.unwrap(twist), swing)
    rotations = mount @ path.rotations()
    centres = chained_centres(pairs, camera, rotations, planar=exact)
    rays = all_rays(camera, xy)
    if not np.isfinite(rays).all():
        return None
    directions = np.einsum('nji,nj->ni', rotations[blocks.view], rays)
    return rescaled(SceneState(Lens.of(camera), path.placed_at(centres),
                               points_from_centres(blocks, directions, centres)))
