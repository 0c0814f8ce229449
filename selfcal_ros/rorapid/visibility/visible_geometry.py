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
"""What is asked of a model that shows control points, and of one that has a curved surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from selfcal_ros.values.mesh import MeshModel
from selfcal_ros.values.wireframe import WireframeModel


@dataclass(frozen=True)
class ControlPoints:
    """
    The control points of the primitives that can be seen from one pose.

    Parameters
    ----------
    object_points : ndarray, shape (C, 3)
        Metres, object frame.
    tangents : ndarray, shape (C, 3)
        Unit direction of the primitive there, object frame.
    primitive : ndarray of int, shape (C,)
        Primitive, an index into `kind` and `names`, the same in all views.
    visible : ndarray of bool, shape (C,)
        False where a face or cylinder hides the point, or it is not in front of the camera.
    ids : ndarray of int, shape (C,)
        Number of the control point, 0 to `VisibleGeometry.size` - 1, the same in all views.
    inward : ndarray, shape (C, 3)
        Direction from the outline into the object, object frame; zero where the object, not the
        background, is seen on both sides of the primitive.
    kind : tuple of str, length P
        'line', 'conic' or 'silhouette' for each primitive of the model; of a mesh 'line', 'rim'
        (before another part of it) or 'contour' (before the background).
    names : tuple of str, length P

    """

    object_points: np.ndarray
    tangents: np.ndarray
    primitive: np.ndarray
    visible: np.ndarray
    ids: np.ndarray
    inward: np.ndarray
    kind: tuple[str, ...]
    names: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of control points."""
        return len(self.ids)

    @property
    def contour(self) -> np.ndarray:
        """Where the background is seen on one side, (C,) bool."""
        known: np.ndarray = np.any(self.inward, axis=1)
        return known


class VisibleGeometry(Protocol):
    """
    A model with control points on its primitives: of plane faces, or of a curved surface.

    Attributes
    ----------
    model : WireframeModel
    kind, names : tuple of str, length P
        Of each primitive.
    primitive : ndarray of int, shape (size,)
        Primitive of each control point.
    size : int
        Number of all control points.
    outline, limb : int
        Primitives from this on are pieces of rims; or limbs of round parts. Between the two are
        rims before other parts of the object.
    end_m : ndarray, shape (size,)
        Distance of each control point from the nearer end of its line, infinite without an end.
    counts : ndarray of int, shape (P,)
        Control points of each primitive.
    bends : ndarray, shape (size, 3)
        Curvature vectors of conics, per metre.

    """

    kind: tuple[str, ...]
    names: tuple[str, ...]
    primitive: np.ndarray
    size: int
    outline: int
    limb: int
    end_m: np.ndarray
    bends: np.ndarray
    counts: np.ndarray

    @property
    def model(self) -> WireframeModel:
        """The model itself."""

    @property
    def surface(self) -> SurfaceGeometry | None:
        """The same with what only a curved surface has; None where all faces are plane."""

    @property
    def faceted(self) -> FacetedGeometry | None:
        """The same with what only plane faces have; None where the surface is curved."""

    def control_points(self, rotation: ArrayLike, translation: ArrayLike,
                       focal_px: float | None = None) -> ControlPoints:
        """Control points that are seen from a pose: (3, 3), and (3,) metres."""

    def nearest_in(self, other: VisibleGeometry) -> np.ndarray:
        """Number of the nearest control point in another layout of the same model, (size,)."""

    def remembered(self) -> np.ndarray:
        """Which control points stay where they are on the object, (size,) bool."""

    def behind(self, points: np.ndarray, rotation: np.ndarray,
               translation: np.ndarray) -> np.ndarray:
        """Which points (N, 3) of the object frame lie behind the object, (N,) bool."""


class FacetedGeometry(VisibleGeometry, Protocol):
    """What a model of plane faces has besides: each control point has its place on a line."""

    def resting_points(self) -> np.ndarray:
        """Control points (size, 3) of lines and conics; on silhouettes a point of the axis."""

    @property
    def free_points(self) -> np.ndarray:
        """Which control points are on no line between vertices, (size,) bool."""

    def carried(self, shifts: np.ndarray) -> np.ndarray:
        """Carry shifts of the vertices (V, 3) to the control points of the lines, (size, 3)."""


class SurfaceGeometry(VisibleGeometry, Protocol):
    """What a curved surface shows besides: its silhouette, and what it hides of itself."""

    @property
    def model(self) -> MeshModel:
        """The mesh."""

    def mask(self, rotation: ArrayLike, translation: ArrayLike, shape: tuple[int, int],
             place: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Mask (shape) of the object in an image, roughly, 255 on it; see `VisibleMesh.mask`."""
