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
A path that is known of some successive views, continued to all of them.

Chains of pairs lose their scale where the camera turns much and moves little, and pairs before a
wall have no one geometry. So each further view is resected from the points of the views before it.
A few of them at a time are adjusted with those next to them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.centres import all_rays, points_from_centres
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.priors import all_fixed
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, Observations, with_all_points
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_GO_ON
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.geometry.no_estimate import NoEstimate
from selfcal_ros.geometry.schur_complement import PointBlocks
from selfcal_ros.geometry.space_resection import pose_of_rays

#: Views that are added at a time, and those next to them with which they are adjusted.
ADDED, BESIDE = 8, 24
#: Scale at which that begins, in units of the noise, and its iterations.
COARSE, ITERATIONS = 10.0, 15
#: Of the points, this share that is seen under the widest angles tells where a view is.
SHARE_OF_POINTS, LEAST_POINTS = 0.5, 10


def continued_path(problem: SelfCalibrationProblem, known: SceneState, first: int,
                   tracks_per_view: int, exact: bool) -> AxisPath | None:
    """
    Continue the path of a stretch of views to all of them, with its calibration.

    Parameters
    ----------
    problem : SelfCalibrationProblem
    known : SceneState
        Of successive views, fitted.
    first : int
        The first of them.
    tracks_per_view : int
        Of the longest, so many are used.
    exact : bool
        Whether the motion is exactly planar.

    Returns
    -------
    AxisPath or None
        None where a view shares too few points with those that stand, or has no rays.

    """
    few = replace(problem.observations.longest(tracks_per_view), shutter=None)
    rays = all_rays(known.camera(), few.xy)
    if not np.isfinite(rays).all():
        return None
    path, last = known.path, first + len(known.path)
    poses = np.zeros((problem.views, 3, 4))
    poses[first:last] = path.cam_from_world()
    while first > 0 or last < problem.views:
        backward = first > 0
        new = (range(first - 1, max(first - ADDED, 0) - 1, -1) if backward else
               range(last, min(last + ADDED, problem.views)))
        for view in new:
            beside = (range(view + 1, min(view + 1 + BESIDE, last)) if backward else
                      range(view - 1, max(view - BESIDE, first) - 1, -1))
            pose = _resected(few, rays, poses, view, beside)
            if pose is None:
                return None
            poses[view] = pose
            first, last = min(first, view), max(last, view + 1)
        stretch = np.array(
            range(min(first + len(new) + BESIDE, last) - 1, first - 1, -1) if backward else
            range(max(last - len(new) - BESIDE, first), last))
        adjusted = _adjusted(problem, few, known, poses, stretch, exact)
        if adjusted is None:
            return None
        poses[stretch] = _like(adjusted, poses[stretch], len(stretch) - len(new))
    return AxisPath.of_poses(path.mount, poses)


def _resected(few: Observations, rays: np.ndarray, poses: np.ndarray, view: int,
              beside: range) -> np.ndarray | None:
    """Return the pose (3, 4) of a view from the points of views beside it, the nearest first."""
    seen = np.zeros(len(poses), bool)
    seen[list(beside)] = True
    mine = np.flatnonzero(few.view == view)
    here = np.full(len(few.track), -1)
    here[few.point[mine]] = mine
    rows = np.flatnonzero(seen[few.view] & (here[few.point] >= 0))
    points, place, count = np.unique(few.point[rows], return_inverse=True, return_counts=True)
    rows, place = rows[count[place] > 1], place[count[place] > 1]
    if not len(rows):
        return None
    points, place = points[count > 1], np.unique(place, return_inverse=True)[1]
    R, t = poses[:, :, :3], poses[:, :, 3]
    blocks = PointBlocks(place, few.view[rows])
    directions = np.einsum('nji,nj->ni', R[few.view[rows]], rays[rows])
    world = points_from_centres(blocks, directions, -np.einsum('vji,vj->vi', R, t))
    # depths that are not known yet make a step shorter than it is
    mean = blocks.sum_over_points(directions)
    spread = np.minimum.reduceat(np.einsum('ni,ni->n', directions, mean[place]),
                                 blocks.first) / np.linalg.norm(mean, axis=1)
    sure = np.argsort(spread)[:max(LEAST_POINTS, round(SHARE_OF_POINTS * len(spread)))]
    near = beside[0]
    before = np.column_stack([world[:, :3] @ R[near].T + world[:, 3:] * t[near], world[:, 3]])
    found = pose_of_rays(before[sure], rays[here[points[sure]]])
    if isinstance(found, NoEstimate):
        return None
    turn, move = found.pose[:, :3], found.pose[:, 3]
    return np.column_stack([turn @ R[near], turn @ t[near] + move])


def _adjusted(problem: SelfCalibrationProblem, few: Observations, known: SceneState,
              poses: np.ndarray, stretch: np.ndarray, exact: bool) -> np.ndarray | None:
    """Adjust some successive views (n,), the calibration held; returns their poses (n, 3, 4)."""
    views = np.sort(stretch)
    within, _ = few.select((few.view >= views[0]) & (few.view <= views[-1]))
    within = replace(within, view=within.view - views[0],
                     clock=within.clock and within.clock.of_views(views))
    path = AxisPath.of_poses(known.path.mount, poses[views])
    path = path.flat() if exact else path
    motion = problem.motion.of_views(views)
    state = with_all_points(SceneState(known.lens, path.aligned(motion)), within)
    bundle = bundle_of(within, motion, all_fixed(known.lens), COARSE * problem.noise_px)
    if state is None or not np.isfinite(bundle.cost(state)):
        return None
    adjusted = bundle.optimise(state, iterations=ITERATIONS, tolerance=TO_GO_ON).path
    return np.asarray(adjusted.cam_from_world()[stretch - views[0]])


def _like(poses: np.ndarray, others: np.ndarray, shared: int) -> np.ndarray:
    """Return poses (n, 3, 4) in the world of others, of which the first so many are known."""
    R = poses[:, :, :3]
    centre, other = (-np.einsum('vji,vj->vi', some[:, :, :3], some[:, :, 3])
                     for some in (poses, others))
    turn = others[0, :, :3].T @ R[0]
    way, other_way = (float(np.sum(np.linalg.norm(np.diff(some[:shared], axis=0), axis=1)))
                      for some in (centre, other))
    scale = other_way / way if way > 0 else 1.0
    placed = other[0] + scale * (centre - centre[0]) @ turn.T
    turned = R @ turn.T
    return np.concatenate([turned, -(turned @ placed[:, :, None])], axis=2)
