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
Few images: general views of a cloud of points, and equal objects in one image.

Both kinds fill the middle of the image whatever the camera is. That holds, too, where its
principal point lies far off, as in an image that was cut out of a larger one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.scenes import observe, PointSequence
from selfcal_ros.values.tracks import Tracks

#: Where equal objects stand in the image, as fractions of width and height from its middle, and
#: how far, in units of the distance at which an object's half side fills a quarter of the width.
_PLACES = ((-0.25, -0.22, 1.1), (0.25, -0.22, 0.95), (-0.25, 0.22, 1.0), (0.25, 0.22, 1.2),
           (0.0, 0.0, 1.3), (0.0, -0.25, 1.15))


def cut_camera(focal_px: float = 700.0, aspect: float = 1.0,
               offset: tuple[float, float] = (10.0, -4.0), size: tuple[int, int] = (640, 480),
               ) -> Camera:
    """
    Camera whose principal point lies off the middle of the image.

    Parameters
    ----------
    focal_px : float
        fx.
    aspect : float
        fy over fx.
    offset : (float, float)
        Of the principal point from the middle of the image, pixels.
    size : (int, int)
        Width and height, pixels.

    """
    middle = (np.array(size) - 1) / 2
    return Camera([[focal_px, 0, middle[0] + offset[0]],
                   [0, focal_px * aspect, middle[1] + offset[1]], [0, 0, 1]],
                  width=size[0], height=size[1])


def _middle_ray(camera: Camera) -> np.ndarray:
    """Direction of the middle of the image, z = 1."""
    middle = (camera.width - 1) / 2, (camera.height - 1) / 2
    return np.linalg.solve(camera.K, [*middle, 1.0])


def _inside(xy: np.ndarray, camera: Camera) -> np.ndarray:
    """Mark the points that lie in the image."""
    return np.asarray(np.all((xy >= 0) & (xy <= [camera.width - 1, camera.height - 1]), axis=1))


def random_turns(rng: np.random.Generator, views: int, largest_deg: float) -> np.ndarray:
    """Rotations (views, 3, 3) about random axes, by 0.4 to 1 times the largest angle."""
    axes = rng.normal(size=(views, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return rotation_matrix(np.radians(axes * rng.uniform(0.4, 1, (views, 1)) * largest_deg))


def general_views(rng: np.random.Generator, camera: Camera, views: int = 4, points: int = 80,
                  largest_deg: float = 25.0, noise_px: float = 0.1,
                  turns: np.ndarray | None = None) -> PointSequence:
    """
    See a cloud of points from few places, turned about random axes.

    Parameters
    ----------
    rng : numpy.random.Generator
    camera : Camera
    views, points : int
    largest_deg : float
        Of the turns, degrees.
    noise_px : float
    turns : ndarray, shape (views, 3, 3), optional
        In place of random ones.

    Returns
    -------
    PointSequence

    """
    cloud = rng.uniform(-1, 1, (points, 3)) * [1.0, 0.8, 0.9]
    distance = max(3.2 * camera.K[0, 0] / camera.width, 2.6)
    turns = random_turns(rng, views, largest_deg) if turns is None else turns
    aim = (_middle_ray(camera) + rng.uniform(-0.06, 0.06, (views, 3)) * [1, 1, 0]) * distance
    aim *= rng.uniform(0.9, 1.15, (views, 1))
    poses = np.concatenate([turns, aim[:, :, None]], axis=2)
    sequence = observe(rng, camera, poses, cloud, noise_px)
    inside = _inside(sequence.tracks.xy, camera)
    return replace(sequence, tracks=sequence.tracks.select(inside),
                   outliers=sequence.outliers[inside])


def equal_objects(rng: np.random.Generator, camera: Camera, turns_deg: ArrayLike, points: int = 40,
                  noise_px: float = 0.1, farness: float = 1.0) -> Tracks:
    """
    See equal solids in one image.

    Parameters
    ----------
    rng : numpy.random.Generator
    camera : Camera
    turns_deg : array_like, shape (n, 3)
        Rotation vectors of up to six objects, degrees; equal ones stand parallel.
    points : int
        Of one object.
    noise_px : float
    farness : float
        Of the objects against their size; the larger, the less perspective is in each.

    Returns
    -------
    Tracks
        The frame is the object, the track the point on it.

    """
    turns = rotation_matrix(np.radians(np.asarray(turns_deg, float)))
    solid = rng.uniform(-1, 1, (points, 3)) / farness
    distance = 1.7 * 4 * camera.K[0, 0] / camera.width
    size = np.array([camera.width, camera.height])
    found = []
    for turn, (x, y, depth) in zip(turns, _PLACES):
        pixel = (size - 1) / 2 + np.array([x, y]) * size
        centre = np.linalg.solve(camera.K, [*pixel, 1.0]) * depth * distance
        found.append(camera.project(solid @ turn.T + centre))
    xy = np.stack(found)
    xy += noise_px * rng.normal(size=xy.shape)
    frame, track = np.divmod(np.arange(len(turns) * points), points)
    tracks = Tracks(frame, track, xy.reshape(-1, 2), (camera.width, camera.height))
    return tracks.select(_inside(tracks.xy, camera))
