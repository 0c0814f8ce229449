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
Motion-constrained bundle adjustment: the last refinement and the covariance of every method.

Levenberg-Marquardt with geodesic acceleration on the unknowns of `state.BundleState`, the points
eliminated, facts and planarity as measurements, Huber's loss.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import csr_array

from selfcal_ros.calibration.bundle.information import (Evidence, huber_factors, HUBER_SIGMAS,
                                                        inverse_information)
from selfcal_ros.calibration.bundle.reprojection import Linearisation, linearise
from selfcal_ros.calibration.bundle.state import (ASPECT, BundleState, F, MotionModel, PER_VIEW,
                                                  Prior, ROTATION, SHARED)
from selfcal_ros.geometry.levenberg_marquardt import curved_step, DampedFactor, minimise
from selfcal_ros.geometry.optimise import (huber_loss, huber_weights, PointBlocks, ReducedSystem,
                                           unknowns_of)
from selfcal_ros.geometry.projective import tangent_basis
from selfcal_ros.geometry.rotation import rotation_matrix

#: Misfit of an observation of a point behind the camera, where the model predicts nothing.
BEHIND_SIGMAS = 100.0


class Bundle:
    """
    Bundle adjustment of a set of observations.

    Parameters
    ----------
    view, point : ndarray of int, shape (N,)
        Indices from zero, sorted by point, then view.
    xy : ndarray, shape (N, 2)
        Pixels.
    motion : MotionModel
    priors : dict of int to Prior
        Of the internal parameters; those with sigma 0 are held.
    sigma_px : float
        Standard deviation of an image coordinate that the priors and the loss are weighed by.

    """

    def __init__(self, view, point, xy, *, motion: MotionModel, priors: dict[int, Prior],
                 sigma_px: float):
        self.blocks = PointBlocks(point, view)
        self.view, self.point, self.xy = view, point, xy
        self.motion, self.priors, self.sigma_px = motion, priors, sigma_px
        views = self.blocks.view_count
        free = np.ones(SHARED + PER_VIEW * views, dtype=bool)
        per_view = free[SHARED:].reshape(views, PER_VIEW)
        per_view[0, [0, 1, 2, 5]] = False      # the world frame is that of the first view
        if motion.tilt_sigma_rad == 0:
            per_view[:, 3:5] = False
        elif not motion.keeps_plane:
            # no plane: the world's directions are gauge, too
            per_view[0, 3:5] = False
            free[9:SHARED] = False
        if motion.height_sigma == 0:
            per_view[:, 5] = False
        for index, prior in priors.items():
            free[index] = prior.sigma > 0
        self.free = free

    def unknowns(self) -> csr_array:
        """Relate all parameters to the independent ones: parallel views share a rotation."""
        shared = np.arange(len(self.free))
        if self.motion.parallel:
            of_view = shared[SHARED:].reshape(-1, PER_VIEW)
            of_view[np.ix_(self.motion.parallel, ROTATION)] = of_view[self.motion.parallel[0],
                                                                      ROTATION]
        return unknowns_of(self.free, shared)

    # ------------------------------------------------------------------ model

    def linearise(self, state: BundleState, jacobians: bool = True) -> Linearisation:
        """Project every observation and differentiate."""
        return linearise(state, self.blocks, self.xy, self.free, jacobians)

    def apply(self, state: BundleState, step: np.ndarray, point_steps: np.ndarray) -> BundleState:
        """Move a state by a step of the unknowns."""
        points = state.points + np.einsum('pij,pj->pi', tangent_basis(state.points), point_steps)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        return BundleState(
            state.intrinsics + step[:9],
            state.mount @ rotation_matrix(np.array([step[9], step[10], 0.0])),
            state.views + step[SHARED:].reshape(-1, PER_VIEW), points)

    # ------------------------------------------------------------------ prior terms

    def prior_terms(self, state: BundleState):
        """
        Return cost, gradient and the diagonal of the prior's normal equations, in 1 / sigma².

        The facts and the motion's distance from the plane are measurements like any other.
        """
        n = len(self.free)
        gradient, diagonal = np.zeros(n), np.zeros(n)
        cost = 0.0
        for index, prior in self.priors.items():
            if 0 < prior.sigma < np.inf:
                r = (state.intrinsics[index] - prior.value) / prior.sigma
                cost += 0.5 * r * r
                gradient[index] += r / prior.sigma
                diagonal[index] += 1 / prior.sigma**2
        scale = state.step_length() if self.motion.height_sigma else 1.0
        for columns, sigma in (((3, 4), self.motion.tilt_sigma_rad),
                               ((5,), self.motion.height_sigma * scale)):
            if not 0 < sigma < np.inf:
                continue
            for column in columns:
                index = SHARED + column + PER_VIEW * np.arange(len(state.views))
                value = state.views[:, column]
                cost += 0.5 * float(np.sum((value / sigma)**2))
                gradient[index] += value / sigma**2
                diagonal[index] += 1 / sigma**2
        return cost, gradient, diagonal

    def gauge(self, state: BundleState) -> np.ndarray:
        """Return the direction in the unknowns that only scales the world, unit length."""
        direction = np.zeros(len(self.free))
        views = direction[SHARED:].reshape(-1, PER_VIEW)
        views[:, [1, 2, 5]] = state.views[:, [1, 2, 5]]
        direction[~self.free] = 0
        return direction / max(float(np.linalg.norm(direction)), 1e-300)

    # ------------------------------------------------------------------ estimation

    def cost(self, state: BundleState) -> float:
        """Robust cost in units of sigma²; infinite where the state is impossible."""
        if not (np.isfinite(state.intrinsics).all() and state.intrinsics[F] > 0
                and state.intrinsics[ASPECT] > 0):
            return np.inf
        distance = self._misfits(self.linearise(state, jacobians=False))
        if not np.isfinite(distance).all():
            return np.inf
        return float(huber_loss(distance, HUBER_SIGMAS).sum()) + self.prior_terms(state)[0]

    def _misfits(self, line: Linearisation) -> np.ndarray:
        """Return the length of every residual (N,) in sigmas."""
        distance = np.linalg.norm(line.residual, axis=1) / self.sigma_px
        return np.where(line.ahead, distance, np.maximum(distance, BEHIND_SIGMAS))

    def normal_equations(self, state: BundleState, damping: float = 0.0, robust: bool = True,
                         line: Linearisation | None = None) -> ReducedSystem:
        """Reduced normal equations in units of sigma, priors and scale gauge included."""
        return self.weighted_equations(state, damping, robust, line)[0]

    def weighted_equations(self, state, damping=0.0, robust=True, line=None):
        """Return the normal equations, and the roots of the weights (N, 1)."""
        line = self.linearise(state) if line is None else line
        distance = np.linalg.norm(line.residual, axis=1) / self.sigma_px
        weight = huber_weights(distance, HUBER_SIGMAS) if robust else np.ones(len(distance))
        root = (np.sqrt(weight * line.ahead) / self.sigma_px)[:, None]
        system = self.blocks.reduce(line.shared * root[..., None], line.view * root[..., None],
                                    line.point * root[..., None], line.residual * root, damping)
        _, gradient, diagonal = self.prior_terms(state)
        system.gradient += gradient
        system.matrix[np.diag_indices_from(system.matrix)] += diagonal
        system.diagonal += diagonal
        gauge = self.gauge(state)
        weight = float(np.mean(system.diagonal[SHARED:][self.free[SHARED:]]))
        system.matrix += weight * np.outer(gauge, gauge)
        return system, root

    def optimise(self, state: BundleState, iterations: int = 50,
                 tolerance: float = 1e-3) -> BundleState:
        """
        Minimise the robust cost by Levenberg-Marquardt.

        Parameters
        ----------
        state : BundleState
        iterations : int
        tolerance : float
            Stop when an iteration lowers the cost by less than this, in units of sigma²: all
            unknowns together then move by less than about √(2 · tolerance) of their sigma.

        Returns
        -------
        BundleState

        """
        unknowns = self.unknowns()

        def attempt(state, line, damping):
            system, root = self.weighted_equations(state, damping, line=line)
            factor = DampedFactor(system.matrix, system.diagonal, damping, unknowns)
            if not factor.usable:
                return None, 0.0
            step, point_steps = curved_step(system, factor, partial(
                self._weighted_residuals, state, root))
            return (self.apply(state, step, point_steps),
                    -0.5 * float(system.gradient @ step))

        return minimise(state, self.cost, self.linearise, attempt, iterations, tolerance)

    def _weighted_residuals(self, state, root, step, point_steps):
        ahead = self.linearise(self.apply(state, step, point_steps), jacobians=False)
        return root * ahead.residual

    def settle_points(self, state: BundleState, iterations: int = 5) -> BundleState:
        """
        Minimise the robust cost over the points alone, every point by steps of its own.

        Points intersected in closed form may be far off in the image, and a few of them would
        move the cameras in the joint adjustment.
        """
        def point_costs(line):
            loss = np.nan_to_num(huber_loss(self._misfits(line), HUBER_SIGMAS), nan=np.inf)
            return self.blocks.sum_over_points(loss)

        damping = np.full(self.blocks.point_count, 1e-3)
        line = self.linearise(state)
        cost = point_costs(line)
        for _ in range(iterations):
            weight = huber_weights(self._misfits(line), HUBER_SIGMAS) * line.ahead
            weighted = np.swapaxes(line.point * weight[:, None, None], 1, 2)
            H = self.blocks.sum_over_points(weighted @ line.point)
            b = self.blocks.sum_over_points(weighted @ line.residual[..., None])
            ridge = damping * np.einsum('pii->p', H) + 1e-300
            step = -np.linalg.solve(H + ridge[:, None, None] * np.eye(3), b)[..., 0]
            moved = self.apply(state, np.zeros(len(self.free)), step)
            new_cost = point_costs(self.linearise(moved, jacobians=False))
            better = new_cost < cost
            damping *= np.where(better, 0.1, 10.0)
            state = replace(state, points=np.where(better[:, None], moved.points, state.points))
            cost = np.minimum(cost, new_cost)
            line = self.linearise(state)
        return state

    # ------------------------------------------------------------------ evidence

    def residuals(self, state: BundleState) -> np.ndarray:
        """Reprojection residuals in pixels (N, 2); NaN behind the camera."""
        line = self.linearise(state, jacobians=False)
        return np.where(line.ahead[:, None], line.residual, np.nan)

    @property
    def degrees_of_freedom(self) -> int:
        """Observations less unknowns (the scale of the world is no unknown)."""
        priors = sum(0 < p.sigma < np.inf for p in self.priors.values())
        views = self.blocks.view_count
        priors += 2 * views * (0 < self.motion.tilt_sigma_rad < np.inf)
        priors += views * (0 < self.motion.height_sigma < np.inf)
        unknowns = self.unknowns().shape[1] - 1 + 3 * self.blocks.point_count
        return 2 * len(self.view) + priors - unknowns

    def noise_sigma(self, state: BundleState) -> float:
        """
        Estimate the standard deviation of an image coordinate while there may be outliers.

        Huber's proposal 2: the winsorised sum of squares, consistent for Gaussian noise.
        """
        distance = np.linalg.norm(self.residuals(state), axis=1)
        distance = distance[np.isfinite(distance)]
        freedom = self.degrees_of_freedom
        if freedom <= 0 or not len(distance):
            return np.nan
        # E[min(d, cσ)²] for a two-dimensional Gaussian is 2 σ² (1 - exp(-c² / 2))
        share = freedom / (2 * len(distance))
        expected = 2 * (1 - np.exp(-HUBER_SIGMAS**2 / 2))
        sigma = float(np.sqrt(np.mean(distance**2) / (2 * share)))
        for _ in range(30):
            # residuals are smaller than the noise by √share
            limit = HUBER_SIGMAS * sigma * np.sqrt(share)
            sigma = float(np.sqrt(np.mean(np.minimum(distance, limit)**2) / (expected * share)))
        return max(sigma, 1e-9)

    def noise_rms(self, state: BundleState) -> float:
        """Estimate the standard deviation of an image coordinate once outliers are gone."""
        square = np.nansum(self.residuals(state)**2)
        return max(float(np.sqrt(square / max(self.degrees_of_freedom, 1))), 1e-9)

    def evidence(self, state: BundleState, line: Linearisation | None = None) -> Evidence:
        """
        Covariance at the optimum, and the influence of every observation.

        First order. For independent noise of the level `sigma_px` the covariance is the inverse
        of the normal matrix; the Huber loss enters by the ratio of the mean of ψ² to the square
        of the mean of ψ' (Huber 1981, 7.6). Held unknowns have zero rows. Directions that
        neither the data nor a fact determine come out very large, not infinite.
        """
        line = self.linearise(state) if line is None else line
        system = self.normal_equations(state, line=line)
        inverse = inverse_information(system.matrix, self.unknowns())
        factor, pull = self.loss_factors(line.residual[line.ahead])
        freedom, measured = self.degrees_of_freedom, 2 * len(self.view) - 3 * len(state.points)
        return Evidence(inverse * factor, system.influence(inverse[:SHARED]) * pull,
                        max(freedom, 1) / (2 * int(np.count_nonzero(line.ahead))),
                        max(freedom, 1) / max(measured, 1), system)

    def covariance(self, state: BundleState) -> np.ndarray:
        """Covariance of the shared and per-view unknowns for independent noise, (n, n)."""
        line = self.linearise(state)
        system = self.normal_equations(state, line=line)
        return (inverse_information(system.matrix, self.unknowns())
                * self.loss_factors(line.residual[line.ahead])[0])

    def loss_factors(self, residual: np.ndarray) -> tuple[float, float]:
        """Tell what covariance and influences are multiplied by; see `huber_factors`."""
        distance = np.linalg.norm(residual, axis=1) / self.sigma_px
        freedom = self.degrees_of_freedom
        factor, pull = huber_factors(distance, max(freedom, 1) / (2 * len(distance)))
        # Student's: the noise is estimated too
        freedom = max(freedom, 3)
        return factor * freedom / (freedom - 2), pull

    def with_priors(self, priors: dict[int, Prior]) -> Bundle:
        """Return the same problem with other facts."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__, priors=priors, free=self.free.copy())
        other.free[:9] = True
        for index, prior in priors.items():
            other.free[index] = prior.sigma > 0
        return other

    def with_sigma(self, sigma_px: float) -> Bundle:
        """Return the same problem with another noise level."""
        other = object.__new__(Bundle)
        other.__dict__.update(self.__dict__, sigma_px=sigma_px)
        return other
