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
Sequences at, near and beyond the edge of what self-calibration can do, with their truth.

What a robot may record by accident: motions that leave parameters open, scenes that leave the
motion open, and images that are not what the model supposes. A calibration must be right within
its sigmas on each, or refuse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.scenes import (mount_from_axis, observe, pitched_mount, planar_poses,
                                          PointSequence)
from selfcal_ros.synthetic.special_scenes import with_outliers
from selfcal_ros.values.tracks import Tracks

#: The camera of the scenes, unless they say otherwise.
CAMERA = Camera([[520, 0, 328], [0, 520, 235], [0, 0, 1]], [-0.05, 0.01, 0, 0], 640, 480)
NOISE_PX = 0.2
#: Views and points of a scene, unless it says otherwise.
VIEWS, POINTS = 12, 300


def s_curve(views: int = VIEWS, turn_deg: float = 30.0, step_m: float = 0.2,
            ) -> tuple[np.ndarray, np.ndarray]:
    """Heading (V,) in radians and position (V, 2) of a drive to the left, then to the right."""
    heading = np.radians(np.interp(np.linspace(0, 1, views), [0, 0.5, 1], [0, turn_deg, 0]))
    return heading, _driven(heading, step_m)


def one_curve(views: int = VIEWS, turn_deg: float = 30.0, step_m: float = 0.2,
              ) -> tuple[np.ndarray, np.ndarray]:
    """Heading and position of a drive along one circle."""
    heading = np.radians(np.linspace(0, turn_deg, views))
    middle = heading - heading[1] / 2       # the chords of a circle, not a polygon of tangents
    return heading, _driven(middle, step_m)


def on_the_spot(views: int = VIEWS, turn_deg: float = 60.0, radius_m: float = 0.1,
                ) -> tuple[np.ndarray, np.ndarray]:
    """Heading and position of a camera that is carried around a vertical axis."""
    heading = np.radians(np.linspace(0, turn_deg, views))
    return heading, radius_m * np.column_stack([np.cos(heading), np.sin(heading)])


def straight(views: int = VIEWS, course_deg: float = 0.0, step_m: float = 0.2,
             ) -> tuple[np.ndarray, np.ndarray]:
    """Heading and position of a drive without a turn."""
    course = np.radians(course_deg)
    return np.zeros(views), np.arange(views)[:, None] * step_m * np.array([np.cos(course),
                                                                           np.sin(course)])


def _driven(heading: np.ndarray, step_m: float) -> np.ndarray:
    steps = step_m * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.asarray(np.cumsum(steps, axis=0) - steps[0])


def vehicle(rng: np.random.Generator, path: tuple[np.ndarray, np.ndarray], pitch_deg: float = 20.0,
            **options: Any) -> PointSequence:
    """Carry the camera along a path of heading and position, pitched down."""
    return scene(rng, planar_poses(pitched_mount(np.radians(pitch_deg)), *path), **options)


def about_axis(rng: np.random.Generator, axis: ArrayLike, path: tuple[np.ndarray, np.ndarray],
               **options: Any) -> PointSequence:
    """Move in a plane whose normal is `axis` in the camera frame."""
    return scene(rng, planar_poses(mount_from_axis(axis), *path), **options)


def hand(rng: np.random.Generator, turns_deg: ArrayLike, shift_m: float = 0.3, **options: Any,
         ) -> PointSequence:
    """Turn the camera by rotation vectors (V, 3), and move it at random."""
    turns = np.radians(np.asarray(turns_deg, float))
    R = rotation_matrix(turns)
    centres = rng.uniform(-shift_m, shift_m, (len(turns), 3))
    return scene(rng, np.concatenate([R, -R @ centres[:, :, None]], axis=2), **options)


def scene(rng: np.random.Generator, poses: np.ndarray, camera: Camera = CAMERA,
          count: int = POINTS, depth_m: tuple[float, float] = (1.5, 12.0),
          noise_px: float = NOISE_PX, pixels: tuple[float, float, float, float] | None = None,
          surface: Callable[[np.ndarray], np.ndarray] | None = None,
          seen: Callable[[int, int], np.ndarray] | None = None) -> PointSequence:
    """
    Observe points that lie before the cameras.

    Parameters
    ----------
    rng : numpy.random.Generator
    poses : ndarray, shape (V, 3, 4)
    camera : Camera
    count : int
        Points.
    depth_m : (float, float)
        Nearest and farthest in the view that a point is placed in; uniform in the inverse.
    noise_px : float
    pixels : (float, float, float, float), optional
        Part of the image, in shares of it, where points are placed: left, top, right, bottom.
    surface : callable, optional
        surface(points (P, 3)) moves the points onto a surface.
    seen : callable, optional
        seen(views, points) restricts visibility: bool (V, P).

    Returns
    -------
    PointSequence

    """
    left, top, right, bottom = pixels or (0, 0, 1, 1)
    size = np.array([camera.width - 1, camera.height - 1])
    xy = rng.uniform(size * (left, top), size * (right, bottom), (count, 2))
    depth = 1 / rng.uniform(1 / depth_m[1], 1 / depth_m[0], count)
    anchor = rng.integers(0, len(poses), count)
    local = depth[:, None] * np.column_stack([camera.normalised(xy), np.ones(count)])
    points = np.einsum('pji,pj->pi', poses[anchor, :, :3], local - poses[anchor, :, 3])
    if surface is not None:
        points = surface(points)
    return observe(rng, camera, poses, points, noise_px, only_inside=True,
                   seen=None if seen is None else seen(len(poses), count))


def ground(points: np.ndarray) -> np.ndarray:
    """Drop points onto a floor, 1.2 m below the camera."""
    return np.column_stack([points[:, :2], np.full(len(points), -1.2)])


def wall(points: np.ndarray) -> np.ndarray:
    """Move points onto a wall across the first view's course, 4 m ahead."""
    return np.column_stack([np.full(len(points), 4.0), points[:, 1:]])


def corner(points: np.ndarray) -> np.ndarray:
    """Put one half of the points on a wall and the other on the floor."""
    half = np.arange(len(points)) % 2 == 0
    return np.where(half[:, None], wall(points), ground(points))


def on_cylinder(points: np.ndarray, radius_m: float = 2.0) -> np.ndarray:
    """
    Move points onto the upright cylinder through a circular path of that radius.

    Cameras and points on one ruled quadric are critical for the reconstruction.
    """
    centre = np.array([0.0, radius_m])
    away = points[:, :2] - centre
    away *= radius_m / np.linalg.norm(away, axis=1, keepdims=True)
    return np.column_stack([centre + away, points[:, 2]])


def with_mover(sequence: PointSequence, rng: np.random.Generator, share: float,
               step_m: Sequence[float] = (0.05, -0.08, 0.02)) -> PointSequence:
    """Let a share of the points belong to a body that moves on its own, from view to view."""
    moving = rng.uniform(size=len(sequence.points)) < share
    tracks, camera = sequence.tracks, sequence.camera
    rows = np.flatnonzero(moving[tracks.track])
    place = sequence.points[tracks.track[rows]] + tracks.frame[rows, None] * np.array(step_m)
    poses = sequence.cam_from_world[tracks.frame[rows]]
    local = np.einsum('nij,nj->ni', poses[:, :, :3], place) + poses[:, :, 3]
    xy = tracks.xy.copy()
    xy[rows] = camera.project(local) + NOISE_PX * rng.standard_normal((len(rows), 2))
    return _keeping(sequence, xy, np.isfinite(xy).all(axis=1))


def with_dirt(sequence: PointSequence, rng: np.random.Generator, share: float) -> PointSequence:
    """Let a share of the tracks stay where they are in the image, as dirt on the lens does."""
    tracks = sequence.tracks
    dirty = rng.uniform(size=len(sequence.points)) < share
    place = rng.uniform(0, [sequence.camera.width - 1, sequence.camera.height - 1],
                        (len(sequence.points), 2))
    rows = np.flatnonzero(dirty[tracks.track])
    xy = tracks.xy.copy()
    xy[rows] = place[tracks.track[rows]] + NOISE_PX * rng.standard_normal((len(rows), 2))
    return _keeping(sequence, xy, np.ones(len(xy), bool))


def rolled(sequence: PointSequence, rng: np.random.Generator, readout: float) -> PointSequence:
    """
    Expose the rows of each image one after the other, over a share of the time between images.

    Every row sees the pose interpolated linearly to its own time.
    """
    tracks, camera = sequence.tracks, sequence.camera
    late = readout * (tracks.xy[:, 1] / camera.height - 0.5)
    poses = sequence.cam_from_world
    following = np.clip(tracks.frame + np.where(late > 0, 1, -1), 0, len(poses) - 1)
    X = sequence.points[tracks.track]

    def seen(frame: np.ndarray) -> np.ndarray:
        turned: np.ndarray = np.einsum('nij,nj->ni', poses[frame][:, :, :3], X)
        return np.asarray(turned + poses[frame][:, :, 3])

    blend = np.abs(late)[:, None]
    xy = camera.project((1 - blend) * seen(tracks.frame) + blend * seen(following))
    xy += NOISE_PX * rng.standard_normal(xy.shape)
    return _keeping(sequence, xy, np.isfinite(xy).all(axis=1))


def bumpy(rng: np.random.Generator, tilt_deg: float, **options: Any) -> PointSequence:
    """Drive an S over uneven ground."""
    poses = planar_poses(pitched_mount(np.radians(20)), *s_curve())
    shake = rotation_matrix(np.radians(tilt_deg) * rng.standard_normal((len(poses), 3)))
    return scene(rng, shake @ poses, **options)


def short_tracks(rng: np.random.Generator, length: int) -> Callable[[int, int], np.ndarray]:
    """Restrict every point to so many successive views."""
    def seen(views: int, points: int) -> np.ndarray:
        first = rng.integers(0, views - length + 1, points)
        view = np.arange(views)[:, None]
        return (view >= first) & (view < first + length)
    return seen


def _keeping(sequence: PointSequence, xy: np.ndarray, kept: np.ndarray) -> PointSequence:
    tracks = sequence.tracks
    return PointSequence(Tracks(tracks.frame[kept], tracks.track[kept], xy[kept],
                                tracks.image_size),
                         sequence.camera, sequence.cam_from_world, sequence.points,
                         sequence.axis, sequence.true_pixels, np.zeros(int(kept.sum()), bool))


def _lens(focal_px: float = 520, distortion: Sequence[float] = (-0.05, 0.01, 0, 0)) -> Camera:
    K = np.array([[focal_px, 0, 328], [0, focal_px, 235], [0, 0, 1]])
    return Camera(K, distortion, 640, 480)


def _drive_with(change: Callable[..., PointSequence], *arguments: float,
                ) -> Callable[[np.random.Generator], PointSequence]:
    return lambda rng: change(vehicle(rng, s_curve()), rng, *arguments)


def _turns(axis: ArrayLike, size_deg: float = 12.0, views: int = 6) -> np.ndarray:
    return np.outer(size_deg * np.sin(1.7 * np.arange(views) + 0.3), np.asarray(axis))


#: Every sequence by name: a function of a random generator.
HARD_SCENES: dict[str, Callable[[np.random.Generator], PointSequence]] = {
    'S-curve, level camera': partial(vehicle, path=s_curve(), pitch_deg=0),
    'S-curve, camera 1 degree down': partial(vehicle, path=s_curve(), pitch_deg=1),
    'S-curve of 2 degrees': partial(vehicle, path=s_curve(turn_deg=2)),
    'one curve, level camera': partial(vehicle, path=one_curve(), pitch_deg=0),
    'one circle of 30 degrees': partial(vehicle, path=one_curve()),
    'one circle of 180 degrees': partial(vehicle, path=one_curve(24, 180)),
    'one circle of 3 degrees': partial(vehicle, path=one_curve(turn_deg=3)),
    'on the spot, 0.1 m off the axis': partial(vehicle, path=on_the_spot()),
    'on the spot, 1 mm off the axis': partial(vehicle, path=on_the_spot(radius_m=1e-3)),
    'on the spot, no translation': partial(vehicle, path=on_the_spot(radius_m=0)),
    'forward only': partial(vehicle, path=straight()),
    'forward only, level': partial(vehicle, path=straight(), pitch_deg=0),
    'sideways only': partial(vehicle, path=straight(course_deg=90)),
    'forward, a turn of half a degree': partial(vehicle, path=s_curve(turn_deg=0.5)),
    'about image x, S-curve': partial(about_axis, axis=(1, 0, 0), path=s_curve()),
    'about image y, S-curve': partial(about_axis, axis=(0, 1, 0), path=s_curve()),
    'about the optical axis, S-curve': partial(about_axis, axis=(0, 0, 1), path=s_curve()),
    'general, about x only': partial(hand, turns_deg=_turns((1, 0, 0))),
    'general, about y only': partial(hand, turns_deg=_turns((0, 1, 0))),
    'general, about z only': partial(hand, turns_deg=_turns((0, 0, 1))),
    'general, 1 degree': partial(hand, turns_deg=np.array(
        [[0, 0, 0], [0.7, 0.1, 0.4], [-0.4, 0.6, -0.9], [0.2, -0.8, 0.5]])),
    'general, three views': partial(hand, turns_deg=[[0, 0, 0], [9, 2, 4], [-5, 8, -9]]),
    'two views': partial(hand, turns_deg=[[0, 0, 0], [9, 5, 4]]),
    'three views in a row, turning': partial(vehicle, path=(
        np.radians([0, 12, 20]), np.array([[0, 0], [0.3, 0], [0.6, 0]]))),
    'one image twelve times': partial(vehicle, path=(np.zeros(VIEWS), np.zeros((VIEWS, 2)))),
    'floor only': partial(vehicle, path=s_curve(), surface=ground),
    'wall only': partial(vehicle, path=s_curve(), surface=wall),
    'floor and wall': partial(vehicle, path=s_curve(), surface=corner),
    'points and path on one cylinder': partial(
        vehicle, path=one_curve(24, 90, 2 * 2.0 * np.sin(np.radians(90 / 23) / 2)),
        surface=on_cylinder, pitch_deg=5),
    'far scene, 200 steps away': partial(vehicle, path=s_curve(), depth_m=(40, 400)),
    'far scene, 2000 steps away': partial(vehicle, path=s_curve(), depth_m=(400, 4000)),
    'tiny baseline': partial(vehicle, path=s_curve(step_m=1e-3)),
    'a moving body, a fifth of the points': _drive_with(with_mover, 0.2),
    'a moving body, two thirds of the points': _drive_with(with_mover, 0.67),
    'dirt, a third of the tracks': _drive_with(with_dirt, 0.33),
    'outliers, a fifth': lambda rng: with_outliers(vehicle(rng, s_curve()), rng, 0.2),
    'outliers, two thirds': lambda rng: with_outliers(vehicle(rng, s_curve()), rng, 0.67),
    'rolling shutter, a tenth of the interval': _drive_with(rolled, 0.1),
    'uneven ground, 0.3 degrees': partial(bumpy, tilt_deg=0.3),
    'uneven ground, 3 degrees': partial(bumpy, tilt_deg=3.0),
    'noise of 3 px': partial(vehicle, path=s_curve(), noise_px=3.0),
    '8 points': partial(vehicle, path=s_curve(), count=8),
    '16 points': partial(vehicle, path=s_curve(), count=16),
    'tracks of two views': lambda rng: vehicle(rng, s_curve(), seen=short_tracks(rng, 2)),
    'tracks of three views': lambda rng: vehicle(rng, s_curve(), seen=short_tracks(rng, 3)),
    'points in a corner of the image': partial(vehicle, path=s_curve(),
                                               pixels=(0, 0.6, 0.35, 1)),
    'long lens': partial(vehicle, path=s_curve(turn_deg=8), camera=_lens(3000)),
    'wide lens, k3': partial(vehicle, path=s_curve(),
                             camera=_lens(330, (-0.25, 0.08, 0, 0, -0.012))),
}
