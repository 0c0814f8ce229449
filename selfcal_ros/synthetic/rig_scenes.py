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
"""Point scenes of cameras that move together, with and without a common field of view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.projective import camera_centres
from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.scenes import observe, pitched_mount, planar_poses
from selfcal_ros.synthetic.special_scenes import hand_held, placed_points, winding_course
from selfcal_ros.values.tracks import Tracks

#: Two cameras that have nothing in common.
RIG_CAMERAS = {'left': Camera([[520, 0, 330], [0, 520, 250], [0, 0, 1]], (), 640, 480),
               'right': Camera([[430, 0, 310], [0, 430, 235], [0, 0, 1]], (), 640, 480)}


@dataclass(frozen=True)
class RigScene:
    """
    Tracks of every camera with the truth that made them.

    Attributes
    ----------
    tracks : mapping of str to Tracks
        Where the cameras see the same scene, equal numbers are the same point.
    cameras : mapping of str to Camera
    T_rig_camera : mapping of str to ndarray, shape (4, 4)
        The rig has the frame of the first camera; metres.
    rig_from_world : ndarray, shape (V, 3, 4)

    """

    tracks: Mapping[str, Tracks]
    cameras: Mapping[str, Camera]
    T_rig_camera: Mapping[str, np.ndarray]
    rig_from_world: np.ndarray

    @property
    def baseline_m(self) -> float:
        """Distance of the first two cameras."""
        return float(np.linalg.norm(list(self.T_rig_camera.values())[1][:3, 3]))

    @property
    def step_m(self) -> float:
        """Root mean square distance between successive instants."""
        centres = camera_centres(self.rig_from_world)
        return float(np.sqrt(np.mean(np.sum(np.diff(centres, axis=0)**2, axis=1))))


def hand_path(rng: np.random.Generator, views: int = 12) -> np.ndarray:
    """Return poses (V, 3, 4) of a rig that is carried by hand; see `hand_held`."""
    return hand_held(rng, 0.0, views, tracks=10, track_length=5).cam_from_world


def driven_path(views: int = 20, pitch_deg: float = 20.0) -> np.ndarray:
    """Return poses (V, 3, 4) of a rig on a vehicle that winds its way, metres."""
    return planar_poses(pitched_mount(np.radians(pitch_deg)), *winding_course(views))


def late_path(path: np.ndarray, share: float) -> np.ndarray:
    """Return poses (V, 3, 4) on a smooth path, a share of the time between two later."""
    count, centres = np.arange(len(path)), camera_centres(path)
    turned = RotationSpline(count, Rotation.from_matrix(path[:, :, :3]))(
        count + share).as_matrix()
    moved = CubicSpline(count, centres)(count + share)
    return np.concatenate([turned, -turned @ moved[:, :, None]], axis=2)


def knocked_path(path: np.ndarray, turn: np.ndarray, view: int) -> np.ndarray:
    """Return poses (V, 3, 4), turned in the rig by a rotation vector from some view on."""
    knocked = path.copy()
    knocked[view:] = rotation_matrix(turn) @ path[view:]
    return knocked


def rig_scene(rng: np.random.Generator, path: np.ndarray, overlap: bool,
              cameras: Mapping[str, Camera] | None = None, noise_px: float = 0.3,
              points: int = 400, track_length: int = 8,
              of_second: np.ndarray | None = None) -> RigScene:
    """
    Move two cameras along a path.

    Parameters
    ----------
    rng : numpy.random.Generator
    path : ndarray, shape (V, 3, 4)
        Of the first camera.
    overlap : bool
        Whether the second looks the same way from 11 cm beside it, or to the right from half a
        metre behind.
    cameras : mapping of str to Camera, optional
        Two; `RIG_CAMERAS` by default.
    noise_px : float
    points, track_length : int
        See `placed_points`.
    of_second : ndarray, shape (V, 3, 4), optional
        Poses of the rig as the second camera has them, where it is late or was knocked.

    Returns
    -------
    RigScene

    """
    cameras = RIG_CAMERAS if cameras is None else cameras
    T = np.eye(4)
    turn, T[:3, 3] = (([0.02, 0.05, -0.01], [0.11, -0.01, 0.02]) if overlap
                      else ([0.0, 1.5, 0.0], [0.3, 0.1, -0.4]))
    T[:3, :3] = rotation_matrix(np.array(turn))
    back = np.linalg.inv(T)
    second = back[:3, :3] @ (path if of_second is None else of_second)
    second[:, :, 3] += back[:3, 3]
    tracks, seen = {}, None
    for (name, camera), poses in zip(cameras.items(), (path, second)):
        if seen is None or not overlap:
            scene, seen = placed_points(rng, camera, poses, points, track_length)
        tracks[name] = observe(rng, camera, poses, scene, noise_px, only_inside=True,
                               seen=seen).tracks
    return RigScene(tracks, cameras, dict(zip(cameras, (np.eye(4), T))), path)
