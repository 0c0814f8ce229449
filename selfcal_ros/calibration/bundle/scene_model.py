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
"""Lens · path · shutter · points of a scene; the points are eliminated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from selfcal_ros.calibration.bundle.image_shift import by_shift
from selfcal_ros.calibration.bundle.model import Linearisation, MINIMUM_DEPTH, Prediction
from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.own_rows import OwnRows
from selfcal_ros.calibration.bundle.path import (path_prior, path_prior_count, path_unknowns,
                                                 rows_of, scale_gauge, SHARED_NAMES, VIEW_NAMES)
from selfcal_ros.calibration.bundle.shutter import (LINE_DELAY, RowShifts, with_line_delay,
                                                    with_stated_delay)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns
from selfcal_ros.calibration.bundle.view_effects import ViewEffects
from selfcal_ros.calibration.bundle.zoom import (couplings, differentiate, projection, RATE_NAME,
                                                 VIEW_NAME, walk_count, with_walk, with_zoom, Zoom)
from selfcal_ros.geometry.projective import lengths
from selfcal_ros.geometry.schur_complement import PointBlocks


@dataclass(frozen=True)
class _Seen:
    """
    Points of all observations on their way into the image.

    Of arrays (N, ...) each number of all observations stands in a row in memory: sums and
    products of contiguous numbers are the quick ones.
    """

    residual: np.ndarray
    ahead: np.ndarray
    Y: np.ndarray
    placing: np.ndarray
    turned: np.ndarray
    placed: np.ndarray
    sign: np.ndarray
    pixels: Any

    def by_placed(self, state: SceneState) -> np.ndarray:
        """Differentiate by the points before the mount, (N, 2, 3)."""
        by_points, mount = self.pixels.by_points(), state.path.mount
        J = np.empty((3, 2, len(by_points))).transpose(2, 1, 0)
        for k in range(3):
            np.add(by_points[:, :, 0] * mount[0, k] + by_points[:, :, 1] * mount[1, k],
                   by_points[:, :, 2] * mount[2, k], out=J[:, :, k])
        if not state.lens.model.is_perspective:
            J *= self.sign[:, None, None]
        return J

    def by_points(self, J: np.ndarray, state: SceneState, blocks: PointBlocks) -> np.ndarray:
        """Differentiate by small moves of the homogeneous points, (N, 2, 3)."""
        placing, tangent = self.placing, rows_of(state.tangents, blocks.point)
        by_point = np.empty((3, 2, len(J))).transpose(2, 1, 0)
        for row in range(2):
            moved = [J[:, row, 0] * placing[:, 0, k] + J[:, row, 1] * placing[:, 1, k]
                     + J[:, row, 2] * placing[:, 2, k] for k in range(4)]
            for k in range(3):
                np.add(moved[0] * tangent[:, 0, k] + moved[1] * tangent[:, 1, k],
                       moved[2] * tangent[:, 2, k] + moved[3] * tangent[:, 3, k],
                       out=by_point[:, row, k])
        return by_point


@dataclass(frozen=True)
class SceneModel:
    """
    A moving camera before points that stand still, or a turning one before directions.

    Attributes
    ----------
    motion : MotionModel
    shutter : RowShifts, optional
        How far the rows' delay has moved every observation; all rows at once by default.

    """

    motion: MotionModel
    shutter: RowShifts | None = None

    dimension = 2
    eliminated = 3
    within_tracks = is_bent = True

    @property
    def own_rows(self) -> OwnRows | None:
        """Motion of each view while its rows are read, where that is estimated."""
        return None if self.shutter is None else self.shutter.own

    @property
    def _effects(self) -> tuple[ViewEffects | None, ViewEffects | None]:
        """What is supposed of what every view has of its own: motion of its rows, and shift."""
        return None if self.own_rows is None else self.own_rows.effects, self.motion.shift

    @property
    def eliminated_freedom(self) -> int:
        """Count what of a point the images could determine: of a direction, two."""
        return 2 if self.motion.fixed_centre else 3

    @property
    def has_scale_gauge(self) -> bool:
        """Tell whether one of the unknowns only scales the world."""
        return not self.motion.fixed_centre

    def unknowns(self, views: int, lens_names: tuple[str, ...]) -> Unknowns:
        """Lay out what remains once the points are eliminated."""
        unknowns = path_unknowns(self.motion, views, lens_names)
        if self.shutter is not None:
            unknowns = with_line_delay(unknowns, self.shutter)
        if self.motion.shift is not None:
            unknowns = self.motion.shift.extend(unknowns)
        return unknowns if self.motion.zoom is None else with_zoom(unknowns, self.motion.zoom)

    def predict(self, state: SceneState, blocks: PointBlocks, xy: np.ndarray) -> Prediction:
        """
        Project every observation.

        Parameters
        ----------
        state : SceneState
        blocks : PointBlocks
            Point and view of every observation.
        xy : ndarray, shape (N, 2)
            Observed pixels.

        Returns
        -------
        Prediction

        """
        seen = self._seen(state, blocks, xy)
        return Prediction(seen.residual, seen.ahead,
                          partial(self._differentiated, state, blocks, seen),
                          lambda: seen.by_points(seen.by_placed(state), state, blocks))

    def _differentiated(self, state: SceneState, blocks: PointBlocks, seen: _Seen,
                        unknowns: Unknowns) -> Linearisation:
        path, view = state.path, blocks.view
        J = seen.by_placed(state)
        shared = seen.pixels.by_intrinsics(unknowns.free, unknowns.shared.stop)
        path.by_axis(J, seen.placed, shared[:, :, unknowns.lens.stop:])
        if self.shutter is not None:
            shared[:, :, unknowns.places((LINE_DELAY,))[0]] = self.shutter.slope
        own = path.by_views(J, seen.turned, seen.Y[:, 3:], view, unknowns.view_names)
        if self.own_rows is not None:
            own = np.concatenate([own, self.own_rows.slope], axis=2)
        if self.motion.shift is not None:
            own = np.concatenate([own, by_shift(len(own))], axis=2)
        if self.motion.zoom is not None:
            own = differentiate(seen.pixels, self.motion.zoom, view, shared, own)
        return Linearisation(seen.residual, seen.ahead, shared, own,
                             seen.by_points(J, state, blocks))

    def _seen(self, state: SceneState, blocks: PointBlocks, xy: np.ndarray) -> _Seen:
        path, view = state.path, blocks.view
        Y = rows_of(state.points, blocks.point)
        poses = np.concatenate([path.rotations(), path.translation[:, :, None]], axis=2)
        placing = rows_of(poses, view)
        turned = np.empty((3, len(Y))).T
        for k in range(3):
            np.add(placing[:, k, 0] * Y[:, 0] + placing[:, k, 1] * Y[:, 1],
                   placing[:, k, 2] * Y[:, 2], out=turned[:, k])
        placed = turned + placing[:, :, 3] * Y[:, 3:]
        X = (path.mount @ placed.T).T
        toward, sign = state.signs(X, blocks, xy)
        ahead = toward * sign > MINIMUM_DEPTH
        if not state.lens.model.is_perspective:
            X = X * sign[:, None]
        pixels = projection(state.lens, X, state.zoom, view)
        residual = pixels.uv - xy
        if self.shutter is not None:
            residual += self.shutter.at(state, view)
        if state.shift is not None:
            residual += state.shift[view]
        return _Seen(residual, ahead, Y, placing, turned, placed, sign, pixels)

    def moved(self, state: SceneState, step: np.ndarray, steps: np.ndarray,
              unknowns: Unknowns) -> SceneState:
        """Move a state by a step (n,) of what remains and steps (P, 3) of the points."""
        points = state.points + np.einsum('pij,pj->pi', state.tangents, steps)
        points /= lengths(points)[:, None]
        path = state.path.moved(step[unknowns.places(SHARED_NAMES)], step[unknowns.by_view],
                                unknowns.view_names)
        delay = state.line_delay
        if self.shutter is not None:
            delay += float(step[unknowns.places((LINE_DELAY,))[0]])
        return SceneState(state.lens.moved(step[unknowns.lens]), path, points,
                          self._zoomed(state, step, unknowns), delay,
                          *(values if effects is None else effects.moved(values, step, unknowns)
                            for effects, values in self._by_view(state)))

    def _by_view(self, state: SceneState,
                 ) -> list[tuple[ViewEffects | None, np.ndarray | None]]:
        """Return what every view has of its own: what is supposed of it, and its values."""
        return list(zip(self._effects, (state.row_motion, state.shift)))

    def _zoomed(self, state: SceneState, step: np.ndarray, unknowns: Unknowns) -> Zoom | None:
        """Return the zoom after a step (n,)."""
        model = self.motion.zoom
        if model is None:
            return state.zoom
        zoom = Zoom.constant(unknowns.views) if state.zoom is None else state.zoom
        if model.is_steady:
            return zoom.grown(float(step[unknowns.places((RATE_NAME,))[0]]), model)
        return zoom.moved(step[unknowns.of_views(VIEW_NAME)[:, 0]])

    def step_between(self, state: SceneState, other: SceneState, unknowns: Unknowns,
                     step: np.ndarray) -> np.ndarray:
        """Return the step (n,) of all but the axis to another state; the axis has its own."""
        step = step.copy()
        step[unknowns.lens] = other.lens.values - state.lens.values
        for name, values in zip(VIEW_NAMES, state.path.steps_to(other.path).T):
            if name in unknowns.view_names:
                step[unknowns.of_views(name)[:, 0]] = values
        if self.motion.zoom is not None and other.zoom is not None:
            change = other.zoom.log_focal - (0 if state.zoom is None else state.zoom.log_focal)
            if self.motion.zoom.is_steady:
                step[unknowns.places((RATE_NAME,))] = self.motion.zoom.rate_of(change)
            else:
                step[unknowns.of_views(VIEW_NAME)[:, 0]] = change
        if self.shutter is not None:
            step[unknowns.places((LINE_DELAY,))] = other.line_delay - state.line_delay
        for (effects, here), (_, there) in zip(self._by_view(state), self._by_view(other)):
            if effects is not None:
                effects.set_step(step, unknowns, there, here)
        return step

    def prior_terms(self, state: SceneState, unknowns: Unknowns) -> PriorTerms:
        """Return cost, gradient (n,) and diagonal (n,) of what path, shutter and zoom suppose."""
        terms = path_prior(state.path, self.motion, unknowns)
        if self.shutter is not None:
            terms = with_stated_delay(terms, state.line_delay, self.shutter, unknowns)
        for effects, values in self._by_view(state):
            if effects is not None:
                terms = effects.add_prior(terms, values, unknowns)
        return with_walk(terms, state.zoom, self.motion.zoom, unknowns)

    def couplings(self, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray] | None:
        """Return what the priors add beside the diagonal: places (k,), and matrix (k, k)."""
        added = [couplings(self.motion.zoom, unknowns),
                 *(one.couplings(unknowns) for one in self._effects if one is not None)]
        some = [one for one in added if one is not None]
        if len(some) < 2:
            return some[0] if some else None
        return np.concatenate([places for places, _ in some]), block_diag(
            *(matrix for _, matrix in some))

    def prior_count(self, views: int) -> int:
        """Count the measurements that `prior_terms` stands for."""
        stated = self.shutter is not None and self.shutter.is_soft
        return (path_prior_count(self.motion, views) + walk_count(self.motion.zoom) + stated
                + sum(one.count(views) for one in self._effects if one is not None))

    def gauge(self, state: SceneState, unknowns: Unknowns) -> np.ndarray | None:
        """Return the direction (n,) that scales the world; a camera that turns has no scale."""
        return None if self.motion.fixed_centre else scale_gauge(state.path, unknowns)


def rescaled(state: SceneState) -> SceneState:
    """Scale the world so that successive views are one unit apart (root mean square)."""
    return state.scaled(1 / state.path.step_length())
