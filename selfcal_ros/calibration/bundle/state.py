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
"""A point in the space of the unknowns: the values of all blocks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Lens
from selfcal_ros.calibration.bundle.object_poses import ObjectPoses
from selfcal_ros.calibration.bundle.path import AxisPath
from selfcal_ros.calibration.bundle.zoom import Zoom
from selfcal_ros.geometry.camera import Camera


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

    """

    path: AxisPath
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    zoom: Zoom | None = None

    def of_views(self, kept: np.ndarray, points: np.ndarray) -> SceneState:
        """Return the state of some of the views and points, by index or mask."""
        return replace(self, path=self.path.of_views(kept), points=self.points[points],
                       zoom=self.zoom and self.zoom.of_views(kept))

    def unzoomed(self, xy: np.ndarray, view: np.ndarray) -> np.ndarray:
        """Return pixels (N, 2) of views (N,) as the camera of `lens` would see them."""
        return xy if self.zoom is None else self.zoom.unzoomed(xy, view, self.lens)


@dataclass(frozen=True)
class ObjectState(BundleState):
    """
    Values of all blocks before an object whose points are known.

    Attributes
    ----------
    path : ObjectPoses

    """

    path: ObjectPoses
