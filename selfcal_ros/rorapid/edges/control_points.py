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
"""Control points in a state: where they are in the image, and what is remembered of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.rorapid.projection.camera_models import ObjectPose, ProjectedPoints, Projection
from selfcal_ros.rorapid.projection.free_directions import apart_from, free_at
from selfcal_ros.rorapid.visibility.visible_geometry import VisibleGeometry

#: Control points must be so far inside the image to be searched, pixels.
_BORDER_PX = 3.0


@dataclass(frozen=True)
class ControlView:
    """
    Attributes of the control points that a state shows.

    Attributes
    ----------
    points : ndarray, shape (C, 3)
        Object frame, centred.
    tangents : ndarray, shape (C, 3)
    primitive, ids : ndarray of int, shape (C,)
        Of the model; the same in all views.
    searched : ndarray of bool, shape (C,)
        Neither hidden by the object itself nor outside of the image.
    inward : ndarray, shape (C, 3)
        Into the object from its outline, object frame; zero where no background is beside.
    inside : ndarray, shape (C,)
        1 where the object lies on the normal's side of its outline, -1 on the other; else 0.
    projected : ProjectedPoints
    normal : ndarray, shape (C, 2)
        Unit normal in the image.
    end_px : ndarray, shape (C,)
        Distance in the image from the end of the line, roughly; infinite where there is no end.
    curvature : ndarray, shape (C,)
        In the image, per pixel; positive where the curve bends towards the normal.
    outline : int
        Primitives from this on are pieces of rims, which do not disturb each other.
    limb : int
        Primitives from this on are limbs: where a round part turns away before the background.
        Those between `outline` and this turn away before another part of the object.

    """

    points: np.ndarray
    tangents: np.ndarray
    primitive: np.ndarray
    ids: np.ndarray
    searched: np.ndarray
    inward: np.ndarray
    inside: np.ndarray
    projected: ProjectedPoints
    normal: np.ndarray
    end_px: np.ndarray
    curvature: np.ndarray
    outline: int
    limb: int

    @property
    def contour(self) -> np.ndarray:
        """Where the background is seen on one side, (C,) bool."""
        beside: np.ndarray = self.inside != 0
        return beside

    @property
    def must_show(self) -> np.ndarray:
        """
        Where an edge is missed if none is seen, (C,) bool.

        Where a round part turns away before another one, grey may meet the same grey.
        """
        return (self.primitive < self.outline) | (self.primitive >= self.limb)


class ControlModel:
    """
    The primitives of a model, seen by one camera.

    Parameters
    ----------
    visible_model : VisibleGeometry
    projection : Projection
    image_size : (int, int)
        Width and height.

    """

    def __init__(self, visible_model: VisibleGeometry, projection: Projection,
                 image_size: tuple[int, int]):
        """Centre the model."""
        self.visible_model, self.projection = visible_model, projection
        self.centre = np.asarray(visible_model.model.centre, float)
        self.image_size = image_size
        #: Whether the object is known by the outline of its round parts.
        self.is_outlined = visible_model.model.is_outlined
        self._step = 1e-3 * visible_model.model.diameter_m
        conic = np.array([kind == 'conic' for kind in visible_model.kind], bool)
        self.is_conic = conic
        self.size = visible_model.size
        self._end = visible_model.end_m / self._step
        self._bend = np.linalg.norm(visible_model.bends, axis=1)
        self._towards = self._step * visible_model.bends / np.maximum(self._bend, 1e-12)[:, None]
        self._curved = bool(conic.any())
        #: Turns (k, 6) about the middle that the shape leaves open, object frame.
        self.free_turns = visible_model.model.free_turns

    def resize(self, image_size: tuple[int, int]) -> None:
        """Take images of another size: width and height."""
        self.image_size = image_size

    def view(self, state: ObjectPose) -> ControlView:
        """Return the control points that a state shows."""
        # hidden parts are those of the full perspective view, whatever the camera model
        seen = self.visible_model.control_points(
            state.rotation, state.translation - state.rotation @ self.centre,
            state.zoom * float(self.projection.camera.K[0, 0]))
        points = seen.object_points - self.centre
        return self._place(points, seen.tangents, seen.primitive, seen.ids, seen.visible,
                           seen.inward, state)

    def mask(self, state: ObjectPose, shape: tuple[int, ...]) -> np.ndarray | None:
        """Mask (rows, columns) of a curved surface in a state, 255 on it; None of plane faces."""
        surface = self.visible_model.surface
        return None if surface is None else surface.mask(
            state.rotation, state.translation - state.rotation @ self.centre,
            (shape[0], shape[1]),
            lambda points: self.projection.project(state, points - self.centre).pixels)

    def free(self, state: ObjectPose) -> np.ndarray:
        """Corrections (size, k) that a body of revolution does not show, at a state."""
        return free_at(self.free_turns, state, self.projection)

    def rows(self, state: ObjectPose, view: ControlView) -> np.ndarray:
        """
        Motion of the control points along their normals per unit of correction, (C, size).

        What the shape leaves open moves nothing: its facets would pretend that it did.
        """
        rows = self.projection.rows(state, view.projected, view.normal)
        return rows @ apart_from(self.free(state)) if len(self.free_turns) else rows

    def again(self, view: ControlView, state: ObjectPose) -> ControlView:
        """Return the same control points in a state nearby."""
        return self._place(view.points, view.tangents, view.primitive, view.ids, view.searched,
                           view.inward, state)

    def _place(self, points: np.ndarray, tangents: np.ndarray, primitive: np.ndarray,
               ids: np.ndarray, visible: np.ndarray, inward: np.ndarray, state: ObjectPose,
               ) -> ControlView:
        n = len(points)
        parts = [points, points + self._step * tangents, points + self._step * inward]
        curved = np.flatnonzero(self._bend[ids]) if self._curved else ()
        if len(curved):
            parts.append(points[curved] + self._towards[ids[curved]])
        both = self.projection.project(state, np.concatenate(parts))
        along = both.pixels[n:2 * n] - both.pixels[:n]
        length = np.sqrt(along[:, 0]**2 + along[:, 1]**2)
        normal = np.empty((n, 2))
        with np.errstate(divide='ignore', invalid='ignore'):
            normal[:, 0], normal[:, 1] = -along[:, 1] / length, along[:, 0] / length
        pixels = both.pixels[:n]
        width, height = self.image_size
        x, y = pixels[:, 0], pixels[:, 1]
        searched = (visible & (x > _BORDER_PX) & (y > _BORDER_PX) & (x < width - 1 - _BORDER_PX)
                    & (y < height - 1 - _BORDER_PX) & (length > 1e-3))
        normal[~(length > 1e-12)] = 0
        projected = ProjectedPoints(pixels, both.xy[:n], both.turned[:n],
                                    both.inverse_depth[:n])
        inside = np.sign(((both.pixels[2 * n:3 * n] - pixels) * normal).sum(axis=1))
        inside[~inward.any(axis=1)] = 0
        curvature = np.zeros(n)
        if len(curved):
            bend = both.pixels[3 * n:] - pixels[curved]
            curvature[curved] = (np.einsum('ci,ci->c', bend, normal[curved]) * self._step
                                 * self._bend[ids[curved]]
                                 / np.maximum(length[curved], 1e-12)**2)
        return ControlView(points, tangents, primitive, ids, searched, inward, inside, projected,
                           normal, self._end[ids] * length, curvature,
                           self.visible_model.outline, self.visible_model.limb)
