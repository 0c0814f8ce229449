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
"""A first pose: from clicked points, and from the files that ViSP's trackers start with."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.errors import ArgumentError, InputError
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.rorapid.projection.camera_models import ObjectPose, ProjectedPoints, Projection
from selfcal_ros.values.foreign_files import read_limited

#: Longer files are not what they claim to be.
_MAX_BYTES = 1_000_000


def read_init(path: str | Path) -> np.ndarray:
    """
    Read the object points of an ``.init`` file: their number, then ``X Y Z`` per line.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    ndarray, shape (n, 3)
        Metres; ``#`` starts a comment.

    Raises
    ------
    InputError
        If the file cannot be read or is not of this form.

    """
    path = Path(path)
    values = _numbers(path)
    count = values[0] if len(values) else 0.0
    if count != int(count) or not 3 <= count <= 10_000 or len(values) != 1 + 3 * int(count):
        raise InputError(f'{path}: an .init file holds the number of points (at least 3) and then '
                         f'three coordinates for each; this one holds {len(values)} numbers.')
    return values[1:].reshape(-1, 3)


def read_pose_file(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """
    Read a pose: six numbers ``tx ty tz rx ry rz`` (metres, angle-axis radians).

    Parameters
    ----------
    path : str or Path
        A ``.pos`` file.

    Returns
    -------
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)

    Raises
    ------
    InputError
        If the file cannot be read or is not of this form.

    """
    path = Path(path)
    values = _numbers(path)
    if len(values) != 6:
        raise InputError(f'{path}: a pose is six numbers, tx ty tz rx ry rz; this file holds '
                         f'{len(values)}.')
    return rotation_matrix(values[3:]), values[:3]


def _numbers(path: Path) -> np.ndarray:
    """All numbers of a text file, comments left out."""
    text = read_limited(path, _MAX_BYTES).decode('utf-8-sig', errors='replace')
    words = ' '.join(line.split('#', 1)[0] for line in text.splitlines()).replace(';', ' ')
    try:
        values = np.array([float(word) for word in words.split()])
    except ValueError as error:
        wrong = str(error).rpartition(': ')[2]
        raise InputError(f'{path} holds {wrong:.60}, where numbers are expected.') from None
    if not np.isfinite(values).all():
        raise InputError(f'{path}: every number must be finite.')
    return values


def pose_from_clicks(object_points: ArrayLike, image_points: ArrayLike, camera: Camera,
                     ) -> tuple[np.ndarray, np.ndarray, float]:
    """
    Pose of an object from a few of its points, clicked in the image.

    Starts of all kinds are refined side by side by Gauss-Newton on the reprojection; the best
    that has every point before the camera wins. Four points or more, or three points and luck
    (three leave up to four poses).

    Parameters
    ----------
    object_points : array_like, shape (n, 3)
        Metres.
    image_points : array_like, shape (n, 2)
        Pixels of the (distorted) image.
    camera : Camera

    Returns
    -------
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)
    rms_px : float
        Of the reprojection.

    Raises
    ------
    ArgumentError
        If the points are too few, do not match, lie on a line, or no pose explains them.

    """
    points = np.asarray(object_points, float)
    pixels = np.asarray(image_points, float)
    if points.ndim != 2 or points.shape[1:] != (3,) or pixels.shape != (len(points), 2):
        raise ArgumentError('Give as many image points (u, v) as object points (X, Y, Z); these '
                            f'are {pixels.shape} and {points.shape}.')
    if len(points) < 3 or not (np.isfinite(points).all() and np.isfinite(pixels).all()):
        raise ArgumentError('A pose needs at least three finite points.')
    centre = points.mean(axis=0)
    local = points - centre
    spread = np.linalg.svd(local, compute_uv=False)
    if not spread[1] > 1e-6 * max(spread[0], 1e-300):
        raise ArgumentError('The object points lie on a line; click others.')
    xy = camera.normalised(pixels)
    if not np.isfinite(xy).all():
        raise ArgumentError('A clicked point lies where the lens model cannot be inverted.')
    middle = xy.mean(axis=0)
    size = np.sqrt(((xy - middle)**2).sum(axis=1).mean())
    radius = np.sqrt((local**2).sum(axis=1).mean())
    if not size > 0:
        raise ArgumentError('All clicked points are the same.')
    projection = Projection(camera)
    best, best_cost = None, np.inf
    for rotation in _spread_rotations():
        flat = (local @ rotation.T)[:, :2]
        seen = np.sqrt((flat**2).sum(axis=1).mean())
        depth = max(seen, 0.2 * radius) / size
        state = ObjectPose(rotation, depth * np.array([*middle, 1.0]))
        state, cost = _refine(projection, state, local, pixels, steps=8)
        if cost < best_cost:
            best, best_cost = state, cost
    if best is None:
        raise ArgumentError('No pose puts the object before the camera; check the order of the '
                            'clicks.')
    best, best_cost = _refine(projection, best, local, pixels, steps=50)
    rms = float(np.sqrt(best_cost / len(points)))
    return best.rotation, best.translation - best.rotation @ centre, rms


def _spread_rotations() -> Iterator[np.ndarray]:
    """Rotations spread over all orientations: 12 viewing directions times 6 turns."""
    golden = np.pi * (3 - np.sqrt(5))
    for k in range(12):
        z = 1 - (2 * k + 1) / 12
        tilt = np.arccos(z) * np.array([-np.sin(golden * k), np.cos(golden * k), 0.0])
        for turn in range(6):
            yield rotation_matrix(np.array([0, 0, turn * np.pi / 3])) @ rotation_matrix(tilt)


def _refine(projection: Projection, state: ObjectPose, points: np.ndarray, pixels: np.ndarray,
            steps: int) -> tuple[ObjectPose, float]:
    """Levenberg-Marquardt on the reprojection; cost is the sum of squares, pixels."""
    directions = np.repeat(np.eye(2), len(points), axis=0)

    def evaluate(state: ObjectPose) -> tuple[ProjectedPoints, float]:
        seen = projection.project(state, points)
        behind = (seen.turned[:, 2] + state.translation[2] <= 1e-6).any()
        return seen, np.inf if behind else float(((seen.pixels - pixels)**2).sum())

    seen, cost = evaluate(state)
    damping = 1e-3
    for _ in range(steps):
        if not np.isfinite(cost):
            break
        J = np.vstack([projection.rows(state, seen, directions[:len(points)]),
                       projection.rows(state, seen, directions[len(points):])])
        r = (pixels - seen.pixels).T.ravel()
        H, g = J.T @ J, J.T @ r
        for _ in range(6):
            q = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12), g)
            trial = projection.moved(state, q)
            trial_seen, trial_cost = evaluate(trial)
            if trial_cost < cost:
                break
            damping *= 5
        else:
            break
        done = cost - trial_cost < 1e-12 * cost
        state, seen, cost, damping = trial, trial_seen, trial_cost, max(damping / 5, 1e-9)
        if done:
            break
    return state, cost
