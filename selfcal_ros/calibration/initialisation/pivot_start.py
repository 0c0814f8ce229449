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
Starts for a camera that turns about a fixed point beside it, as on a pan-tilt head.

While the lever is short, the images are nearly those of a rotation, which gives calibration and
orientations. Once they are known, every two rays of a track are coplanar with the way between
their views, which is linear in the lever:

    (d_a × d_b) · (R_aᵀ - R_bᵀ) l = 0.

Its direction alone is open, since a larger lever before a larger scene looks the same. The
orientations have absorbed some of the parallax, so that other directions are tried as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.centres import all_rays, points_from_centres
from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.point_of_rest import axis_of_all
from selfcal_ros.calibration.bundle.scene_model import rescaled
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.rotation import nearest_rotation
from selfcal_ros.geometry.schur_complement import PointBlocks

#: Rounds of re-weighting.
_ROUNDS = 5
#: Ways between views that are shorter than this share of what the lever allows weigh no more.
_LEAST_WAY = 0.1
#: A view is turned by so many points at least.
_LEAST_SHARED = 4


@dataclass(frozen=True)
class PivotPath:
    """
    Orientations of all views about one point.

    Attributes
    ----------
    rotations : ndarray, shape (V, 3, 3)
        Camera from world.
    lever : ndarray, shape (3,)
        From the camera to the point, in the camera's frame, up to scale; zero: unknown.

    """

    rotations: np.ndarray
    lever: np.ndarray

    def of_views(self, first: int, last: int) -> PivotPath:
        """Return the orientations of a stretch of the views."""
        return replace(self, rotations=self.rotations[first:last])

    def start(self, blocks: PointBlocks, xy: np.ndarray, camera: Camera) -> SceneState | None:
        """
        Start under a supposed calibration.

        Parameters
        ----------
        blocks : PointBlocks
        xy : ndarray, shape (N, 2)
            Pixels of the observations in `blocks`.
        camera : Camera

        Returns
        -------
        SceneState or None
            None where the calibration cannot be.

        """
        return next(self._with_levers(blocks, xy, camera, [self.lever]), None)

    def starts(self, blocks: PointBlocks, xy: np.ndarray, camera: Camera) -> Iterator[SceneState]:
        """Start with the lever that fits best in closed form, and along every axis, both ways."""
        directions = self._directions(blocks, xy, camera)
        if not np.isfinite(directions).all():
            return
        lever = lever_direction(blocks, directions, self.rotations)
        axis = axis_of_all(self.rotations)
        # along the axis any point rests
        levers = [lever, *(np.eye(3)[[2, 0, 1]] if axis is None else _across(axis).T)]
        yield from self._with_levers(blocks, xy, camera, [
            sign * one for one in levers for sign in (1, -1)])

    def _directions(self, blocks: PointBlocks, xy: np.ndarray, camera: Camera) -> np.ndarray:
        rays = all_rays(camera, xy)
        turned: np.ndarray = np.einsum('nji,nj->ni', self.rotations[blocks.view], rays)
        return turned

    def _with_levers(self, blocks: PointBlocks, xy: np.ndarray, camera: Camera,
                     levers: list[np.ndarray]) -> Iterator[SceneState]:
        directions = self._directions(blocks, xy, camera)
        if not np.isfinite(directions).all():
            return
        path = AxisPath.of_turns(self.rotations)
        for lever in levers:
            moved = path.about(lever)
            yield rescaled(SceneState(Lens.of(camera), moved, points_from_centres(
                blocks, directions, moved.centres())))


def completed_rotations(blocks: PointBlocks, rays: np.ndarray, rotations: np.ndarray,
                        ) -> np.ndarray | None:
    """
    Turn the remaining views so that they see points where the others do.

    The view that shares most points with those that are known comes first.

    Parameters
    ----------
    blocks : PointBlocks
    rays : ndarray, shape (N, 3)
        Unit rays of the observations, in the cameras' frames.
    rotations : ndarray, shape (V, 3, 3)
        Camera from world; NaN where it is not known.

    Returns
    -------
    ndarray, shape (V, 3, 3), or None
        None where a view shares too few points with the others.

    """
    rotations = rotations.copy()
    known = np.isfinite(rotations[:, 0, 0])
    total, length = np.zeros((blocks.point_count, 3)), np.zeros(blocks.point_count)
    rows = np.flatnonzero(known[blocks.view])
    while True:
        # what the views see that have just become known
        np.add.at(total, blocks.point[rows], np.einsum(
            'nji,nj->ni', rotations[blocks.view[rows]], rays[rows]))
        length[blocks.point[rows]] = np.linalg.norm(total[blocks.point[rows]], axis=1)
        if known.all():
            return rotations
        shared = ~known[blocks.view] & (length[blocks.point] > 0)
        counts = np.bincount(blocks.view[shared], minlength=len(known))
        view = int(np.argmax(counts))
        if counts[view] < _LEAST_SHARED:
            return None
        rows = np.flatnonzero(blocks.view == view)
        of_known = rows[shared[rows]]
        point = blocks.point[of_known]
        rotations[view] = _turned_onto(total[point] / length[point, None], rays[of_known])
        known[view] = True


def _turned_onto(world: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) of directions (n, 3) onto rays (n, 3), robustly."""
    weight = np.ones(len(rays))
    for _ in range(_ROUNDS):
        rotation = nearest_rotation((rays * weight[:, None]).T @ world)
        misfit = np.linalg.norm(rays - world @ rotation.T, axis=1)
        weight = 1 / (1 + (misfit / max(float(np.median(misfit)), 1e-12))**2)
    return rotation


def _across(axis: np.ndarray) -> np.ndarray:
    """Two directions (3, 2) across an axis."""
    _, vectors = np.linalg.eigh(np.outer(axis, axis))
    return vectors[:, :2]


def lever_direction(blocks: PointBlocks, directions: np.ndarray, rotations: np.ndarray,
                    ) -> np.ndarray:
    """
    Direction of the lever by which all rays of each track meet best.

    Parameters
    ----------
    blocks : PointBlocks
    directions : ndarray, shape (N, 3)
        Unit rays, world.
    rotations : ndarray, shape (V, 3, 3)
        Camera from world.

    Returns
    -------
    ndarray, shape (3,)
        Unit, in the camera's frame; its sign is open. Across the common axis, if there is one.

    """
    axis = axis_of_all(rotations)
    across = np.eye(3) if axis is None else _across(axis)
    every = np.arange(len(directions))
    first = blocks.first[blocks.point]
    last = first + blocks.length[blocks.point] - 1
    pairs = np.concatenate([np.column_stack([every, mate])[mate != every]
                            for mate in (first, last)])
    a, b = pairs.T
    ways = np.swapaxes(rotations[blocks.view[a]] - rotations[blocks.view[b]], 1, 2)
    rows = np.einsum('ni,nij->nj', np.cross(directions[a], directions[b]), ways)
    longest = np.linalg.norm(ways, axis=(1, 2)) + 1e-9
    length, weight = longest, np.ones(len(rows))
    for _ in range(_ROUNDS):
        weighted = rows * (weight / length)[:, None]
        open_to = weighted @ across
        lever: np.ndarray = across @ np.linalg.eigh(open_to.T @ open_to)[1][:, 0]
        # sine of the angle between ray and epipolar plane, times a constant
        length = np.maximum(np.linalg.norm(ways @ lever, axis=1), _LEAST_WAY * longest)
        miss = np.abs(rows @ lever) / length
        weight = 1 / (1 + (miss / (3 * np.median(miss) + 1e-12))**2)
    return lever
