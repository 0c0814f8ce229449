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
Tracks of a camera whose rows are read one after the other, with their truth.

Paths are functions of time. A point is seen where the camera is when the row that it falls on is
read: row and time are found together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix, twist_matrix
from selfcal_ros.synthetic.scenes import pitched_mount
from selfcal_ros.values.tracks import Tracks

#: Poses (n,) → rotations (n, 3, 3) and centres (n, 3); time in seconds.
Path = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
CAMERA = Camera([[520, 0, 328], [0, 520, 235], [0, 0, 1]], [-0.12, 0.05, 0, 0], 640, 480)
#: Turns of the sums of sines, cycles over the length of a path.
_CYCLES = np.array([1.0, 2.0, 3.0])


@dataclass(frozen=True)
class RollingSequence:
    """
    Tracks, and what made them.

    Attributes
    ----------
    tracks : Tracks
        With stamps.
    camera : Camera
    readout_s : float
        Time in which all rows are read.

    """

    tracks: Tracks
    camera: Camera
    readout_s: float

    @property
    def line_delay_s(self) -> float:
        """Seconds from one row to the next."""
        return self.readout_s / self.camera.height


def drive(rng: np.random.Generator, length_s: float = 6.0, turn_deg: float = 45.0,
          travel_m: float = 3.0, pitch_deg: float = 18.0) -> Path:
    """Drive an S with a few wiggles; the camera is carried ahead of the axle, pitched down."""
    phase = rng.uniform(-0.4, 0.4, 2)
    grid = np.linspace(-0.1, 1.1, 500)

    def heading(share: np.ndarray) -> np.ndarray:
        wiggle = 8 * np.sin(5 * np.pi * share + phase[1])
        return np.asarray(np.radians(turn_deg * np.sin(2 * np.pi * share + phase[0]) + wiggle))

    course = np.column_stack([np.cos(heading(grid)), np.sin(heading(grid))]) * travel_m
    place = CubicSpline(grid, course).antiderivative()
    mount = pitched_mount(np.radians(pitch_deg))

    def pose(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = np.asarray(time, float) / length_s
        angle = heading(share)
        body = np.concatenate([place(share), np.full((*np.shape(share), 1), 0.6)], axis=-1)
        ahead = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        return mount @ twist_matrix(-angle), body + 0.3 * ahead

    return pose


def hand(rng: np.random.Generator, length_s: float = 6.0, turn_deg: float = 20.0,
         shift_m: float = 0.5) -> Path:
    """Wave a camera: sums of sines about all axes and along all of them."""
    turn, shift = rng.normal(size=(2, 3, 3))
    turn *= 1.8 * np.radians(turn_deg) / np.linalg.norm(turn)
    shift *= 1.8 * shift_m / np.linalg.norm(shift)
    phase = rng.uniform(0, 2 * np.pi, (2, 3, 3))
    forward = pitched_mount(0.0)

    def pose(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle = 2 * np.pi * np.asarray(time, float)[..., None, None] / length_s * _CYCLES
        turned = np.sum(turn * np.sin(angle + phase[0]), axis=-1)
        return (rotation_matrix(turned) @ forward,
                np.sum(shift * np.sin(angle + phase[1]), axis=-1))

    return pose


def record(rng: np.random.Generator, path: Path, readout_s: float, times: np.ndarray,
           camera: Camera = CAMERA, points: int = 500, noise_px: float = 0.2,
           depth_m: tuple[float, float] = (1.5, 8.0),
           interval_s: float | None = None) -> RollingSequence:
    """
    Observe points that lie before the camera somewhere on its path.

    Parameters
    ----------
    rng : numpy.random.Generator
    path : callable
    readout_s : float
        From the first row to the one after the last; negative from the lowest row up.
    times : ndarray, shape (V,)
        When the middle rows are read, seconds.
    camera : Camera
    points : int
    noise_px : float
    depth_m : (float, float)
        Nearest and farthest in the view that a point is placed in; uniform in the inverse.
    interval_s : float, optional
        Between the images of a video, of which these views are some.

    Returns
    -------
    RollingSequence

    """
    times = np.asarray(times, float)
    R, centre = path(times)
    size = np.array([camera.width, camera.height])
    depth = 1 / rng.uniform(1 / depth_m[1], 1 / depth_m[0], points)
    rays = camera.rays(rng.uniform(0, size - 1, (points, 2)))
    anchor = rng.integers(0, len(times), points)
    X = centre[anchor] + np.einsum('pji,pj->pi', R[anchor], rays * depth[:, None])

    def image(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        taken = instants = np.broadcast_to(times[:, None], (len(times), points))
        for _ in range(8):
            R, centre = path(taken)
            local = np.einsum('vpij,vpj->vpi', R, X - centre)
            xy = camera.project(local)
            seen = (local[..., 2] > 0.2) & ((xy > 0) & (xy < size - 1)).all(axis=-1)
            row = np.where(seen, xy[..., 1], (camera.height - 1) / 2)
            taken = instants + readout_s * (row - (camera.height - 1) / 2) / camera.height
        return xy, seen

    xy, seen = image(times)
    frame, track = np.nonzero(seen)
    noisy = xy[frame, track] + rng.normal(0, noise_px, (len(frame), 2))
    stamps = {k: round(1e9 * time) for k, time in enumerate(times)}
    beside = None
    if interval_s is not None:
        beside = np.full((len(frame), 2, 3), np.nan)
        for side, step in enumerate((-interval_s, interval_s)):
            moved, there = image(times + step)
            beside[:, side, :2] = moved[frame, track] + rng.normal(0, noise_px, noisy.shape)
            beside[:, side, 2] = np.where(there[frame, track], step, np.nan)
    tracks = Tracks(frame, track, noisy, (camera.width, camera.height), stamps, beside)
    return RollingSequence(tracks.with_at_least(3), camera, readout_s)
