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
First camera and poses from known points, in closed form.

A view of a three-dimensional object gives P = [M | p] (3.11), a view of a plane its homography
H = (h1 h2 h3). In an orthonormal frame of the object the columns a, b of M, or h1 and h2, are
images of orthogonal directions of one length:

    aᵀ ω b = 0,      aᵀ ω a = bᵀ ω b

Five equations a view of a solid, two a view of a plane (Zhang 2000); facts about the camera are
further rows.

A fisheye's image shows none of these. Its rays do, once a focal length is supposed: a few of them
are, and the best is kept. Rays carry their own sign, so that a board may reach behind the camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.object_poses import ObjectPoses
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.camera_facts import CameraFacts
from selfcal_ros.geometry.lenses.model import LensModel
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.projective import (calibration_from_iac, euclidean, homogeneous,
                                             normalising_transform)
from selfcal_ros.geometry.resection import resect_linear

#: An object thinner than this share of its extent is started as a plane; one narrower than the
#: next share is a line, which shows no pose.
FLAT, NARROW = 0.02, 1e-3
#: Supposed focal lengths as shares of the longer side, where the linear equations give none.
FOCAL_FRACTIONS = (1.0, 0.65, 1.6, 2.6, 0.45, 4.2)
#: The same of fisheyes, whose linear equations need one.
FISHEYE_FRACTIONS = (0.3, 0.4, 0.22, 0.55, 0.9)


@dataclass(frozen=True)
class LinearView:
    """
    What one view tells linearly, up to scale.

    Attributes
    ----------
    flat : bool
        The points of this view lie in a plane.
    frame : ndarray, shape (3, 3)
        Rotation from object coordinates to those in which `matrix` is given; its third row is
        the normal of a flat view.
    centre : ndarray, shape (3,)
        Origin of that frame, in object coordinates.
    matrix : ndarray, shape (3, 4)
        From that frame to pixels; the third column of a flat view is zero.
    error_px : float
        Root mean square reprojection distance.

    """

    flat: bool
    frame: np.ndarray
    centre: np.ndarray
    matrix: np.ndarray
    error_px: float

    @property
    def mirrored(self) -> bool:
        """Tell whether only a mirror image of the object fits this view."""
        return not self.flat and np.linalg.det(self.matrix[:, :3]) < 0


def linear_view(points: np.ndarray, xy: np.ndarray, frame: int = 0) -> LinearView | NoEstimate:
    """
    Solve one view: P of a solid, or the homography of a plane.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
    xy : ndarray, shape (n, 2)
        Pixels.
    frame : int
        What a failure calls this view.

    Returns
    -------
    LinearView or NoEstimate
        The latter where this view tells nothing.

    """
    if len(points) < 4:
        return NoEstimate('view_too_few', frame=frame, points=len(points))
    centre = points.mean(axis=0)
    _, extent, axes = np.linalg.svd(points - centre, full_matrices=False)
    if not extent[1] > NARROW * extent[0]:
        return NoEstimate('view_on_line', frame=frame)
    axes = axes * np.sign(np.linalg.det(axes))
    local = (points - centre) @ axes.T
    flat = extent[2] < FLAT * extent[0]
    if not flat and len(points) < 6:
        return NoEstimate('view_too_few_of_solid', frame=frame, points=len(points))
    if flat:
        H = homography(local[:, :2], xy)
        if H is None:
            return NoEstimate('view_homography_open', frame=frame)
        matrix = np.insert(H, 2, 0.0, axis=1)
        return LinearView(True, axes, centre, matrix, _error(matrix, local, xy))
    P = resect_linear(local, xy)
    if isinstance(P, NoEstimate):
        return NoEstimate('view_camera_open', frame=frame, why=P)
    return LinearView(False, axes, centre, P, _error(P, local, xy))


def _error(matrix: np.ndarray, local: np.ndarray, xy: np.ndarray) -> float:
    away = euclidean(homogeneous(local) @ matrix.T) - xy
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def homography(plane: np.ndarray, xy: np.ndarray) -> np.ndarray | None:
    """Homography from plane points (n, 2) to pixels (n, 2), linear, points ahead positive."""
    A, B = normalising_transform(plane), normalising_transform(xy)
    p = homogeneous(plane) @ A.T
    u = homogeneous(xy) @ B.T
    zero = np.zeros_like(p)
    rows = np.concatenate([np.concatenate([p, zero, -u[:, :1] * p], axis=1),
                           np.concatenate([zero, p, -u[:, 1:2] * p], axis=1)])
    values, vectors = np.linalg.eigh(rows.T @ rows)
    if not values[1] > 1e-12 * values[-1]:
        return None
    H = np.linalg.solve(B, vectors[:, 0].reshape(3, 3)) @ A
    ahead = homogeneous(plane) @ H[2]
    oriented: np.ndarray = H / np.linalg.norm(H) * np.sign(ahead.sum() or 1.0)
    return oriented


def supposed_cameras(views: list[LinearView], size: tuple[int, int],
                     facts: CameraFacts) -> list[np.ndarray]:
    """
    Calibration matrices to start from, the most trusted first.

    Parameters
    ----------
    views : list of LinearView
    size : (int, int)
        Width and height in pixels.
    facts : CameraFacts

    Returns
    -------
    list of ndarray, shape (3, 3)
        Of the linear equations with the facts, and of the same with what most cameras have. Then
        of a range of focal lengths. The latter always exist.

    """
    aspect = facts.aspect_ratio or 1.0
    longer = max(size)
    middle = (np.array(size) - 1) / 2
    T = np.array([[1 / longer, 0, -middle[0] / longer], [0, 1 / longer, -middle[1] / longer],
                  [0, 0, 1]])
    rows = []
    for view in views:
        columns = (T @ view.matrix[:, :3]).T[:2 if view.flat else 3]
        columns = columns / np.sqrt(np.mean(np.sum(columns**2, axis=1)))
        for k in range(len(columns)):
            for m in range(k):
                a, b = columns[k], columns[m]
                rows += [_row(a, b), (_row(a, a) - _row(b, b)) / 2]
    weight = 10 * np.sqrt(max(len(rows), 1))
    point = None if facts.principal_point is None else T @ [*facts.principal_point, 1]
    known = _fact_rows(None if facts.skew is None else 0.0, facts.aspect_ratio, point)
    usual = _fact_rows(0.0, aspect, np.array([0, 0, 1.0]) if point is None else point)
    cameras = []
    for extra in (known, usual):
        system = np.array(rows + [weight * row for row in extra]).reshape(-1, 6)
        if len(system) < 5:
            continue
        _, _, Vt = np.linalg.svd(system)
        a, b, c, d, e, f = Vt[-1]
        K = calibration_from_iac([[a, b, d], [b, c, e], [d, e, f]])
        if isinstance(K, NoEstimate):
            continue
        K = np.linalg.solve(T, K)
        if np.isfinite(K).all() and 0.05 < K[0, 0] / longer < 100 and (
                0.05 < K[1, 1] / K[0, 0] < 20):
            cameras.append(K / K[2, 2])
    centre = facts.principal_point or middle
    for share in FOCAL_FRACTIONS:
        cameras.append(np.array([[share * longer, 0, centre[0]],
                                 [0, share * longer * aspect, centre[1]], [0, 0, 1.0]]))
    return cameras


def _row(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Coefficients of aᵀ ω b in (ω11, ω12, ω22, ω13, ω23, ω33)."""
    return np.array([a[0] * b[0], a[0] * b[1] + a[1] * b[0], a[1] * b[1],
                     a[0] * b[2] + a[2] * b[0], a[1] * b[2] + a[2] * b[1], a[2] * b[2]])


def _fact_rows(skew: float | None, aspect: float | None, point: np.ndarray | None,
               ) -> list[np.ndarray]:
    """Rows of what is known; a skew counts as zero, which it nearly is."""
    rows = []
    if skew is not None:
        rows.append(np.array([0, 1.0, 0, 0, 0, 0]))
    if aspect is not None:
        rows.append(np.array([1.0, 0, -aspect**2, 0, 0, 0]))
    if point is not None:
        u, v, w = point
        rows += [np.array([u, v, 0, w, 0, 0]), np.array([0, u, v, 0, w, 0])]
    return rows


def start_state(K: np.ndarray, views: list[LinearView], lens: LensModel) -> ObjectState:
    """Return the camera, its coefficients zero, and each view's pose nearest to its linear one."""
    return ObjectState(Lens.of(Camera(K, model=lens.name)), ObjectPoses(_poses(K, views)))


def fisheye_cameras(size: tuple[int, int], facts: CameraFacts, lens: LensModel) -> list[Camera]:
    """Cameras without coefficients to start from, the longer side 190 to 60 degrees wide."""
    cx, cy = facts.principal_point or ((size[0] - 1) / 2, (size[1] - 1) / 2)
    aspect = facts.aspect_ratio or 1.0
    focal = max(size) * np.array(FISHEYE_FRACTIONS)
    return [Camera(np.array([[f, 0.0, cx], [0.0, f * aspect, cy], [0.0, 0.0, 1.0]]),
                   model=lens.name) for f in focal]


def fisheye_state(camera: Camera, views: list[LinearView], view: np.ndarray, points: np.ndarray,
                  xy: np.ndarray) -> ObjectState:
    """
    Return a supposed camera with the poses that its rays show, as `linear_view` from pixels.

    Parameters
    ----------
    camera : Camera
        With any lens; rays may point backwards.
    views : list of LinearView
        Of which the frame of the object is taken.
    view : ndarray of int, shape (N,)
        View of each observation, ascending.
    points : ndarray, shape (N, 3)
    xy : ndarray, shape (N, 2)
        Pixels.

    Returns
    -------
    ObjectState

    """
    rays = camera.rays(xy)
    first = np.searchsorted(view, np.arange(len(views) + 1))
    turned = [_on_rays(one, points[a:b], rays[a:b])
              for one, a, b in zip(views, first, first[1:])]
    return ObjectState(Lens.of(camera), ObjectPoses(_poses(np.eye(3), turned)))


def _on_rays(view: LinearView, points: np.ndarray, rays: np.ndarray) -> LinearView:
    """Solve r x (M p) = 0 for the matrix from the view's frame to rays, whatever their sign."""
    seen = np.isfinite(rays).all(axis=1)
    p = homogeneous((points[seen] - view.centre) @ view.frame.T)
    if view.flat:
        p = p[:, [0, 1, 3]]
    r = rays[seen]
    # rows of the cross product; the unknowns are the rows of M
    cross = np.cross(np.eye(3)[None], r[:, None]).transpose(0, 2, 1)
    A = np.einsum('nij,nk->nijk', cross, p).reshape(3 * len(p), -1)
    M = np.linalg.eigh(A.T @ A)[1][:, 0].reshape(3, -1)
    M = M * np.sign(np.einsum('ni,ij,nj->', r, M, p) or 1.0)
    return replace(view, matrix=np.insert(M, 2, 0.0, axis=1) if view.flat else M)


def _poses(K: np.ndarray, views: list[LinearView]) -> np.ndarray:
    """Pose (V, 3, 4) of each view nearest to its linear one."""
    poses = np.empty((len(views), 3, 4))
    for view, pose in zip(views, poses):
        A = np.linalg.solve(K, view.matrix)
        if view.flat:
            A[:, 2] = np.cross(A[:, 0], A[:, 1]) / np.sqrt(
                np.linalg.norm(A[:, 0]) * np.linalg.norm(A[:, 1]))
        U, scale, Vt = np.linalg.svd(A[:, :3])
        R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
        t = A[:, 3] / (scale[:2].mean() if view.flat else scale.mean())
        pose[:, :3] = R @ view.frame
        pose[:, 3] = t - pose[:, :3] @ view.centre
    return poses
