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
Point scenes whose truth is known exactly: the thesis's sequence SI and degenerate relatives.

World frame: z along the rotation axis, x and y in the planes of motion. Body frame: the world
frame turned by the view's angle and moved to its position. Camera frame: x right, y down, z
forward; the mounting rotation takes body coordinates to camera coordinates, so that its third
column is the rotation axis in every camera frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.values.tracks import Tracks

#: Vanishing point of the rotation axis of sequence SI, pixels (thesis table 6.11).
SI_VANISHING_POINT = (-571.8, -11876.0)

#: In-plane positions of the three views of SI in units of the grid's side. The thesis does not
#: print them; these were chosen so that the whole grid stays inside an 800 x 600 image and that
#: the spreads of l and v (table 6.8) and the Cramer-Rao bounds of the focal length, principal
#: point and skew (table 6.20) come within a third of what the thesis measured.
SI_POSITIONS = ((0.0, 0.0), (-0.07, -1.73), (1.47, -1.23))


@dataclass(frozen=True)
class PointSequence:
    """
    Tracks with the truth that made them.

    Attributes
    ----------
    tracks : Tracks
        Noisy observations; track identity k is row k of `points`.
    camera : Camera
    cam_from_world : ndarray, shape (V, 3, 4)
        [R | t] of each view; frame index k is row k.
    points : ndarray, shape (P, 3)
        World coordinates.
    axis : ndarray, shape (3,)
        Unit rotation axis in the first camera frame; for a motion that is not planar, the z
        axis of the body.
    true_pixels : ndarray, shape (V, P, 2)
        Noise-free projections, NaN where the lens cannot see.
    outliers : ndarray of bool, shape (N,)
        Rows of `tracks` that were replaced by gross errors.

    """

    tracks: Tracks
    camera: Camera
    cam_from_world: np.ndarray
    points: np.ndarray
    axis: np.ndarray
    true_pixels: np.ndarray
    outliers: np.ndarray

    @property
    def vanishing_point(self) -> np.ndarray:
        """Image v of the direction of the rotation axis, shape (3,), unit norm."""
        v = self.camera.K @ self.axis
        return np.asarray(v / np.linalg.norm(v))

    @property
    def horizon(self) -> np.ndarray:
        """Vanishing line l of the planes of motion, shape (3,), unit norm."""
        line = np.linalg.solve(self.camera.K.T, self.axis)
        return np.asarray(line / np.linalg.norm(line))

    @property
    def circular_point(self) -> np.ndarray:
        """Image i of a circular point of the planes of motion, complex, shape (3,)."""
        first, second = _plane_basis(self.axis)
        return self.camera.K @ (first + 1j * second)


def _plane_basis(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that complete the unit axis to a right-handed frame."""
    away = np.eye(3)[2] if abs(axis[2]) < 0.9 else np.eye(3)[1]
    first = away - (away @ axis) * axis
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def mount_from_axis(axis: ArrayLike) -> np.ndarray:
    """
    Mount the camera so that the body's z axis is `axis` in the camera frame.

    The body's x axis is the optical axis projected onto the plane of motion.

    Parameters
    ----------
    axis : array_like, shape (3,)

    Returns
    -------
    ndarray, shape (3, 3)
        Rotation from body to camera coordinates.

    """
    unit = np.asarray(axis, float) / np.linalg.norm(axis)
    return np.column_stack([*_plane_basis(unit), unit])


def pitched_mount(pitch_rad: float, roll_rad: float = 0.0) -> np.ndarray:
    """
    Mount the camera on a vehicle whose z axis points up, looking forward.

    Parameters
    ----------
    pitch_rad : float
        Angle below the horizontal at which the camera looks.
    roll_rad : float
        Rotation about the optical axis; the horizon is level when it is zero.

    Returns
    -------
    ndarray, shape (3, 3)
        Rotation from body to camera coordinates.

    """
    up = np.array([0.0, -np.cos(pitch_rad), -np.sin(pitch_rad)])
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return np.asarray(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ mount_from_axis(up))


def planar_poses(mount_rotation: ArrayLike, angles_rad: ArrayLike, positions: ArrayLike,
                 ) -> np.ndarray:
    """
    Poses of a camera that moves in the x, y plane of the world and turns about z.

    Parameters
    ----------
    mount_rotation : array_like, shape (3, 3)
        Body to camera coordinates.
    angles_rad : array_like, shape (V,)
    positions : array_like, shape (V, 2) or (V, 3)
        Camera centres in the world.

    Returns
    -------
    ndarray, shape (V, 3, 4)
        cam_from_world.

    """
    angles = np.asarray(angles_rad, float)
    positions = np.asarray(positions, float)
    centres = np.zeros((len(angles), 3))
    centres[:, :positions.shape[1]] = positions
    c, s, zero, one = np.cos(angles), np.sin(angles), 0 * angles, 0 * angles + 1
    body_from_world = np.moveaxis(
        np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]]), -1, 0)
    rotation = np.asarray(mount_rotation, float) @ body_from_world
    return np.concatenate([rotation, -rotation @ centres[:, :, None]], axis=-1)


def observe(rng: np.random.Generator, camera: Camera, cam_from_world: ArrayLike, points: ArrayLike,
            noise_px: float = 0.0, only_inside: bool = False, seen: np.ndarray | None = None,
            ) -> PointSequence:
    """
    Project points into views and add Gaussian noise.

    Parameters
    ----------
    rng : numpy.random.Generator
    camera : Camera
    cam_from_world : array_like, shape (V, 3, 4)
    points : array_like, shape (P, 3)
    noise_px : float
        Standard deviation of each image coordinate.
    only_inside : bool
        Drop observations outside the image; needs a camera with a size. Points that the lens
        cannot see, as those behind a pinhole, are always dropped.
    seen : array_like of bool, shape (V, P), optional
        Further restriction.

    Returns
    -------
    PointSequence

    """
    poses = np.asarray(cam_from_world, float)
    points = np.asarray(points, float)
    local = points @ np.swapaxes(poses[:, :, :3], 1, 2) + poses[:, None, :, 3]
    from_axis = np.arctan2(np.hypot(local[..., 0], local[..., 1]), local[..., 2])
    # beyond its widest angle a polynomial folds back into the image
    ahead = from_axis < camera.lens.widest_angle(camera.distortion) - 1e-9
    pixels = camera.project(np.where(ahead[..., None], local, np.nan))
    keep = ahead.copy()
    if only_inside:
        corner = np.array([camera.width, camera.height]) - 0.5
        with np.errstate(invalid='ignore'):
            keep &= ((pixels >= -0.5) & (pixels <= corner)).all(axis=-1)
    if seen is not None:
        keep &= np.asarray(seen, bool)
    noisy = pixels + noise_px * rng.standard_normal(pixels.shape)
    frame, track = np.nonzero(keep)
    size = (camera.width, camera.height) if camera.width and camera.height else None
    tracks = Tracks(frame, track, noisy[keep], size)
    return PointSequence(tracks, camera, poses, points, poses[0, :, 2].copy(), pixels,
                         np.zeros(len(tracks), bool))


def planar_sequence(rng: np.random.Generator, camera: Camera, mount_rotation: ArrayLike,
                    angles_rad: ArrayLike, positions: ArrayLike, points: ArrayLike,
                    noise_px: float = 0.0, only_inside: bool = False,
                    seen: np.ndarray | None = None) -> PointSequence:
    """
    Observe points from a camera in planar motion; see `planar_poses` and `observe`.

    Returns
    -------
    PointSequence

    """
    return observe(rng, camera, planar_poses(mount_rotation, angles_rad, positions), points,
                   noise_px, only_inside, seen)


def double_tsai_grid(per_side: int = 5, side: float = 1.0) -> np.ndarray:
    """
    Two orthogonal square grids that share an edge's direction, centred on their centroid.

    Returns
    -------
    ndarray, shape (2 * per_side ** 2, 3)
        The edge lies along z; both grids face -x, the side from which SI looks.

    """
    ticks = np.linspace(0.0, side, per_side)
    along, up = (a.ravel() for a in np.meshgrid(ticks, ticks))
    half = np.sqrt(0.5)
    left = np.column_stack([-half * along, half * along, up])
    right = np.column_stack([-half * along, -half * along, up])
    points = np.vstack([left, right])
    return np.asarray(points - points.mean(axis=0))


def si_camera(aspect_ratio: float = 1.0, skew: float = 0.0, distortion: Sequence[float] = (),
              ) -> Camera:
    """Camera of sequence SI: K = (900, 900, 400, 300, 0), image 800 x 600."""
    return Camera([[900.0, skew, 400.0], [0.0, 900 * aspect_ratio, 300.0], [0.0, 0.0, 1.0]],
                  np.asarray(distortion, float), 800, 600)


def si_axis() -> np.ndarray:
    """Rotation axis of sequence SI in the camera frame, from K and v, shape (3,)."""
    axis = np.linalg.solve(si_camera().K, [*SI_VANISHING_POINT, 1.0])
    return np.asarray(axis / np.linalg.norm(axis))


def sequence_si(rng: np.random.Generator, noise_px: float = 0.1, views: int = 3,
                step_deg: float = 10.0, aspect_ratio: float = 1.0, skew: float = 0.0,
                distortion: Sequence[float] = (), axis: ArrayLike | None = None,
                positions: ArrayLike | None = None, points: ArrayLike | None = None,
                only_inside: bool = False) -> PointSequence:
    """
    Make the thesis's sequence SI (section 6.1) or a relative of it.

    Fifty points on a double Tsai grid of side 1, whose centre lies on the optical axis of the
    first view at distance 4; views `step_deg` apart about a fixed axis; translation in the
    plane of motion.

    Parameters
    ----------
    rng : numpy.random.Generator
    noise_px : float
    views : int
        Beyond three, the camera goes on round the grid on a wavy path.
    step_deg : float
    aspect_ratio, skew, distortion
        Of the camera; the focal length along x stays 900.
    axis : array_like, shape (3,), optional
        Rotation axis in the camera frame, SI's own by default.
    positions : array_like, shape (V, 2), optional
        Camera centres, `SI_POSITIONS` continued by default.
    points : array_like, shape (P, 3), optional
        Points relative to the grid's centre in place of the grid.
    only_inside : bool
        Drop observations outside the 800 x 600 image.

    Returns
    -------
    PointSequence

    """
    mount = mount_from_axis(si_axis() if axis is None else axis)
    centre = mount.T @ [0.0, 0.0, 4.0]
    points = double_tsai_grid() if points is None else np.asarray(points, float)
    angles = np.radians(step_deg) * np.arange(views)
    if positions is None:
        positions = np.array(SI_POSITIONS)[:views]
        if views > 3:
            more = angles[3:]
            radius = np.hypot(*centre[:2]) * (1 + 0.12 * np.sin(2.3 * np.arange(3, views)))
            aim = more + 0.05 * np.cos(1.7 * np.arange(3, views))
            ring = centre[:2] - radius[:, None] * np.column_stack([np.cos(aim), np.sin(aim)])
            positions = np.vstack([positions, ring])
    return planar_sequence(rng, si_camera(aspect_ratio, skew, distortion), mount, angles,
                           positions, points + centre, noise_px, only_inside)
