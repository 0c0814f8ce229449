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
"""What the page's viewer shows: camera path and structure, as numbers for its script."""

from __future__ import annotations

import base64
from dataclasses import dataclass
import json

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.metric_structure import metres_a_step, metric_structure
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.values.tracks import Tracks

#: More points than this make the page large and not clearer.
MAX_POINTS = 6000
#: Points farther from the path than so many times its extent are left out.
FARTHEST = 12.0


@dataclass(frozen=True)
class Scene:
    """
    Path and structure in a frame whose z axis points up.

    Attributes
    ----------
    cam_from_world : ndarray, shape (V, 3, 4)
    frames : ndarray of int, shape (V,)
    points : ndarray, shape (P, 3)
    tracks : ndarray of int, shape (P,)
    colours : ndarray of uint8, shape (P, 3), or None
        Red, green, blue.
    corners : ndarray, shape (4, 2)
        Of the undistorted image, on the plane at depth 1 of a camera.
    unit : str
        Of length, for a person.
    path : bool
        The views follow each other; False for views of an object held anyhow.

    """

    cam_from_world: np.ndarray
    frames: np.ndarray
    points: np.ndarray
    tracks: np.ndarray
    colours: np.ndarray | None
    corners: np.ndarray
    unit: str
    path: bool

    def as_json(self) -> str:
        """Return numbers alone, 32-bit and little-endian in base64: no text from outside."""
        R = self.cam_from_world[:, :, :3]
        centres = camera_centres(self.cam_from_world)
        # centre, then the camera's axes: right, down, ahead
        cameras = np.concatenate([centres, R.reshape(-1, 9)], axis=1)
        return json.dumps({
            'cameras': _packed(cameras), 'points': _packed(self.points),
            'colours': None if self.colours is None else
            base64.b64encode(np.asarray(self.colours, np.uint8).tobytes()).decode('ascii'),
            'frames': np.asarray(self.frames).tolist(),
            'corners': np.round(self.corners, 5).tolist(), 'unit': self.unit,
            'path': self.path})


def _packed(values: np.ndarray) -> str:
    return base64.b64encode(np.asarray(values, '<f4').tobytes()).decode('ascii')


def scene_of(result: Calibration, tracks: Tracks,
             colours: dict[int, tuple[int, int, int]] | None = None) -> Scene | None:
    """
    Gather what there is to be seen.

    Parameters
    ----------
    result : Calibration
    tracks : Tracks
        Those that were calibrated from; they tell how well each point is known.
    colours : dict, optional
        Red, green and blue of tracks.

    Returns
    -------
    Scene or None
        None where there is no depth (a camera that only rotates), or less than two views.

    """
    shape, camera = result.reconstructed, result.camera
    poses = np.asarray(shape.cam_from_world, float)
    if result.motion == 'rotation' or min(camera.width, camera.height) <= 0 or len(poses) < 2 \
            or not np.isfinite(poses).all():
        return None
    if result.motion == 'known-object':
        points = np.asarray(shape.points, float)
        finite = np.isfinite(points).all(axis=1) & (np.abs(points[:, 3]) > 1e-9)
        ids, points = np.asarray(shape.tracks)[finite], points[finite, :3] / points[finite, 3:]
        poses, points = _object_upright(poses, points)
        unit, path = 'm', False
    else:
        structure = metric_structure(result, tracks)
        poses, points, ids = structure.cam_from_world, structure.points, structure.tracks
        unit = 'steps between views' if metres_a_step(result) is None else 'm'
        path = True
    chosen = _near(poses, points)
    if len(chosen) > MAX_POINTS:
        chosen = chosen[np.linspace(0, len(chosen) - 1, MAX_POINTS).astype(int)]
    ids = np.asarray(ids)[chosen]
    paint = None
    if colours:
        paint = np.array([colours.get(track, (128, 128, 128)) for track in ids.tolist()],
                         np.uint8).reshape(-1, 3)
    K = camera.K
    borders = np.array([[-0.5, -0.5], [camera.width - 0.5, -0.5],
                        [camera.width - 0.5, camera.height - 0.5], [-0.5, camera.height - 0.5]])
    corners = (borders - K[:2, 2]) / np.diag(K)[:2]
    return Scene(poses, np.asarray(shape.frames), points[chosen], ids, paint, corners, unit, path)


def _near(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the indices of the points that are not so far away that they dwarf the path."""
    centres = camera_centres(poses)
    middle = centres.mean(axis=0)
    extent = max(float(np.ptp(centres, axis=0).max()), 1e-9)
    return np.flatnonzero(np.linalg.norm(points - middle, axis=1) < FARTHEST * extent)


def _object_upright(poses: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn the world so that the cameras see the object from above its z axis' plane."""
    centres = camera_centres(poses)
    if np.mean(centres[:, 2]) >= np.mean(points[:, 2] if len(points) else 0):
        return poses, points
    # half a turn about x: a board's z axis often points away from who looks at it
    half = np.diag([1.0, -1.0, -1.0])
    poses = np.concatenate([poses[:, :, :3] @ half, poses[:, :, 3:]], axis=2)
    return poses, points @ half
