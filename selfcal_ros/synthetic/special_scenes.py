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
"""Point scenes by name: the degenerate relatives of sequence SI, and long drives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.scenes import (double_tsai_grid, mount_from_axis, observe,
                                          pitched_mount, planar_poses, planar_sequence,
                                          PointSequence, sequence_si, si_axis, SI_POSITIONS)
from selfcal_ros.values.tracks import Tracks


def level_horizon(rng: np.random.Generator, noise_px: float = 0.1, pitch_deg: float = 20.0,
                  **options: Any) -> PointSequence:
    """SI seen by a camera pitched down without roll; pitch 0 puts the axis along image y."""
    return sequence_si(rng, noise_px, axis=pitched_mount(np.radians(pitch_deg))[:, 2], **options)


def circular_motion(rng: np.random.Generator, noise_px: float = 0.1, views: int = 3,
                    step_deg: float = 10.0, aside: float = 0.0, **options: Any) -> PointSequence:
    """
    SI on a turntable: the camera circles an axis, facing it with aside = 0.

    With `aside` the axis stands so far to the left of the grid's centre, in units of the grid's
    side. Then the principal point does not lie on the image of the axis.
    """
    mount = mount_from_axis(si_axis() if options.get('axis') is None else options['axis'])
    centre = np.array([4.0 * mount[2, 0], aside])
    angles = np.radians(step_deg) * np.arange(views)
    c, s = np.cos(angles), np.sin(angles)
    positions = centre - np.column_stack([c * centre[0] - s * centre[1],
                                          s * centre[0] + c * centre[1]])
    return sequence_si(rng, noise_px, views, step_deg, positions=positions, **options)


def nearly_equal_positions(rng: np.random.Generator, noise_px: float = 0.1, scale: float = 1e-3,
                           step_deg: float = 10.0, **options: Any) -> PointSequence:
    """SI with its translations shrunk, so that the three positions are almost one."""
    return sequence_si(rng, noise_px, step_deg=step_deg,
                       positions=scale * np.array(SI_POSITIONS), **options)


def pure_translation(rng: np.random.Generator, noise_px: float = 0.1, **options: Any,
                     ) -> PointSequence:
    """SI without its rotation."""
    return sequence_si(rng, noise_px, step_deg=0.0, **options)


def pure_rotation(rng: np.random.Generator, noise_px: float = 0.1, views: int = 3, **options: Any,
                  ) -> PointSequence:
    """SI without its translation."""
    return sequence_si(rng, noise_px, views, positions=np.zeros((views, 2)), **options)


def few_points(rng: np.random.Generator, noise_px: float = 0.1, count: int = 4, **options: Any,
               ) -> PointSequence:
    """SI with so few of its points, spread over the grid."""
    grid = double_tsai_grid()
    chosen = np.linspace(0, len(grid) - 1, count).round().astype(int)
    return sequence_si(rng, noise_px, points=grid[chosen], **options)


def coplanar_points(rng: np.random.Generator, noise_px: float = 0.1, **options: Any,
                    ) -> PointSequence:
    """SI with all fifty points in one plane, oblique to the axis and to the image."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-0.6, 0.6, 10),
                                           np.linspace(-0.6, 0.6, 5)))
    first, second = np.array([-0.5, 0.8, 0.2]), np.array([-0.4, -0.2, 0.9])
    return sequence_si(rng, noise_px, points=np.outer(u, first) + np.outer(v, second), **options)


def general_motion(rng: np.random.Generator, noise_px: float = 0.1, step_deg: float = 10.0,
                   **options: Any) -> PointSequence:
    """Show SI's points to three views turned about different axes, out of any one plane."""
    still = sequence_si(rng, 0.0, **options)
    turns = np.radians(step_deg) * np.array([[0, 0, 0], [0.7, 0.1, 0.4], [-0.4, 0.6, -0.9]])
    places = np.array([[0, 0, 4.0], [0.3, -0.25, 3.7], [-0.2, 0.3, 4.4]])
    x, y, z = turns.T
    zero = np.zeros_like(x)
    cross = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    # Cayley's form: exactly orthogonal, no angle functions
    turn = np.linalg.solve(np.eye(3) + cross / 2, np.eye(3) - cross / 2)
    rotation = turn @ still.cam_from_world[0, :, :3]
    shift = places - rotation @ still.points.mean(axis=0)
    poses = np.concatenate([rotation, shift[:, :, None]], axis=-1)
    return observe(rng, still.camera, poses, still.points, noise_px)


def with_outliers(sequence: PointSequence, rng: np.random.Generator, share: float,
                  ) -> PointSequence:
    """
    Replace a share of the observations by points anywhere in the image.

    Parameters
    ----------
    sequence : PointSequence
        Its camera must have an image size.
    rng : numpy.random.Generator
    share : float
        Between 0 and 1.

    Returns
    -------
    PointSequence
        `outliers` marks the replaced rows.

    """
    tracks = sequence.tracks
    bad = np.zeros(len(tracks), bool)
    bad[rng.choice(len(tracks), int(round(share * len(tracks))), replace=False)] = True
    xy = tracks.xy.copy()
    size = np.array([sequence.camera.width, sequence.camera.height])
    xy[bad] = rng.uniform(-0.5, size - 0.5, (int(bad.sum()), 2))
    return replace(sequence, outliers=bad, tracks=Tracks(tracks.frame, tracks.track, xy,
                                                         tracks.image_size, tracks.stamps_ns))


def winding_course(views: int) -> tuple[np.ndarray, np.ndarray]:
    """Return headings (V,), radians, and places (V, 2), metres, of a vehicle that winds along."""
    step = np.arange(views)
    heading = np.radians(24.0) * np.sin(2 * np.pi * step / 26.0) + np.radians(0.5) * step
    course = heading + np.radians(6.0) * np.sin(0.9 * step)
    stride = 0.16 * (1 + 0.4 * np.sin(0.7 * step + 1.0))
    return heading, np.cumsum(
        stride[:, None] * np.column_stack([np.cos(course), np.sin(course)]), axis=0)


def drive(rng: np.random.Generator, noise_px: float = 0.1, views: int = 24, tracks: int = 2000,
          track_length: int = 24, camera: Camera | None = None, pitch_deg: float = 20.0,
          roll_deg: float = 0.0) -> PointSequence:
    """
    Drive a winding path with a camera pitched down; points come into and go out of sight.

    Parameters
    ----------
    rng : numpy.random.Generator
    noise_px : float
    views : int
    tracks : int
        Number of scene points, spread evenly over the drive.
    track_length : int
        Each point is seen in at most so many consecutive views, and where it lies in the image.
    camera : Camera, optional
        With an image size; by default 640 x 480, f = 520, principal point (320, 240).
    pitch_deg, roll_deg : float
        Mounting of the camera; see `pitched_mount`.

    Returns
    -------
    PointSequence

    """
    if camera is None:
        camera = Camera([[520, 0, 320], [0, 520, 240], [0, 0, 1]], (), 640, 480)
    mount = pitched_mount(np.radians(pitch_deg), np.radians(roll_deg))
    heading, positions = winding_course(views)
    poses = planar_poses(mount, heading, positions)
    points, seen = placed_points(rng, camera, poses, tracks, track_length)
    return planar_sequence(rng, camera, mount, heading, positions, points, noise_px,
                           only_inside=True, seen=seen)


def placed_points(rng: np.random.Generator, camera: Camera, cam_from_world: np.ndarray, count: int,
                  track_length: int, depth_m: tuple[float, float] = (3.0, 10.0),
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Place scene points evenly over a recording and over the image, whatever the lens.

    Each is placed by the pixel and the depth at which one view of its window sees it.

    Parameters
    ----------
    rng : numpy.random.Generator
    camera : Camera
        With an image size.
    cam_from_world : ndarray, shape (V, 3, 4)
    count : int
    track_length : int
        Each point may be seen in so many consecutive views.
    depth_m : (float, float)
        Depth before a pinhole; distance from a lens that sees beyond 90 degrees.

    Returns
    -------
    points : ndarray, shape (count, 3)
    seen : ndarray of bool, shape (V, count)

    """
    views = len(cam_from_world)
    start = np.linspace(1 - track_length / 2, views - track_length / 2, count).round().astype(int)
    anchor = np.clip(start + track_length // 2, 0, views - 1)
    size = [camera.width - 1, camera.height - 1]
    pixel = rng.uniform(0, size, (count, 2))
    depth = rng.uniform(*depth_m, count)
    ray = camera.rays(pixel)
    if camera.lens.is_perspective:
        ray = ray / ray[:, 2:]
    for _ in range(40):
        dark = ~np.isfinite(ray).all(axis=1)
        if camera.lens.is_perspective or not dark.any():
            break
        # outside the circle of a fisheye nothing is seen
        ray[dark] = camera.rays(rng.uniform(0, size, (int(dark.sum()), 2)))
    local = depth[:, None] * np.where(np.isfinite(ray), ray, [0.0, 0.0, 1.0])
    rotation, shift = cam_from_world[anchor, :, :3], cam_from_world[anchor, :, 3]
    points = np.einsum('pji,pj->pi', rotation, local - shift)
    step = np.arange(views)[:, None]
    return points, (step >= start) & (step < start + track_length)


def hand_held(rng: np.random.Generator, noise_px: float = 0.3, views: int = 20, tracks: int = 1000,
              track_length: int = 12, camera: Camera | None = None, turn_deg: float = 20.0,
              shift_m: float = 0.5) -> PointSequence:
    """
    Carry a camera by hand: it turns about all axes and moves along all, smoothly.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the path, too.
    noise_px : float
    views, tracks, track_length : int
        As for `drive`.
    camera : Camera, optional
        As for `drive`.
    turn_deg, shift_m : float
        About how far it turns and moves to either side.

    Returns
    -------
    PointSequence

    """
    camera = Camera([[520, 0, 320], [0, 520, 240], [0, 0, 1]], (), 640, 480) if camera is None \
        else camera
    phase = 2 * np.pi * np.linspace(0, 1, views)[:, None] * [1.0, 2.0, 3.0]
    waves = []
    for _ in range(2):
        size = rng.standard_normal((3, 3))
        late = rng.uniform(0, 2 * np.pi, (3, 1, 3))
        waves.append((size[:, None] / np.linalg.norm(size) * np.sin(phase + late)).sum(axis=2).T)
    rotation = rotation_matrix(1.8 * np.radians(turn_deg) * waves[0])
    centres = 1.8 * shift_m * waves[1]
    poses = np.concatenate([rotation, -rotation @ centres[:, :, None]], axis=-1)
    points, seen = placed_points(rng, camera, poses, tracks, track_length)
    return observe(rng, camera, poses, points, noise_px, only_inside=True, seen=seen)
