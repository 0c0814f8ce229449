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
"""Lenses · poses in the rig · path of the rig · points of a scene; the points are eliminated."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from selfcal_ros.calibration.bundle.lens import Projection
from selfcal_ros.calibration.bundle.model import Linearisation, MINIMUM_DEPTH, Prediction
from selfcal_ros.calibration.bundle.path import crossed, SHARED_NAMES
from selfcal_ros.calibration.bundle.rig import Rig
from selfcal_ros.calibration.bundle.scene_model import SceneModel
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.unknowns import Unknowns
from selfcal_ros.geometry.projective import lengths
from selfcal_ros.geometry.schur_complement import PointBlocks


@dataclass(frozen=True)
class RigState(SceneState):
    """
    Values of all blocks of a rig before a scene.

    Attributes
    ----------
    lens : Rig
        All cameras; the path is that of the first.

    """

    lens: Rig

    def scaled(self, factor: float) -> RigState:
        """Return the state in a world that is larger by a factor."""
        larger = super().scaled(factor)
        return replace(self, path=larger.path, points=larger.points,
                       lens=self.lens.scaled(factor))


@dataclass(frozen=True)
class _Seen:
    """
    What the cameras make of points.

    Attributes
    ----------
    uv : ndarray, shape (N, 2)
    ahead : ndarray of bool, shape (N,)
    rows : list of (ndarray of int, Projection)
        Of every camera: which observations, and their images.
    before : ndarray, shape (N, 3)
        The points from their cameras' centres, along the axes of the rig.
    sign : ndarray, shape (N,)

    """

    uv: np.ndarray
    ahead: np.ndarray
    rows: list[tuple[np.ndarray, Projection]]
    before: np.ndarray
    sign: np.ndarray


@dataclass(frozen=True)
class _Placed:
    """
    Points of observations in the frames of views.

    Attributes
    ----------
    Y : ndarray, shape (N, 4)
        In the world.
    placing : ndarray, shape (N, 3, 4)
        Poses of the views.
    turned, placed : ndarray, shape (N, 3)
        Turned, and moved too, before the mount.
    seen : _Seen

    """

    Y: np.ndarray
    placing: np.ndarray
    turned: np.ndarray
    placed: np.ndarray
    seen: _Seen


@dataclass(frozen=True)
class RigModel(SceneModel):
    """
    Cameras that move together before points that stand still.

    A view is an instant, at which the rig has one pose.

    Attributes
    ----------
    camera : ndarray of int, shape (N,)
        Which camera made every observation.

    """

    camera: np.ndarray = field(default_factory=lambda: np.empty(0, int))

    def _look(self, state: RigState, X: np.ndarray, weight: np.ndarray, blocks: PointBlocks,
              xy: np.ndarray) -> _Seen:
        """Project points (N, 3) of the rig, of weights (N, 1)."""
        rig, before = state.lens, np.empty_like(X)
        uv, toward, local = np.empty_like(xy), np.empty(len(X)), np.empty_like(X)
        cameras = [np.flatnonzero(self.camera == k) for k in range(len(rig.cameras))]
        for k, rows in enumerate(cameras):
            before[rows] = X[rows] - weight[rows] * rig.place(k)
            local[rows] = before[rows] @ rig.rotations[k]
            toward[rows] = np.einsum('ni,ni->n', local[rows],
                                     rig.lens(k).pixel_directions(xy[rows]))
        sign = np.sign(blocks.sum_over_points(np.sign(toward)))[blocks.point]
        sign[sign == 0] = 1
        seen = []
        for k, rows in enumerate(cameras):
            pixels = Projection(rig.lens(k), local[rows] * sign[rows, None])
            uv[rows] = pixels.uv
            seen.append((rows, pixels))
        return _Seen(uv, toward * sign > MINIMUM_DEPTH, seen, before, sign)

    def predict(self, state: SceneState, blocks: PointBlocks, xy: np.ndarray) -> Prediction:
        """Project every observation; see `SceneModel.predict`."""
        assert isinstance(state, RigState)
        at = self._place(state, blocks, xy)
        residual = at.seen.uv - xy
        return Prediction(residual, at.seen.ahead,
                          partial(self._of_rig, state, blocks, at, residual),
                          lambda: self._by_points(state, blocks, at,
                                                  self._by_rig(state.lens, at.seen)))

    def _of_rig(self, state: RigState, blocks: PointBlocks, at: _Placed, residual: np.ndarray,
                unknowns: Unknowns) -> Linearisation:
        """Differentiate."""
        path, view, weight = state.path, blocks.view, at.Y[:, 3:]
        by_rig = self._by_rig(state.lens, at.seen)
        shared = np.zeros((len(residual), 2, unknowns.shared.stop))
        self._by_cameras(state.lens, at.seen, by_rig, weight, unknowns, shared)
        J = by_rig @ path.mount
        path.by_axis(J, at.placed, shared[:, :, unknowns.lens.stop:])
        own = path.by_views(J, at.turned, weight, view, unknowns.view_names)
        return Linearisation(residual, at.seen.ahead, shared, own,
                             self._by_points(state, blocks, at, by_rig))

    def _place(self, state: RigState, blocks: PointBlocks, xy: np.ndarray) -> _Placed:
        """Carry the points of observations to the rig, and look at them."""
        path = state.path
        Y = np.take(state.points, blocks.point, axis=0)
        poses = np.concatenate([path.rotations(), path.translation[:, :, None]], axis=2)
        placing = np.take(poses, blocks.view, axis=0)
        turned = np.einsum('nij,nj->ni', placing[:, :, :3], Y[:, :3])
        placed = turned + placing[:, :, 3] * Y[:, 3:]
        return _Placed(Y, placing, turned, placed,
                       self._look(state, placed @ path.mount.T, Y[:, 3:], blocks, xy))

    @staticmethod
    def _by_rig(rig: Rig, seen: _Seen) -> np.ndarray:
        """Differentiate by points of the rig, shape (N, 2, 3)."""
        by_rig = np.empty((len(seen.uv), 2, 3))
        for k, (rows, pixels) in enumerate(seen.rows):
            by_rig[rows] = (pixels.by_points() @ rig.rotations[k].T
                            * seen.sign[rows, None, None])
        return by_rig

    def _by_points(self, state: RigState, blocks: PointBlocks, at: _Placed,
                   by_rig: np.ndarray) -> np.ndarray:
        """Differentiate by steps of the homogeneous points, shape (N, 2, 3)."""
        by_point = (by_rig @ state.path.mount) @ at.placing
        places = np.stack([state.lens.place(k) for k in range(len(state.lens.cameras))])
        by_point[:, :, 3] -= np.einsum('nki,ni->nk', by_rig, places[self.camera])
        tangent = np.take(state.tangents, blocks.point, axis=0)
        by_steps: np.ndarray = by_point @ tangent
        return by_steps

    @staticmethod
    def _by_cameras(rig: Rig, seen: _Seen, by_rig: np.ndarray, weight: np.ndarray,
                    unknowns: Unknowns, shared: np.ndarray) -> None:
        """Differentiate by lenses and poses, which fills `shared`."""
        for k, (rows, pixels) in enumerate(seen.rows):
            lens = rig.of_lens(k)
            shared[rows, :, lens] = pixels.by_intrinsics(unknowns.free[lens])
            if k:
                J, place = by_rig[rows], rig.of_pose(k).start
                shared[rows, :, place:place + 3] = -J * weight[rows, None]
                shared[rows, :, place + 3:place + 6] = -crossed(seen.before[rows], J)

    def moved(self, state: SceneState, step: np.ndarray, steps: np.ndarray,
              unknowns: Unknowns) -> SceneState:
        """Move a state by a step (n,) of what remains and steps (P, 3) of the points."""
        assert isinstance(state, RigState)
        points = state.points + np.einsum('pij,pj->pi', state.tangents, steps)
        points /= lengths(points)[:, None]
        path = state.path.moved(step[unknowns.places(SHARED_NAMES)], step[unknowns.by_view],
                                unknowns.view_names)
        return replace(state, lens=state.lens.moved(step[unknowns.lens]), path=path,
                       points=points)
