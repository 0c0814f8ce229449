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
"""Cameras beside each other that see one object, with exact truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.geometry.rotation import rotation_matrix
from selfcal_ros.synthetic.object_shapes import SolidObject
from selfcal_ros.synthetic.objects import ObjectRecording, tracked_object
from selfcal_ros.values.camera_rig import PlacedCamera


def object_before_cameras(views: int, shape: str | SolidObject = 'cube',
                          aside: Sequence[float] = (0.0, 0.35), **kwargs: Any,
                          ) -> tuple[list[ObjectRecording], list[PlacedCamera]]:
    """
    Move an object before cameras that stand beside each other and turn towards it.

    Each camera sees a wall of its own behind the object.

    Parameters
    ----------
    views : int
    shape : str or SolidObject
    aside : sequence of float
        How far to the right each camera stands, in first distances of the object.
    **kwargs
        Of `tracked_object`.

    Returns
    -------
    list of ObjectRecording
        Of each camera, with the true poses in its own frame.
    list of PlacedCamera
        With their true places.

    """
    first = tracked_object(views, shape, **kwargs)
    away = float(first.cam_from_world[0, 2, 3])
    recordings, cameras = [], []
    for k, step in enumerate(aside):
        T = np.eye(4)
        T[:3, :3] = rotation_matrix(np.array([0, -np.arctan(step), 0]))
        T[:3, 3] = away * step, 0, 0
        back = np.linalg.inv(T)
        poses = back[:3, :3] @ first.cam_from_world
        poses[:, :, 3] += back[:3, 3]
        recordings.append(replace(first, cam_from_world=poses, seed=first.seed + 1000 * k))
        cameras.append(PlacedCamera(f'cam{k}', first.camera, T))
    return recordings, cameras


def turned_camera(placed: PlacedCamera, degrees: float, axis: ArrayLike = (0.3, 0.9, 0.2),
                  ) -> PlacedCamera:
    """Return a camera whose stated place is wrong by a turn about an axis of its own."""
    T = placed.T_rig_camera.copy()
    direction = np.asarray(axis, float) / np.linalg.norm(axis)
    T[:3, :3] = T[:3, :3] @ rotation_matrix(np.deg2rad(degrees) * direction)
    return replace(placed, T_rig_camera=T)
