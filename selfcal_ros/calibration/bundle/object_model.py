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
Lens · poses · points or edges of a known object; the poses are eliminated.

Every observation belongs to one view, so that the poses (six unknowns each) go view by view and
only the equations of the lens remain. An edgel lies somewhere on the image of its edge: one
equation, its distance from the projected edge (thesis 7.2, equation 7.12, with the calibration
among the unknowns; 8.2 asks for it).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from selfcal_ros.calibration.bundle.edge_rows import EdgeRows
from selfcal_ros.calibration.bundle.lens import Lens, Projection
from selfcal_ros.calibration.bundle.model import Linearisation, MINIMUM_DEPTH, Prediction
from selfcal_ros.calibration.bundle.object_bend import Bend, SHAPE_NAMES
from selfcal_ros.calibration.bundle.object_poses import ObjectPoses, VIEW_NAMES
from selfcal_ros.calibration.bundle.object_rows import MovedPoints, ObjectRows
from selfcal_ros.calibration.bundle.own_rows import ROW_NAMES
from selfcal_ros.calibration.bundle.shutter import LINE_DELAY
from selfcal_ros.calibration.bundle.state import ObjectState
from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns
from selfcal_ros.geometry.schur_complement import PointBlocks

#: An edgel may slide along its edge by so much of the depth; beyond it the first order of the
#: projection means nothing.
MAX_SLIDE = 0.1


def _look(lens: Lens, X: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, Projection]:
    """Tell which points (N, 3) lie ahead, and project them; the others get the least depth."""
    if lens.model.is_perspective:
        ahead = X[:, 2] > MINIMUM_DEPTH
        return ahead, Projection(lens, np.column_stack(
            [X[:, :2], np.where(ahead, X[:, 2], MINIMUM_DEPTH)]))
    ahead = np.einsum('ni,ni->n', X, lens.pixel_directions(xy)) > MINIMUM_DEPTH
    return ahead, Projection(lens, X)


class _PoseElimination:
    """What points and edges of known objects have in common."""

    eliminated = eliminated_freedom = len(VIEW_NAMES)
    within_tracks = has_scale_gauge = is_bent = False

    def unknowns(self, views: int, lens_names: tuple[str, ...]) -> Unknowns:
        """Lay out what remains once the poses are eliminated: the lens."""
        return Unknowns.all_free(lens_names)

    def moved(self, state: ObjectState, step: np.ndarray, steps: np.ndarray,
              unknowns: Unknowns) -> ObjectState:
        """Move a state by a step (n,) of the lens and steps (V, 6) of the poses."""
        return replace(state, lens=state.lens.moved(step[unknowns.lens]),
                       path=state.path.moved(steps))

    def prior_terms(self, state: ObjectState, unknowns: Unknowns) -> PriorTerms:
        """Nothing is supposed of the poses."""
        return 0.0, np.zeros(len(unknowns)), np.zeros(len(unknowns))

    def couplings(self, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray] | None:
        """Return None: nothing is supposed of the poses."""
        return None

    def prior_count(self, views: int) -> int:
        """Nothing is supposed of the poses."""
        return 0

    def gauge(self, state: ObjectState, unknowns: Unknowns) -> None:
        """Return None: the object fixes the frame and the scale."""


@dataclass(frozen=True)
class KnownPoints(_PoseElimination):
    """
    Known points, one for every observation.

    Attributes
    ----------
    points : ndarray, shape (N, 3)
        In the object's frame.
    bend : Bend, optional
        How a board may bend, and its print be off; its points are held where they are without.
    rows : ObjectRows, optional
        How the object may move while each image is read; all lines are read at once without.

    """

    points: np.ndarray
    bend: Bend | None = None
    rows: ObjectRows | None = None

    dimension = 2

    def unknowns(self, views: int, lens_names: tuple[str, ...]) -> Unknowns:
        """Lay out what remains once the poses are eliminated: lens, bend and motions."""
        shared = () if self.bend is None else SHAPE_NAMES
        if self.rows is None:
            return Unknowns.all_free(lens_names, shared)
        return self.rows.effects.extend(Unknowns.all_free(lens_names, shared, (), views))

    def moved(self, state: ObjectState, step: np.ndarray, steps: np.ndarray,
              unknowns: Unknowns) -> ObjectState:
        """Move a state by a step (n,) of all but the poses, and steps (V, 6) of these."""
        state = super().moved(state, step, steps, unknowns)
        if self.rows is not None:
            state = replace(state, row_motion=self.rows.effects.moved(
                state.row_motion, step, unknowns))
        if self.bend is None:
            return state
        return replace(state, bend=state.bend + step[unknowns.places(SHAPE_NAMES)])

    def prior_terms(self, state: ObjectState, unknowns: Unknowns) -> PriorTerms:
        """Return cost, gradient (n,) and diagonal (n,) of what is supposed beside the poses."""
        cost, gradient, diagonal = terms = super().prior_terms(state, unknowns)
        if self.rows is not None:
            cost, gradient, diagonal = self.rows.effects.add_prior(
                terms, state.row_motion, unknowns)
        if self.bend is None:
            return cost, gradient, diagonal
        place, weight = unknowns.places(SHAPE_NAMES), 1 / self.bend.sigma**2
        gradient[place] = weight * state.bend
        diagonal[place] = weight
        return cost + 0.5 * float(weight @ state.bend**2), gradient, diagonal

    def couplings(self, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray] | None:
        """Return what motions about a common mean add beside the diagonal."""
        return None if self.rows is None else self.rows.effects.couplings(unknowns)

    def prior_count(self, views: int) -> int:
        """Count the measurements that `prior_terms` stands for."""
        return ((0 if self.bend is None else len(SHAPE_NAMES))
                + (0 if self.rows is None else self.rows.effects.count(views)))

    def predict(self, state: ObjectState, blocks: PointBlocks, xy: np.ndarray) -> Prediction:
        """Project every point; see `SceneModel.predict`."""
        points = self.points if self.bend is None else self.points + self.bend.off(state.bend)
        turned = state.path.turned(points, blocks.view)
        there = state.path.translations(blocks.view)
        X = turned + there
        ahead, pixels = _look(state.lens, X, xy)
        moved = None
        if self.rows is not None:
            motion = (np.zeros((len(state.path), len(ROW_NAMES))) if state.row_motion is None
                      else state.row_motion)
            moved = MovedPoints.of(turned, self.rows.delays(pixels.uv, xy), motion[blocks.view],
                                   np.linalg.norm(there, axis=1))
            ahead, pixels = _look(state.lens, moved.turned + there + moved.move, xy)
        residual = pixels.uv - xy

        def differentiated(unknowns: Unknowns) -> Linearisation:
            # how a point's line moves with the rest is left out: it is some per cent of the motion
            J = pixels.by_points()
            own, by_place = np.empty((len(xy), 2, 0)), J
            if moved is not None:
                own, by_place = moved.by_motion(J), moved.by_place(J, there)
                J = J @ moved.R
            shared = pixels.by_intrinsics(unknowns.free, unknowns.shared.stop)
            if self.bend is not None:
                by_object = J @ state.path.cam_from_object[blocks.view, :, :3]
                shared[:, :, unknowns.places(SHAPE_NAMES)] = (
                    by_object @ self.bend.modes.transpose(0, 2, 1))
            by_steps = ObjectPoses.by_steps(J, turned)
            by_steps[:, :, 3:] = by_place
            return Linearisation(residual, ahead, shared, own, by_steps)

        return Prediction(residual, ahead, differentiated)


@dataclass(frozen=True)
class _Feet:
    """
    Where each edge lies nearest to its edgel.

    Attributes
    ----------
    turned : ndarray, shape (N, 3)
        The points, turned into the camera's frame but not yet moved.
    ahead : ndarray of bool, shape (N,)
    pixels : Projection
    normal : ndarray, shape (N, 2)
        Unit normals of the projected edges.
    by_point : ndarray, shape (N, 2, 3)
        Derivatives of the pixels by the points.

    """

    turned: np.ndarray
    ahead: np.ndarray
    pixels: Projection
    normal: np.ndarray
    by_point: np.ndarray


@dataclass(frozen=True)
class KnownEdges(_PoseElimination):
    """
    Known edges, one for every edgel.

    Attributes
    ----------
    points, tangents : ndarray, shape (N, 3)
        A point of each edgel's edge, near where it was seen, and the edge's direction there, in
        the object's frame.
    rows : EdgeRows, optional
        How far edges move until they are read, where the line delay is unknown.

    """

    points: np.ndarray
    tangents: np.ndarray
    rows: EdgeRows | None = None

    dimension = 1

    def unknowns(self, views: int, lens_names: tuple[str, ...]) -> Unknowns:
        """Lay out what remains once the poses are eliminated: lens and line delay."""
        return Unknowns.all_free(lens_names, () if self.rows is None else (LINE_DELAY,))

    def moved(self, state: ObjectState, step: np.ndarray, steps: np.ndarray,
              unknowns: Unknowns) -> ObjectState:
        """Move a state by a step (n,) of all but the poses, and steps (V, 6) of these."""
        state = super().moved(state, step, steps, unknowns)
        if self.rows is None:
            return state
        return replace(state, line_delay_s=state.line_delay_s + float(
            step[unknowns.places((LINE_DELAY,))[0]]))

    def predict(self, state: ObjectState, blocks: PointBlocks, xy: np.ndarray) -> Prediction:
        """Measure every edgel from its edge; see `SceneModel.predict`."""
        xy = self._read_at_once(state, xy)
        feet = self._nearest(state, blocks.view, xy)
        residual = np.einsum('ni,ni->n', feet.pixels.uv - xy, feet.normal)[:, None]

        def differentiated(unknowns: Unknowns) -> Linearisation:
            J = np.einsum('nij,ni->nj', feet.by_point, feet.normal)[:, None]
            by_lens = feet.pixels.by_intrinsics(unknowns.free, unknowns.shared.stop)
            shared = np.einsum('nij,ni->nj', by_lens, feet.normal)[:, None]
            if self.rows is not None:
                shared[:, 0, unknowns.places((LINE_DELAY,))] = np.einsum(
                    'ni,ni->n', self.rows.slope, feet.normal)[:, None]
            return Linearisation(residual, feet.ahead, shared, np.empty((len(xy), 1, 0)),
                                 ObjectPoses.by_steps(J, feet.turned))

        return Prediction(residual, feet.ahead, differentiated)

    def normals(self, state: ObjectState, view: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """Unit normals (N, 2) of the projected edges, where each lies nearest to its edgel."""
        return self._nearest(state, view, self._read_at_once(state, xy)).normal

    def _read_at_once(self, state: ObjectState, xy: np.ndarray) -> np.ndarray:
        """Return where edgels (N, 2) were when the middle line was read."""
        return xy if self.rows is None else self.rows.back(xy, state.line_delay_s)

    def _nearest(self, state: ObjectState, view: np.ndarray, xy: np.ndarray) -> _Feet:
        """Project the point of each edge that lies nearest to its edgel."""
        turned = state.path.turned(self.points, view)
        along = state.path.turned(self.tangents, view)
        move = state.path.translations(view)

        def project(turned: np.ndarray) -> tuple[_Feet, np.ndarray, np.ndarray]:
            X = turned + move
            ahead, pixels = _look(state.lens, X, xy)
            by_point = pixels.by_points()
            run = np.einsum('nij,nj->ni', by_point, along)
            length = np.maximum(np.linalg.norm(run, axis=1), 1e-12)
            run /= length[:, None]
            normal = np.column_stack([-run[:, 1], run[:, 0]])
            slide = np.einsum('ni,ni->n', xy - pixels.uv, run) / length
            reach = MAX_SLIDE * np.where(ahead, np.linalg.norm(X, axis=1), 0.0)
            return _Feet(turned, ahead, pixels, normal, by_point), slide, reach

        _, slide, limit = project(turned)
        return project(turned + np.clip(slide, -limit, limit)[:, None] * along)[0]
