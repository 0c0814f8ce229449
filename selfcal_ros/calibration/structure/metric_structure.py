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
Metric structure: from a calibration, or step by step from a projective frame (thesis 2.2).

Images fix a scene up to its scale. Here the median step between successive views is 1, unless
the poses of a robot tell the scale: then lengths are in metres. The world is the body frame
(x forward, y left, z up) of the first view; planar motion, which knows the vertical of its plane,
puts z along its rotation axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.calibration.bundle.lens import Lens, Projection
from selfcal_ros.calibration.mount import Mount
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.upgrade import affine_upgrade, metric_upgrade
from selfcal_ros.errors import ArgumentError
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.values.tracks import Tracks

#: Observations farther than so many sigmas from the prediction are not the point's.
OUTLIER_SIGMAS = 4.0
#: A point is kept when it is known to this share of its distance from the nearest view.
RELATIVE_SIGMA = 0.05
#: Motions that know the vertical of a plane.
IN_A_PLANE = ('planar', 'circular')
#: Body axes (x forward, y left, z up) in an optical frame (x right, y down, z forward).
_OPTICAL_FROM_BODY = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


@dataclass(frozen=True)
class Structure:
    """
    Camera path and points in a metric frame of arbitrary scale.

    Attributes
    ----------
    frames : ndarray of int, shape (V,)
    cam_from_world : ndarray, shape (V, 3, 4)
        [R | t] of each frame; the unit of length is that of the heading.
    tracks : ndarray of int, shape (P,)
        Of the points kept.
    points : ndarray, shape (P, 3)
    covariance : ndarray, shape (P, 3, 3)
        Of each point, the cameras taken as exact.
    left_out : int
        Reconstructed points that are at infinity, or not known well enough.

    """

    frames: np.ndarray
    cam_from_world: np.ndarray
    tracks: np.ndarray
    points: np.ndarray
    covariance: np.ndarray
    left_out: int

    @property
    def centres(self) -> np.ndarray:
        """Camera centres in the world, shape (V, 3)."""
        return camera_centres(self.cam_from_world)


def metric_structure(calibration: Calibration, tracks: Tracks,
                     relative_sigma: float = RELATIVE_SIGMA) -> Structure:
    """
    Return the finite points of a calibration that are well known, and the camera path.

    Parameters
    ----------
    calibration : Calibration
        With its reconstruction.
    tracks : Tracks
        Those that were calibrated from; they tell how well each point is known.
    relative_sigma : float
        Keep points whose largest standard deviation is below this share of their distance from
        the nearest view that saw them.

    Returns
    -------
    Structure
        Its world frame and scale are those of the module's heading.

    """
    shape = calibration.reconstruction
    if shape is None:
        raise ArgumentError('This calibration has no structure; calibrate from a camera that '
                            'moves.')
    points = np.asarray(shape.points, float)
    weight = np.where(points[:, 3:] == 0, np.nan, points[:, 3:])      # at infinity
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        points = points[:, :3] / weight
    poses, world, scale = _upright(calibration)
    points = scale * (points @ world[:, :3].T + world[:, 3])
    covariance, nearest = _point_covariances(calibration, tracks, poses, points)
    finite = np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(points).all(axis=1)
    keep = np.flatnonzero(finite)
    spread = np.sqrt(np.linalg.eigvalsh(covariance[keep])[:, -1].clip(0))
    keep = keep[spread < relative_sigma * nearest[keep]]
    return Structure(shape.frames, poses, shape.tracks[keep], points[keep], covariance[keep],
                     len(points) - len(keep))


def metric_path(calibration: Calibration) -> np.ndarray:
    """Return [R | t] of the views in the frame and scale of the heading, shape (V, 3, 4)."""
    return _upright(calibration)[0]


def _upright(calibration: Calibration) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the poses in the frame of the heading, that frame as [R | t], and its scale."""
    poses = np.asarray(calibration.reconstructed.cam_from_world, float)
    world, scale = world_and_scale(poses, calibration.motion in IN_A_PLANE)
    scale *= metres_a_step(calibration) or 1.0
    # X_new = scale * (R X + t) for world = [R | t]
    rotations = poses[:, :, :3] @ world[:, :3].T
    translations = scale * (poses[:, :, 3] - rotations @ world[:, 3])
    return np.concatenate([rotations, translations[:, :, None]], axis=2), world, scale


def metres_a_step(calibration: Calibration) -> float | None:
    """Return the metres in a median step, where the poses of a robot tell; else None."""
    mount = calibration.mount
    if not isinstance(mount, Mount) or not np.isfinite(mount.scale):
        return None
    return mount.scale


def world_and_scale(poses: np.ndarray, planar: bool) -> tuple[np.ndarray, float]:
    """
    Place the world of the heading.

    Parameters
    ----------
    poses : ndarray, shape (V, 3, 4)
        [R | t] in a given world.
    planar : bool
        Its z axis is that of the motion.

    Returns
    -------
    world : ndarray, shape (3, 4)
        [R | t] from the given world to that of the heading, before the scale.
    scale : float

    """
    axes = _OPTICAL_FROM_BODY.T @ poses[0, :, :3]
    if planar:
        # the images' y points down: so does the axis, where it goes with them
        up = np.array([0, 0, -np.sign(poses[:, 1, 2].sum()) or 1.0])
        forward = poses[0, 2, :3] - up * (up @ poses[0, 2, :3])
        if np.linalg.norm(forward) < 1e-6:
            # straight down (or up): the top of the image is ahead
            forward = -poses[0, 1, :3] + up * (up @ poses[0, 1, :3])
        forward /= np.linalg.norm(forward)
        axes = np.array([forward, np.cross(up, forward), up])
    centres = camera_centres(poses)
    steps = [np.linalg.norm(centres[k + 1] - centres[k]) for k in middle_steps(centres)]
    return (np.column_stack([axes, -axes @ centres[0]]),
            float(1 / np.mean(steps)) if steps else 1.0)


def middle_steps(centres: np.ndarray) -> list[int]:
    """Return the steps between successive views whose mean is the unit: one or two, or none."""
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    order = np.argsort(steps, kind='stable')
    middle = order[(len(steps) - 1) // 2:len(steps) // 2 + 1]
    if not steps[middle].any():
        # more than half of the views may stand still
        middle = order[-1:]
    return [int(k) for k in middle if steps[k] > 0]


def _point_covariances(calibration: Calibration, tracks: Tracks, poses: np.ndarray,
                       points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance (P, 3, 3) of points, NaN where unknown, and their least distance."""
    shape, camera = calibration.reconstructed, calibration.camera
    rows, view, point = shape.places_of(tracks.frame, tracks.track)
    finite = np.isfinite(points[point]).all(axis=1)
    view, point, xy = view[finite], point[finite], tracks.xy[rows[finite]]
    when_seen = shape.when_seen(view, point, xy) / shape.points[point, 3:]
    xy, scale = calibration.steadied(view, xy)
    X = np.einsum('nij,nj->ni', poses[view, :, :3], points[point]) + poses[view, :, 3]
    # a homogeneous point far beyond the image may meet the fold of the distortion
    with np.errstate(invalid='ignore', over='ignore'):
        # the noise is that of the images as they are, whatever the focal length of each
        miss = scale[:, 0] * np.linalg.norm(camera.project(when_seen) - xy, axis=1)
        near = miss < OUTLIER_SIGMAS * max(calibration.noise_sigma_px, 1e-9)
    view, point, X, scale = view[near], point[near], X[near], scale[near]
    J = scale[:, :, None] * (Projection(Lens.of(camera), X).by_points() @ poses[view, :, :3])
    information = np.zeros((len(points), 3, 3))
    np.add.at(information, point, np.swapaxes(J, 1, 2) @ J)
    views = np.bincount(point, minlength=len(points))
    nearest = np.full(len(points), np.inf)
    np.minimum.at(nearest, point, np.linalg.norm(X, axis=1))
    covariance = np.full((len(points), 3, 3), np.nan)
    # a ray alone, or several that coincide, do not fix a point
    enough = np.flatnonzero((views >= 2) & (np.linalg.cond(information) < 1e12))
    covariance[enough] = (calibration.noise_sigma_px**2 * np.linalg.inv(information[enough]))
    return covariance, nearest


def to_affine(cameras: np.ndarray, points: np.ndarray, plane: ArrayLike,
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Upgrade a projective reconstruction to an affine one (thesis 2.14).

    Parameters
    ----------
    cameras : ndarray, shape (V, 3, 4)
        The first is [I | 0].
    points : ndarray, shape (P, 4)
    plane : array_like, shape (3,)
        pi: points at infinity satisfy pi^T X + W = 0.

    Returns
    -------
    cameras : ndarray, shape (V, 3, 4)
        [A_i | a_i], A_i being the infinite homography from the first view.
    points : ndarray, shape (P, 4)

    """
    return _transformed(cameras, points, affine_upgrade(plane))


def to_metric(cameras: np.ndarray, points: np.ndarray, K: ArrayLike,
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Upgrade an affine reconstruction to a metric one (thesis 2.16).

    Parameters
    ----------
    cameras : ndarray, shape (V, 3, 4)
        The first is [I | 0].
    points : ndarray, shape (P, 4)
    K : array_like, shape (3, 3)
        Of the first camera, and of all where they are one.

    Returns
    -------
    cameras : ndarray, shape (V, 3, 4)
        K [R_i | t_i] up to a factor; the first is K [I | 0].
    points : ndarray, shape (P, 4)
        In the optical frame of the first view, at the scale of the input.

    """
    return _transformed(cameras, points, metric_upgrade(K))


def _transformed(cameras: np.ndarray, points: np.ndarray, H: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray]:
    return (np.asarray(cameras, float) @ np.linalg.inv(H), np.asarray(points, float) @ H.T)


def distance_error(grids: ArrayLike) -> float:
    """
    Spread of the distances between neighbours on regular grids (thesis 4.2, measure 1).

    Parameters
    ----------
    grids : array_like, shape (..., rows, columns, 3)
        Points of one or several grids of equal squares; NaN where a point is missing.

    Returns
    -------
    float
        Standard deviation over mean; 0 for perfect structure of any scale.

    """
    grids = _grids(grids)
    distances = np.concatenate([
        np.linalg.norm(np.diff(grids, axis=axis), axis=-1).ravel() for axis in (-2, -3)])
    distances = distances[np.isfinite(distances)]
    if len(distances) < 2:
        raise ArgumentError('The distance error needs at least three neighbouring points.')
    return float(distances.std() / distances.mean())


def pattern_error(grids: ArrayLike) -> float:
    """
    Spread of the angles at the corners of a grid's squares (thesis 4.2, measure 2), radians.

    Parameters
    ----------
    grids : array_like, shape (..., rows, columns, 3)
        As for `distance_error`.

    """
    grids = _grids(grids)
    corners = [grids[..., :-1, :-1, :], grids[..., :-1, 1:, :], grids[..., 1:, 1:, :],
               grids[..., 1:, :-1, :]]
    found = []
    for k in range(4):
        a, b = corners[k - 1] - corners[k], corners[(k + 1) % 4] - corners[k]
        found.append(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))
    angles = np.ravel(found)
    angles = angles[np.isfinite(angles)]
    if not len(angles):
        raise ArgumentError('The pattern error needs at least one whole square.')
    return float(angles.std())


def plane_angle(first: ArrayLike, second: ArrayLike) -> float:
    """
    Angle between two planes of points, each by orthogonal regression (thesis 4.2, measure 3).

    Parameters
    ----------
    first, second : array_like, shape (..., 3)
        Points of each plane; NaN rows are left out.

    Returns
    -------
    float
        Radians, 0 to pi: between the two half-planes that leave their common line towards the
        points; 90 degrees for two sides of a box.

    """
    (centre_1, normal_1), (centre_2, normal_2) = _plane(first), _plane(second)
    line = np.cross(normal_1, normal_2)
    if np.linalg.norm(line) < 1e-9:
        return 0.0
    # a point of the common line, the nearest to the middle of the points
    middle = (centre_1 + centre_2) / 2
    rows = np.array([normal_1, normal_2, line / np.linalg.norm(line)])
    hinge = np.linalg.solve(rows, [normal_1 @ centre_1, normal_2 @ centre_2, rows[2] @ middle])
    arms = [np.cross(line, normal) for normal in (normal_1, normal_2)]
    arms = [arm if arm @ (centre - hinge) >= 0 else -arm
            for arm, centre in zip(arms, (centre_1, centre_2))]
    return float(np.arctan2(np.linalg.norm(np.cross(arms[0], arms[1])), arms[0] @ arms[1]))


def _grids(points: ArrayLike) -> np.ndarray:
    points = np.asarray(points, float)
    if points.ndim < 3 or points.shape[-1] != 3:
        raise ArgumentError(f'A grid of points must be (..., rows, columns, 3), not '
                            f'{points.shape}.')
    return points


def _plane(points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Fit a plane by orthogonal regression: its centre and unit normal."""
    places = np.asarray(points, float).reshape(-1, 3)
    places = places[np.isfinite(places).all(axis=1)]
    if len(places) < 3:
        raise ArgumentError('A plane needs at least three points.')
    centre = places.mean(axis=0)
    return centre, np.linalg.svd(places - centre, full_matrices=False)[2][2]
