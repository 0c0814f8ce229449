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
The rig of COLMAP: rig_config.json, which `colmap rig_configurator` takes (3.12 and later).

Poses there lead from the rig to the camera, quaternions have w first, and the first camera is the
reference. Images are in a folder of the camera's name each, with equal names at an instant.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from selfcal_ros.calibration.rigs.result import RigCalibration
from selfcal_ros.report.camera_files.colmap_cameras import colmap_model, holds

NAME = 'rig_config.json'


def rig_config(rig: RigCalibration) -> str | None:
    """Return the file's text; None where a pose is open, or COLMAP lacks a lens."""
    cameras: list[dict[str, Any]] = []
    for name, one in rig.cameras.items():
        T = rig.poses[name].T_rig_camera
        if not (np.isfinite(T).all() and holds(one.camera) and abs(one.camera.K[0, 1]) < 1e-12):
            return None
        model, values = colmap_model(one.camera)
        entry: dict[str, Any] = {'image_prefix': f'{name}/'}
        if not cameras:
            entry['ref_sensor'] = True
        else:
            back = np.linalg.inv(T)
            x, y, z, w = Rotation.from_matrix(back[:3, :3]).as_quat(canonical=True).tolist()
            entry |= {'cam_from_rig_rotation': [w, x, y, z],
                      'cam_from_rig_translation': back[:3, 3].tolist()}
        cameras.append(entry | {'camera_model_name': model, 'camera_params': values})
    return json.dumps([{'cameras': cameras}], indent=2) + '\n'


def rig_config_path(folder: Path) -> Path:
    """Return where the file goes."""
    return folder / NAME
