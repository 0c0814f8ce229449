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
"""Lens · path · points of a scene; the points are eliminated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import Projection
from selfcal_ros.calibration.bundle.model import Linearisation, MINIMUM_DEPTH, residuals_only
from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.path import (path_prior, path_prior_count, path_unknowns,
                                                 scale_gauge)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns
from selfcal_ros.geometry.optimise import PointBlocks
from selfcal_ros.geometry.projective import tangent_basis


@dataclass(frozen=True)
class SceneModel:
    """
    A moving camera before points that stand still, or a turning one before directions.

    Attributes
    ----------
    motion : MotionModel

    """

    motion: MotionModel

    dimension = 2
    eliminated = 3
    within_tracks = is_bent = True

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
        return path_unknowns(self.motion, views, lens_names)

    def linearise(self, state: SceneState, blocks: PointBlocks, xy: np.ndarray,
                  unknowns: Unknowns, jacobians: bool = True) -> Linearisation:
        """
        Project every observation and differentiate.

        Parameters
        ----------
        state : SceneState
        blocks : PointBlocks
            Point and view of every observation.
        xy : ndarray, shape (N, 2)
            Observed pixels.
        unknowns : Unknowns
            Derivatives by fixed ones may be left at zero.
        jacobians : bool
            False: residuals only.

        Returns
        -------
        Linearisation

        """
        path, view = state.path, blocks.view
        Y = state.points[blocks.point]
        R = path.rotations()[view]
        turned = np.einsum('nij,nj->ni', R, Y[:, :3])
        moves = path.translation[view]
        placed = turned + moves * Y[:, 3:]
        X = placed @ path.mount.T
        # a homogeneous point has no sign: take the one that most of its views see ahead
        toward = (X[:, 2] if state.lens.model.is_perspective
                  else np.einsum('ni,ni->n', X, state.lens.pixel_directions(xy)))
        sign = np.sign(blocks.sum_over_points(np.sign(toward)))[blocks.point]
        sign[sign == 0] = 1
        ahead = toward * sign > MINIMUM_DEPTH
        if not state.lens.model.is_perspective:
            X = X * sign[:, None]
        pixels = Projection(state.lens, X)
        residual = pixels.uv - xy
        if not jacobians:
            return residuals_only(residual, ahead)

        J = pixels.by_points() @ path.mount
        if not state.lens.model.is_perspective:
            J *= sign[:, None, None]
        shared = pixels.by_intrinsics(unknowns.free, unknowns.shared.stop)
        path.by_axis(J, placed, shared[:, :, unknowns.lens.stop:])
        planar = not unknowns.free[unknowns.of_views('tilt_x', 'tilt_y', 'height')].any()
        own = path.by_views(J, turned, Y[:, 3:], view, planar)
        by_point = np.concatenate([J @ R, J @ moves[:, :, None]], axis=2)
        return Linearisation(residual, ahead, shared, own,
                             by_point @ tangent_basis(state.points)[blocks.point])

    def moved(self, state: SceneState, step: np.ndarray, steps: np.ndarray,
              unknowns: Unknowns) -> SceneState:
        """Move a state by a step (n,) of what remains and steps (P, 3) of the points."""
        points = state.points + np.einsum('pij,pj->pi', tangent_basis(state.points), steps)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        return SceneState(state.lens.moved(step[unknowns.lens]),
                          state.path.moved(step[unknowns.places(unknowns.shared_names)],
                                           step[unknowns.by_view]), points)

    def prior_terms(self, state: SceneState, unknowns: Unknowns) -> PriorTerms:
        """Return cost, gradient (n,) and diagonal (n,) of the motion's distance from its plane."""
        return path_prior(state.path, self.motion, unknowns)

    def prior_count(self, views: int) -> int:
        """Count the measurements that `prior_terms` stands for."""
        return path_prior_count(self.motion, views)

    def gauge(self, state: SceneState, unknowns: Unknowns) -> np.ndarray | None:
        """Return the direction (n,) that scales the world; a camera that turns has no scale."""
        return None if self.motion.fixed_centre else scale_gauge(state.path, unknowns)


def rescaled(state: SceneState) -> SceneState:
    """Scale the world so that successive views are one unit apart (root mean square)."""
    factor = 1 / state.path.step_length()
    points = state.points * np.array([factor, factor, factor, 1])
    return replace(state, path=state.path.scaled(factor),
                   points=points / np.linalg.norm(points, axis=1, keepdims=True))
