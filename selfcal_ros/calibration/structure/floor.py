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
How high the camera sits above the floor, from the floor that it sees.

A robot on wheels keeps its camera at one height above the floor, and never shows that height by
its motion. The floor in view does. In the frame of `metric_structure` the motion plane is level,
so that the floor is where many points have one z below the camera.

What else could be such a plane is asked one by one: is it thin, is it level, does nothing lie
below it, and did the robot drive over it? A shelf or a table fails the last two.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.mount import Floor, Mount
from selfcal_ros.calibration.result import Calibration
from selfcal_ros.calibration.structure.metric_structure import IN_A_PLANE, metric_structure
from selfcal_ros.calibration.structure.structure_measurement import by_camera_and_path
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.robust_scale import robust_sigma
from selfcal_ros.values.tracks import Tracks

#: Points of a plane are within this share of its depth of one another, and two sigmas.
THICKNESS = 0.01
#: A plane has so many points at least, and so many times as many as its surroundings.
LEAST_POINTS, DENSITY = 30, 4.0
#: Of the points below the camera, so many may lie below the floor: wrong ones.
BELOW_SHARE = 0.03
#: So many of its points are nearer to the path than half of a robot: metres.
ON_THE_WAY, HALF_ROBOT_M = 4, 0.3
#: A floor is level within this, beside three sigmas: radians.
LEVEL_RAD = np.radians(1.0)
#: Its points spread over this share of its depth, in their narrowest direction.
SPREAD = 0.2
#: Groups of tracks that are left out in turn: points that were seen together err together.
GROUPS = 10


def floor_below(calibration: Calibration, tracks: Tracks) -> Floor | NoEstimate | None:
    """
    Measure the height of the camera above the floor.

    Parameters
    ----------
    calibration : Calibration
        With a mount, whose scale tells the metre.
    tracks : Tracks
        Those that it was made from.

    Returns
    -------
    Floor or NoEstimate or None
        None where the question does not arise: no metre, or no motion in a plane.

    """
    mount = calibration.mount
    if (not isinstance(mount, Mount) or mount.status['scale'] == 'unobservable'
            or calibration.motion not in IN_A_PLANE):
        return None
    torn = [one for one in calibration.findings if one.kind == 'path_torn']
    if torn:
        return NoEstimate('floor_on_torn_path', frame=torn[0].values['frame'])
    scene = metric_structure(calibration, tracks)
    height = float(scene.centres[:, 2].mean())
    depth = height - scene.points[:, 2]
    below = np.flatnonzero(depth > 0)
    if len(below) < LEAST_POINTS:
        return NoEstimate('floor_not_seen', points=len(below))
    # tracks are numbered as they begin: neighbours were seen together
    below = below[np.argsort(scene.tracks[below], kind='stable')]
    depth, points = depth[below], scene.points[below]
    sigma = np.sqrt(scene.covariance[below, 2, 2])
    level = _fullest(depth, sigma)
    near = np.abs(depth - level) < THICKNESS * level + 2 * sigma
    beside = ~near & (np.abs(depth - level) < 3 * (THICKNESS * level + 2 * sigma))
    if near.sum() < LEAST_POINTS or near.sum() < DENSITY * beside.sum() / 2:
        return NoEstimate('floor_not_seen', points=int(near.sum()))
    lower = (depth - level > 5 * THICKNESS * level + 4 * sigma).sum()
    if lower > BELOW_SHARE * len(depth):
        return NoEstimate('floor_not_lowest', depth=level, points=int(lower))
    middle = scene.centres.mean(axis=0)
    place = points[near, :2] - middle[:2]
    if np.linalg.svd(place - place.mean(axis=0), compute_uv=False)[-1] < (
            SPREAD * level * np.sqrt(len(place))):
        return NoEstimate('floor_too_narrow', depth=level)
    if (_from_path(points[near, :2], scene.centres[:, :2]) < HALF_ROBOT_M).sum() < ON_THE_WAY:
        return NoEstimate('floor_not_driven_over', depth=level)
    design = np.column_stack([np.ones(len(place)), place])
    fit, spread = _plane(design, depth[near], sigma[near])
    tilt = float(np.hypot(*fit[1:]))
    if tilt > LEVEL_RAD + 3 * np.sqrt(max(spread[1, 1], spread[2, 2])):
        return NoEstimate('floor_not_level', degrees=float(np.degrees(tilt)))
    # the metre of the robot is that of the height, too
    metre = mount.sigma['scale'] / mount.scale * fit[0]
    camera = _by_camera(calibration, scene.tracks[below][near], design)
    return Floor(float(fit[0]), float(np.linalg.norm([np.sqrt(spread[0, 0]), metre,
                                                      camera * fit[0]])), len(place), tilt)


def _by_camera(calibration: Calibration, tracks: np.ndarray, design: np.ndarray) -> float:
    """
    Return the sigma that errors of the camera and its path leave, as a share of the height.

    In the world of the adjustment all views are at height zero.
    """
    shape = calibration.reconstructed
    if shape.precision is None:
        return 0.0
    rows = np.searchsorted(shape.tracks, tracks)
    weights = np.linalg.pinv(design)[0]
    X = shape.precision.points[rows]
    height = weights @ (X[:, 2] / X[:, 3])
    slope = weights[:, None] * [0.0, 0.0, 1.0]
    sigma = by_camera_and_path(shape.precision, rows, slope, calibration.covariance)
    return float(sigma / abs(height))


def _fullest(depth: np.ndarray, sigma: np.ndarray) -> float:
    """Return the depth about which most points lie."""
    tried = np.quantile(depth, np.linspace(0, 1, 400))
    near = np.abs(depth[:, None] - tried) < THICKNESS * tried + 2 * sigma[:, None]
    best = float(tried[np.argmax(near.sum(axis=0))])
    return float(np.median(depth[np.abs(depth - best) < THICKNESS * best + 2 * sigma]))


def _from_path(places: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return distances (N,) of places (N, 2) from the line through the points of a path."""
    start, along = path[:-1], np.diff(path, axis=0)
    length = np.maximum((along**2).sum(axis=1), 1e-12)
    from_start = places[:, None] - start
    share = (np.einsum('nsi,si->ns', from_start, along) / length).clip(0, 1)
    away: np.ndarray = np.linalg.norm(from_start - share[..., None] * along, axis=2).min(axis=1)
    return away


def _plane(design: np.ndarray, depth: np.ndarray, sigma: np.ndarray,
           ) -> tuple[np.ndarray, np.ndarray]:
    """Fit depth and slopes (3,); covariance (3, 3) by leaving groups of tracks out."""
    fit = _robust(design, depth, sigma)
    group = np.arange(len(depth)) * GROUPS // len(depth)
    others = np.array([_robust(design[group != k], depth[group != k], sigma[group != k])
                       for k in range(GROUPS)])
    off = others - others.mean(axis=0)
    return fit, (GROUPS - 1) / GROUPS * off.T @ off


def _robust(design: np.ndarray, depth: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Minimise Cauchy's cost; the scale is that of the median residual."""
    weight, fit = np.ones(len(depth)), np.zeros(3)
    for _ in range(15):
        root = np.sqrt(weight) / sigma
        fit = np.linalg.lstsq(design * root[:, None], depth * root, rcond=None)[0]
        off = (depth - design @ fit) / sigma
        scale = max(robust_sigma(off), 1e-9)
        weight = 1 / (1 + (off / (2.4 * scale))**2)
    return np.asarray(fit)


def with_floor(calibration: Calibration, tracks: Tracks) -> Calibration:
    """Return a calibration whose mount knows the floor, or why it does not."""
    from dataclasses import replace
    mount = calibration.mount
    if not isinstance(mount, Mount):
        return calibration
    return replace(calibration, mount=replace(mount, floor=floor_below(calibration, tracks)))
