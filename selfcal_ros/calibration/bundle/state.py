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
"""The state of an adjustment: the values of all blocks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.object_bend import SHAPE_NAMES
from selfcal_ros.calibration.bundle.object_poses import ObjectPoses
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.zoom import Zoom
from selfcal_ros.geometry.camera import Camera
from selfcal_ros.geometry.projective import tangent_basis
from selfcal_ros.geometry.schur_complement import PointBlocks


@dataclass(frozen=True)
class BundleState:
    """
    Values of the lens and the path.

    Attributes
    ----------
    lens : Lens
    path : AxisPath or ObjectPoses

    """

    lens: Lens
    path: AxisPath | ObjectPoses

    def camera(self, width: int = 0, height: int = 0) -> Camera:
        """Return the camera."""
        return self.lens.camera(width, height)


#: States of one kind of product of blocks.
StateT = TypeVar('StateT', bound=BundleState)


@dataclass(frozen=True)
class SceneState(BundleState):
    """
    Values of all blocks before a scene whose points are unknown.

    Attributes
    ----------
    path : AxisPath
    points : ndarray, shape (P, 4)
        Unit homogeneous world points.
    zoom : Zoom, optional
        Where the focal length varies.
    line_delay : float
        Intervals between frames in which the whole image is read, row after row.
    row_motion : ndarray, shape (V, 6), optional
        How each view moves meanwhile beyond that; see `OwnRows`.
    shift : ndarray, shape (V, 2), optional
        How far each image is shifted, pixels; see `image_shift`.

    """

    path: AxisPath
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    zoom: Zoom | None = None
    line_delay: float = 0.0
    row_motion: np.ndarray | None = None
    shift: np.ndarray | None = None

    @cached_property
    def tangents(self) -> np.ndarray:
        """
        Directions in which the points may move, shape (P, 4, 3).

        Along a path, those exactly at infinity stay there; see `hidden_depths`.
        """
        basis = tangent_basis(self.points)
        if self.path.translation.any():
            basis[self.points[:, 3] == 0, 3] = 0
        return basis

    def of_views(self, kept: np.ndarray, points: np.ndarray) -> SceneState:
        """Return the state of some of the views and points, by index or mask."""
        return replace(self, path=self.path.of_views(kept), points=self.points[points],
                       zoom=self.zoom and self.zoom.of_views(kept),
                       row_motion=None if self.row_motion is None else self.row_motion[kept],
                       shift=None if self.shift is None else self.shift[kept])

    def scaled(self, factor: float) -> SceneState:
        """Return the state in a world that is larger by a factor."""
        points = self.points * np.array([factor, factor, factor, 1])
        return replace(self, path=self.path.scaled(factor),
                       points=points / np.linalg.norm(points, axis=1, keepdims=True))

    def steadied(self, xy: np.ndarray, view: np.ndarray) -> np.ndarray:
        """Return pixels (N, 2) of views (N,) as the camera of `lens` would see them."""
        if self.shift is not None:
            xy = xy - self.shift[view]
        return xy if self.zoom is None else self.zoom.unzoomed(xy, view, self.lens)

    def placed(self, blocks: PointBlocks) -> np.ndarray:
        """Return the points of observations (N, 3) in the frames of views, before the mount."""
        Y = self.points[blocks.point]
        placed: np.ndarray = np.einsum('nij,nj->ni', self.path.rotations()[blocks.view], Y[:, :3])
        placed += self.path.translation[blocks.view] * Y[:, 3:]
        return placed

    def placed_ahead(self, blocks: PointBlocks, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `placed` (N, 3) and the points' last coordinates (N, 1), by `signs`."""
        placed = self.placed(blocks)
        sign = self.signs(placed @ self.path.mount.T, blocks, xy)[1][:, None]
        return placed * sign, self.points[blocks.point][:, 3:] * sign

    def signs(self, X: np.ndarray, blocks: PointBlocks, xy: np.ndarray,
              ) -> tuple[np.ndarray, np.ndarray]:
        """
        Choose the signs of homogeneous points: the one that most of its views see ahead.

        Parameters
        ----------
        X : ndarray, shape (N, 3)
            The points before the cameras.
        blocks : PointBlocks
        xy : ndarray, shape (N, 2)
            Observed pixels.

        Returns
        -------
        toward, sign : ndarray, shape (N,)
            Depth as the points are, and the sign that they should have.

        """
        toward = (X[:, 2] if self.lens.model.is_perspective
                  else np.einsum('ni,ni->n', X, self.lens.pixel_directions(
                      self.steadied(xy, blocks.view))))
        sign = np.sign(blocks.sum_over_points(np.sign(toward)))[blocks.point]
        sign[sign == 0] = 1
        return toward, sign


@dataclass(frozen=True)
class ObjectState(BundleState):
    """
    Values of all blocks before an object whose points are known.

    Attributes
    ----------
    path : ObjectPoses
    bend : ndarray, shape (5,)
        Of a board that need not be flat, nor printed to scale; see `SHAPE_NAMES`.
    row_motion : ndarray, shape (V, 6), optional
        How the object moved while each image was read; see `ObjectRows`.
    line_delay_s : float
        Seconds from one line to the next; see `EdgeRows`.

    """

    path: ObjectPoses
    bend: np.ndarray = field(default_factory=lambda: np.zeros(len(SHAPE_NAMES)))
    row_motion: np.ndarray | None = None
    line_delay_s: float = 0.0

    def of_views(self, kept: np.ndarray) -> ObjectState:
        """Return the state of some of the views."""
        return replace(self, path=self.path.of_views(kept),
                       row_motion=None if self.row_motion is None else self.row_motion[kept])
