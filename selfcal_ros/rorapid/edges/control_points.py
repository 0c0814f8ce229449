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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.rorapid.projection.camera_models import (
    ObjectPose, project_together, ProjectedPoints, Projection)
from selfcal_ros.rorapid.projection.free_directions import apart_from, free_at
from selfcal_ros.rorapid.visibility.visible_geometry import VisibleGeometry

#: Control points must be so far inside the image to be searched, pixels.
_BORDER_PX = 3.0


@dataclass(frozen=True)
class ShownPoints:
    """
    Attributes of the control points that are shown, the same in all states nearby.

    Attributes
    ----------
    primitive, ids : ndarray of int, shape (C,)
        Of the model; the same in all views.
    beside : ndarray, shape (3, C, 3) or (4, C, 3)
        Object frame, centred: the points; a little farther along their primitives; a little into
        the object from its outline; and, where curves are, a little towards their middle.
    inner : ndarray of bool, shape (C,)
        Where no background is beside.
    end : ndarray, shape (C,)
        Distance from the end of the line in such little steps; infinite where there is no end.
    bend : ndarray, shape (C,), or None
        Curvature in the object's frame for such a step; None where nothing is curved.

    """

    primitive: np.ndarray
    ids: np.ndarray
    beside: np.ndarray
    inner: np.ndarray
    end: np.ndarray
    bend: np.ndarray | None


@dataclass(frozen=True)
class ControlView:
    """
    Attributes of the control points that a state shows.

    Attributes
    ----------
    shown : ShownPoints
        Which they are.
    searched : ndarray of bool, shape (C,)
        Neither hidden by the object itself nor outside of the image.
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

    shown: ShownPoints
    searched: np.ndarray
    inside: np.ndarray
    projected: ProjectedPoints
    normal: np.ndarray
    end_px: np.ndarray
    curvature: np.ndarray
    outline: int
    limb: int

    @property
    def primitive(self) -> np.ndarray:
        """Primitive of each control point, (C,)."""
        return self.shown.primitive

    @property
    def ids(self) -> np.ndarray:
        """Number of each control point, (C,), the same in all views."""
        return self.shown.ids

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
        return views_together([self], [state])[0]

    def shown(self, state: ObjectPose) -> tuple[ShownPoints, np.ndarray]:
        """Return the control points that a state shows, and which are not hidden, (C,) bool."""
        # hidden parts are those of the full perspective view, whatever the camera model
        seen = self.visible_model.control_points(
            state.rotation, state.translation - state.rotation @ self.centre,
            state.zoom * float(self.projection.camera.K[0, 0]))
        points = seen.object_points - self.centre
        parts = [points, points + self._step * seen.tangents, points + self._step * seen.inward]
        bend = None
        if self._curved:
            bend = self._step * self._bend[seen.ids]
            parts.append(points + self._towards[seen.ids])
        return ShownPoints(seen.primitive, seen.ids, np.array(parts), ~seen.contour,
                           self._end[seen.ids], bend), seen.visible

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
        return placed_together([self], [view.shown], [view.searched], [state])[0]


def views_together(controls: Sequence[ControlModel], states: Sequence[ObjectPose],
                   ) -> list[ControlView]:
    """Return the control points that states show, of objects in images of one size."""
    seen = [control.shown(state) for control, state in zip(controls, states)]
    return placed_together(controls, [shown for shown, _ in seen], [at for _, at in seen],
                           states) if seen else []


def placed_together(controls: Sequence[ControlModel], shown: Sequence[ShownPoints],
                    visible: Sequence[np.ndarray], states: Sequence[ObjectPose],
                    ) -> list[ControlView]:
    """
    Place control points in states, of one object or of several at once.

    What takes the time is the number of calls, not that of points.

    Parameters
    ----------
    controls : sequence of ControlModel
        For images of one size.
    shown : sequence of ShownPoints
    visible : sequence of ndarray of bool, shape (C,)
        Those of them that may be searched.
    states : sequence of ObjectPose

    Returns
    -------
    list of ControlView

    """
    curved = any(one.bend is not None for one in shown)
    both = project_together([control.projection for control in controls], states, [
        one.beside if len(one.beside) == (4 if curved else 3) else
        np.concatenate([one.beside, one.beside[:1]]) for one in shown])
    pixels = both.pixels[0]
    along = both.pixels[1] - pixels
    length = np.sqrt(along[:, 0]**2 + along[:, 1]**2)
    normal = np.empty(pixels.shape)
    with np.errstate(divide='ignore', invalid='ignore'):
        normal[:, 0], normal[:, 1] = -along[:, 1] / length, along[:, 0] / length
    width, height = controls[0].image_size
    x, y = pixels[:, 0], pixels[:, 1]
    searched = (joined(visible) & (x > _BORDER_PX) & (y > _BORDER_PX)
                & (x < width - 1 - _BORDER_PX) & (y < height - 1 - _BORDER_PX) & (length > 1e-3))
    normal[~(length > 1e-12)] = 0
    inside = np.sign(((both.pixels[2] - pixels) * normal).sum(axis=1))
    inside[joined([one.inner for one in shown])] = 0
    curvature = np.zeros(len(pixels))
    if curved:
        bend = joined([np.zeros(len(one.ids)) if one.bend is None else one.bend for one in shown])
        curvature = (((both.pixels[3] - pixels) * normal).sum(axis=1) * bend
                     / np.maximum(length, 1e-12)**2)
    end_px = joined([one.end for one in shown]) * length
    views, first = [], 0
    for control, one in zip(controls, shown):
        own = slice(first, first + len(one.ids))
        first = own.stop
        views.append(ControlView(
            one, searched[own], inside[own],
            ProjectedPoints(pixels[own], both.xy[0, own], both.turned[0, own],
                            both.inverse_depth[0, own]),
            normal[own], end_px[own], curvature[own], control.visible_model.outline,
            control.visible_model.limb))
    return views


def joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Put arrays one after the other; a single one is returned as it is."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
