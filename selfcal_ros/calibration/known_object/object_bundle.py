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
Adjustment of a camera and its poses before known points.

Every pixel belongs to one view, and the points are known: the poses (six unknowns each) are
eliminated view by view, and nine equations for the calibration remain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.information import Evidence, huber_factors, HUBER_SIGMAS
from selfcal_ros.calibration.bundle.pixel_model import PixelModel
from selfcal_ros.calibration.bundle.reprojection import MINIMUM_DEPTH
from selfcal_ros.calibration.bundle.state import ASPECT, F, Prior
from selfcal_ros.geometry.levenberg_marquardt import minimise
from selfcal_ros.geometry.optimise import huber_loss, huber_weights
from selfcal_ros.geometry.rotation import rotation_matrix

#: Unknowns of a pose: a small turn on the camera's side (rad), then the translation.
POSE = 6
INTERNAL = 9


@dataclass(frozen=True)
class ObjectState:
    """
    A point in the space of the unknowns.

    Attributes
    ----------
    intrinsics : ndarray, shape (9,)
        `state.INTRINSIC_NAMES`.
    cam_from_object : ndarray, shape (V, 3, 4)
        [R | t] of every view.

    """

    intrinsics: np.ndarray
    cam_from_object: np.ndarray


@dataclass(frozen=True)
class Equations:
    """
    Normal equations in blocks.

    Attributes
    ----------
    shared : ndarray, shape (9, 9)
    cross : ndarray, shape (V, 9, 6)
    pose : ndarray, shape (V, 6, 6)
    gradient : ndarray, shape (9,)
    pose_gradient : ndarray, shape (V, 6)

    """

    shared: np.ndarray
    cross: np.ndarray
    pose: np.ndarray
    gradient: np.ndarray
    pose_gradient: np.ndarray

    def eliminate(self, damping: float = 0.0):
        """Return the damped 9 x 9 matrix, its gradient, and cross · pose⁻¹ (V, 9, 6)."""
        diagonal = np.einsum('vii->vi', self.pose)
        floor = 1e-14 * diagonal.max(axis=1, keepdims=True) + 1e-300
        pose = self.pose + (diagonal * damping + floor)[:, :, None] * np.eye(POSE)
        carry = np.swapaxes(np.linalg.solve(pose, np.swapaxes(self.cross, 1, 2)), 1, 2)
        matrix = self.shared + damping * np.diag(np.diag(self.shared))
        matrix = matrix - np.einsum('vik,vjk->ij', carry, self.cross)
        gradient = self.gradient - np.einsum('vik,vk->i', carry, self.pose_gradient)
        return matrix, gradient, pose, carry


class ObjectBundle:
    """
    Least squares over a set of observations of known points.

    Parameters
    ----------
    view : ndarray of int, shape (N,)
        Indices from zero, ascending; every view occurs.
    points : ndarray, shape (N, 3)
        Object coordinates of each observation.
    xy : ndarray, shape (N, 2)
        Pixels.
    priors : dict of int to Prior
        Of the internal parameters; those with sigma 0 are held.
    sigma_px : float
        Standard deviation of an image coordinate that the priors and the loss are weighed by.

    """

    def __init__(self, view, points, xy, *, priors: dict[int, Prior], sigma_px: float):
        self.view, self.points, self.xy = view, points, xy
        self.priors, self.sigma_px = priors, sigma_px
        self.first = np.searchsorted(view, np.arange(int(view[-1]) + 2))
        self.free = np.ones(INTERNAL, dtype=bool)
        for index, prior in priors.items():
            self.free[index] = prior.sigma > 0

    # the noise is estimated as in every other adjustment
    noise_sigma = Bundle.noise_sigma
    noise_rms = Bundle.noise_rms

    @property
    def views(self) -> int:
        """Count the views."""
        return len(self.first) - 1

    @property
    def degrees_of_freedom(self) -> int:
        """Observations and soft facts less unknowns."""
        soft = sum(0 < prior.sigma < np.inf for prior in self.priors.values())
        return 2 * len(self.view) + soft - int(self.free.sum()) - POSE * self.views

    def _project(self, state: ObjectState):
        """Return turned points, depth, which are ahead, and the pixel model."""
        R, t = state.cam_from_object[:, :, :3], state.cam_from_object[:, :, 3]
        turned = np.empty_like(self.points)
        for v in range(self.views):
            rows = slice(self.first[v], self.first[v + 1])
            np.matmul(self.points[rows], R[v].T, out=turned[rows])
        X = turned + t[self.view]
        ahead = X[:, 2] > MINIMUM_DEPTH
        depth = np.where(ahead, X[:, 2], MINIMUM_DEPTH)
        return turned, depth, ahead, PixelModel(state.intrinsics, X[:, 0] / depth,
                                                X[:, 1] / depth)

    def residuals(self, state: ObjectState) -> np.ndarray:
        """Reprojection residuals in pixels (N, 2); NaN behind the camera."""
        _, _, ahead, pixels = self._project(state)
        return np.where(ahead[:, None], pixels.uv - self.xy, np.nan)

    def cost(self, state: ObjectState) -> float:
        """Robust cost in units of sigma²; infinite where the state is impossible."""
        if not (np.isfinite(state.intrinsics).all() and state.intrinsics[F] > 0
                and state.intrinsics[ASPECT] > 0):
            return np.inf
        _, _, ahead, pixels = self._project(state)
        distance = np.linalg.norm(pixels.uv - self.xy, axis=1) / self.sigma_px
        if not np.isfinite(distance).all():
            return np.inf
        distance = np.where(ahead, distance, np.maximum(distance, 100.0))
        return float(huber_loss(distance, HUBER_SIGMAS).sum()) + self._prior_terms(state)[0]

    def _prior_terms(self, state: ObjectState):
        """Return cost, gradient and diagonal of the facts, which are measurements."""
        cost, gradient, diagonal = 0.0, np.zeros(INTERNAL), np.zeros(INTERNAL)
        for index, prior in self.priors.items():
            if 0 < prior.sigma < np.inf:
                r = (state.intrinsics[index] - prior.value) / prior.sigma
                cost += 0.5 * r * r
                gradient[index] += r / prior.sigma
                diagonal[index] += 1 / prior.sigma**2
        return cost, gradient, diagonal

    def _rows(self, state: ObjectState):
        """Return weighted derivatives and residual side by side, (N, 2, 16)."""
        turned, depth, ahead, pixels = self._project(state)
        residual = pixels.uv - self.xy
        distance = np.linalg.norm(residual, axis=1) / self.sigma_px
        weight = huber_weights(distance, HUBER_SIGMAS) * ahead
        J_X = pixels.by_points(depth)
        rows = np.empty((len(depth), 2, INTERNAL + POSE + 1))
        rows[:, :, :INTERNAL] = pixels.by_intrinsics(self.free)
        rows[:, :, :INTERNAL][:, :, ~self.free] = 0
        rows[:, :, INTERNAL:INTERNAL + 3] = np.cross(turned[:, None], J_X)
        rows[:, :, INTERNAL + 3:-1] = J_X
        rows[:, :, -1] = residual
        rows *= (np.sqrt(weight) / self.sigma_px)[:, None, None]
        return rows

    def equations(self, state: ObjectState, rows: np.ndarray | None = None) -> Equations:
        """Normal equations in units of sigma, facts included."""
        rows = self._rows(state) if rows is None else rows
        grams = np.empty((self.views, rows.shape[2], rows.shape[2]))
        for v in range(self.views):
            own = rows[self.first[v]:self.first[v + 1]].reshape(-1, rows.shape[2])
            np.matmul(own.T, own, out=grams[v])
        i, p = slice(0, INTERNAL), slice(INTERNAL, INTERNAL + POSE)
        _, gradient, diagonal = self._prior_terms(state)
        return Equations(grams[:, i, i].sum(axis=0) + np.diag(diagonal), grams[:, i, p],
                         grams[:, p, p], grams[:, i, -1].sum(axis=0) + gradient,
                         grams[:, p, -1])

    def optimise(self, state: ObjectState, iterations: int = 60,
                 tolerance: float = 1e-4) -> ObjectState:
        """
        Minimise the robust cost by Levenberg-Marquardt.

        Parameters
        ----------
        state : ObjectState
        iterations : int
        tolerance : float
            Stop when an iteration lowers the cost by less, in units of sigma².

        Returns
        -------
        ObjectState

        """
        return minimise(state, self.cost, self.equations, self._attempt, iterations, tolerance,
                        least=1e-12)

    def _attempt(self, state: ObjectState, equations: Equations, damping: float):
        """Return the state after one damped step, None where there is none, and the gain."""
        try:
            matrix, gradient, pose, carry = equations.eliminate(damping)
            index = np.flatnonzero(self.free)
            H = matrix[np.ix_(index, index)]
            root = np.sqrt(np.maximum(np.diag(equations.shared)[index], 1e-300))
            step = np.zeros(INTERNAL)
            step[index] = -np.linalg.solve(H / np.outer(root, root), gradient[index] / root) / root
            right = equations.pose_gradient + np.einsum('vik,i->vk', equations.cross, step)
            poses = -np.linalg.solve(pose, right[..., None])[..., 0]
        except np.linalg.LinAlgError:
            return None, 0.0
        expected = -0.5 * (equations.gradient @ step + np.sum(equations.pose_gradient * poses))
        if not (np.isfinite(step).all() and np.isfinite(poses).all()):
            return None, 0.0
        moved = np.array(state.cam_from_object)
        moved[:, :, :3] = rotation_matrix(poses[:, :3]) @ moved[:, :, :3]
        moved[:, :, 3] += poses[:, 3:]
        return ObjectState(state.intrinsics + step, moved), expected

    def _inverse(self, matrix: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """Invert the free part of a normal matrix (9, 9), open directions made very large."""
        index = np.flatnonzero(self.free)
        # what the poses leave of a parameter may be nothing but rounding: scale before it
        root = np.sqrt(np.maximum(np.diag(whole)[index], 1e-300))
        values, vectors = np.linalg.eigh(matrix[np.ix_(index, index)] / np.outer(root, root))
        values = np.maximum(values, 1e-13 * values[-1])
        inverse = np.zeros((INTERNAL, INTERNAL))
        inverse[np.ix_(index, index)] = (vectors / values) @ vectors.T / np.outer(root, root)
        return inverse

    def ideal_covariance(self, state: ObjectState) -> np.ndarray:
        """Covariance (9, 9) if the residuals were Gaussian noise of the stated sigma."""
        equations = self.equations(state)
        return self._inverse(equations.eliminate()[0], equations.shared)

    def evidence(self, state: ObjectState) -> Evidence:
        """
        Covariance of the internal parameters at the optimum, and every observation's influence.

        First order; the Huber loss enters as in `Bundle.evidence` (Huber 1981, 7.6). Directions
        that neither the data nor a fact determine come out very large, not infinite.
        """
        rows = self._rows(state)
        equations = self.equations(state, rows)
        matrix, _, _, carry = equations.eliminate()
        distance = np.linalg.norm(self.residuals(state), axis=1) / self.sigma_px
        distance = distance[np.isfinite(distance)]
        share = max(self.degrees_of_freedom, 1) / (2 * len(distance))
        factor, pull = huber_factors(distance, share)
        inverse = self._inverse(matrix, equations.shared)
        single = np.einsum('nki,nk->ni', rows[:, :, :-1], rows[:, :, -1])
        own = single[:, :INTERNAL] - np.einsum('nik,nk->ni', carry[self.view],
                                               single[:, INTERNAL:])
        return Evidence(inverse * factor, -own @ inverse * pull, share, share)
