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
A rig on a robot: its first camera has a mount, and the robot's way gives all lengths in metres.

With p the place of a camera in steps of the path and s the metres in one,

    cov(s p) = s² cov(p) + p pᵀ var(s),

since the images tell p, and the poses of the robot tell s.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.known_directions import PlaceAlong
from selfcal_ros.calibration.mount import Mount
from selfcal_ros.calibration.mounting.disagreement import WRONG
from selfcal_ros.calibration.reconstruction import Reconstruction
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.rigs.result import CameraInRig, PLACE, POSE, RigCalibration
from selfcal_ros.calibration.structure.metric_structure import IN_A_PLANE, world_and_scale
from selfcal_ros.findings.finding import Finding


def on_robot(rig: RigCalibration, mounted: Calibration) -> RigCalibration:
    """
    Give a rig the mount of its first camera.

    Parameters
    ----------
    rig : RigCalibration
    mounted : Calibration
        Of the first camera, with its mount or why there is none.

    Returns
    -------
    RigCalibration
        In metres, where a robot tells the scale and no length was stated. Where one was, and
        the robot contradicts it, a finding says so.

    """
    first, camera = next(iter(rig.cameras.items()))
    new = mounted.findings[len(camera.findings):]
    cameras = {**rig.cameras, first: replace(camera, mount=mounted.mount,
                                             findings=mounted.findings)}
    rig = replace(rig, cameras=cameras, findings=(*rig.findings, *new))
    mount = mounted.mount
    if not isinstance(mount, Mount) or mount.status['scale'] != 'estimated':
        return rig
    per_unit = world_and_scale(camera.reconstructed.cam_from_world,
                               rig.motion in IN_A_PLANE)[1]
    metres, sigma = mount.scale * per_unit, mount.sigma['scale'] * per_unit
    if rig.unit != 'm':
        return _in_metres(rig, metres, sigma)
    if abs(metres - 1) < WRONG * np.hypot(sigma, _baseline_spread(rig)):
        return rig
    return replace(rig, findings=(*rig.findings, Finding('rig_metres_differ', scale={
        'value': metres, 'sigma': sigma})))


def _baseline_spread(rig: RigCalibration) -> float:
    """Return the sigma of the stated length, as a share of it."""
    pose = list(rig.poses.values())[1]
    along = np.nan_to_num(pose.T_rig_camera[:3, 3])
    square = float(along @ along)
    known = np.where(np.isfinite(pose.covariance[:3, :3]), pose.covariance[:3, :3], 0.0)
    return float(np.sqrt(along @ known @ along)) / square if square else np.inf


def _in_metres(rig: RigCalibration, metres: float, sigma: float) -> RigCalibration:
    """Return a rig whose unit is so many metres, with their sigma."""
    larger, along = np.ones(len(rig.covariance)), np.zeros(len(rig.covariance))
    for name, pose in rig.poses.items():
        for k, free in enumerate(PLACE):
            if f'{name}.{free}' in rig.parameter_names:
                row = rig.parameter_names.index(f'{name}.{free}')
                larger[row], along[row] = metres, np.nan_to_num(pose.T_rig_camera[k, 3])
    covariance = rig.covariance * np.outer(larger, larger) + sigma**2 * np.outer(along, along)
    poses = {}
    for name, pose in rig.poses.items():
        T = pose.T_rig_camera.copy()
        T[:3, 3] *= metres
        rows = [rig.parameter_names.index(f'{name}.{free}') for free in POSE
                if f'{name}.{free}' in rig.parameter_names]
        poses[name] = replace(
            pose, T_rig_camera=T, covariance=covariance[np.ix_(rows, rows)] if rows
            else pose.covariance, places=_places(pose, metres, sigma))
    cameras = {name: replace(one, reconstruction=_scaled(one.reconstructed, metres))
               for name, one in rig.cameras.items()}
    return replace(rig, cameras=cameras, poses=poses, covariance=covariance, unit='m',
                   scale=rig.scale * metres,
                   reconstruction=next(iter(cameras.values())).reconstructed)


def _places(pose: CameraInRig, metres: float, sigma: float) -> tuple[PlaceAlong, ...]:
    """Return what is known of an open place, in metres."""
    return tuple(replace(one, value=metres * one.value,
                         sigma=float(np.hypot(metres * one.sigma, one.value * sigma)))
                 for one in pose.places)


def _scaled(found: Reconstruction, metres: float) -> Reconstruction:
    """Return path and points in a larger world; the precision has a unit of its own."""
    poses = found.cam_from_world.copy()
    poses[:, :, 3] *= metres
    points = found.points * [metres, metres, metres, 1.0]
    return replace(found, cam_from_world=poses,
                   points=points / np.linalg.norm(points, axis=1, keepdims=True))
