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
Bundle adjustment: the last refinement and the covariance of every method.

Levenberg-Marquardt with geodesic acceleration on the named unknowns of a product of blocks, of
which one is eliminated. Facts, and what the blocks suppose, are measurements. The loss is Huber's.
How a residual is weighed stands in `root_weights`.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import partial
from typing import Generic

import numpy as np

from selfcal_ros.calibration.bundle.information import (huber_factors, HUBER_SIGMAS, Information,
                                                        inverse_information, winsorised_square)
from selfcal_ros.calibration.bundle.model import Linearisation, Model, Prediction
from selfcal_ros.calibration.bundle.priors import Priors
from selfcal_ros.calibration.bundle.state import SceneState, StateT
from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns
from selfcal_ros.geometry.chain_inverse import ChainInverse
from selfcal_ros.geometry.levenberg_marquardt import (curved_step, DampedFactor, minimise,
                                                      straight_step)
from selfcal_ros.geometry.projective import lengths
from selfcal_ros.geometry.reduced_system import ReducedSystem
from selfcal_ros.geometry.robust_loss import huber_loss, huber_weights
from selfcal_ros.geometry.schur_complement import PointBlocks, UnreducedSystem

#: Misfit of an observation of a point behind the camera, where the model predicts nothing.
BEHIND_SIGMAS = 100.0
#: Points whose cost changes by less than this have settled, in units of sigma².
SETTLED = 1e-5
#: A noise below this is rounding, pixels.
MIN_NOISE_PX = 1e-9
#: Covariance over that of Gaussian noise, at least.
LEAST_FACTOR = 0.5


class Bundle(Generic[StateT]):
    """
    Adjustment of a set of observations.

    Parameters
    ----------
    model : Model
        The product of blocks that predicts them.
    view, part : ndarray of int, shape (N,)
        View of each observation, and the part of the eliminated block that it belongs to (a
        point, or the view again); indices from zero, sorted by part, then view.
    xy : ndarray, shape (N, 2)
        Pixels.
    priors : Priors
        The lens model, and facts about its unknowns; those with sigma 0 are fixed.
    sigma_px : float
        Standard deviation of an image coordinate that the priors and the loss are weighed by.

    """

    def __init__(self, model: Model[StateT], view: np.ndarray, part: np.ndarray, xy: np.ndarray, *,
                 priors: Priors, sigma_px: float):
        self.model, self.view, self.part, self.xy = model, view, part, xy
        self.priors, self.sigma_px = priors, sigma_px
        self.blocks = PointBlocks(part, view)
        self.unknowns = _with_facts(
            model.unknowns(self.blocks.view_count, priors.names), priors)

    # ------------------------------------------------------------------ the same with a difference

    def with_priors(self, priors: Priors) -> Bundle[StateT]:
        """Return the same problem with other facts."""
        return self._with(priors=priors, unknowns=_with_facts(self.unknowns, priors))

    def with_sigma(self, sigma_px: float) -> Bundle[StateT]:
        """Return the same problem with another noise level."""
        return self._with(sigma_px=sigma_px)

    def _with(self, **changed: object) -> Bundle[StateT]:
        other = copy(self)
        vars(other).update(changed)
        return other

    # ------------------------------------------------------------------ model

    def predict(self, state: StateT) -> Prediction:
        """Project every observation."""
        return self.model.predict(state, self.blocks, self.xy)

    def linearise(self, state: StateT) -> Linearisation:
        """Project every observation and differentiate."""
        return self.predict(state).differentiated(self.unknowns)

    def moved(self, state: StateT, step: np.ndarray, steps: np.ndarray | None = None,
              ) -> StateT:
        """Move a state by a step (n,) of what remains, and of what is eliminated (P, p)."""
        if steps is None:
            steps = np.zeros((self.blocks.point_count, self.model.eliminated))
        return self.model.moved(state, step, steps, self.unknowns)

    def residuals(self, state: StateT) -> np.ndarray:
        """Residuals in pixels (N, m); NaN behind the camera."""
        seen = self.predict(state)
        return np.where(seen.ahead[:, None], seen.residual, np.nan)

    def prior_terms(self, state: StateT) -> PriorTerms:
        """
        Return cost, gradient and the diagonal of the prior's normal equations, in 1 / sigma².

        The facts, and the motion's distance from the plane, are measurements like any other.
        What a population of lenses says of several unknowns at once has no diagonal of its own.
        """
        cost, gradient, diagonal = self.model.prior_terms(state, self.unknowns)
        for name, prior in self.priors.soft.items():
            place = self.unknowns.places((name,))
            deviation = (state.lens[name] - prior.value) / prior.sigma
            cost += 0.5 * deviation**2
            gradient[place] += deviation / prior.sigma
            diagonal[place] += 1 / prior.sigma**2
        if self.priors.population is not None:
            more, slope, _ = self.priors.population.terms(*state.lens.named)
            cost += more
            gradient[self.unknowns.lens] += slope
        return cost, gradient, diagonal

    def add_priors(self, system: ReducedSystem, state: StateT, at: np.ndarray | None = None,
                   weight: float = 1.0, terms: PriorTerms | None = None) -> None:
        """
        Add all that is supposed to normal equations of the observations.

        Parameters
        ----------
        system : ReducedSystem
            Changed in place.
        state : BundleState
        at : ndarray of int, shape (n,), optional
            Where the unknowns of this adjustment stand, if there are more.
        weight : float
            Of the priors; -1 takes them out again.
        terms : PriorTerms, optional
            What `prior_terms` gives for this state, where it is known already.

        """
        at = np.arange(len(self.unknowns)) if at is None else at
        _, gradient, diagonal = self.prior_terms(state) if terms is None else terms
        system.gradient[at] += weight * gradient
        system.add_diagonal(at, weight * diagonal)
        system.diagonal[at] += weight * diagonal
        coupled = self.model.couplings(self.unknowns)
        if coupled is not None:
            system.add_block(at[coupled[0]], weight * coupled[1])
        if self.priors.population is not None:
            lens = at[self.unknowns.lens]
            _, _, matrix = self.priors.population.terms(*state.lens.named)
            system.add_block(lens, weight * matrix)
            system.diagonal[lens] += weight * np.diag(matrix)

    @property
    def degrees_of_freedom(self) -> int:
        """Measurements less unknowns; the scale of a scene is no unknown."""
        facts = len(self.priors.soft)
        if self.priors.population is not None:
            facts += len(self.priors.population.names)
        supposed = self.model.prior_count(self.blocks.view_count)
        unknowns = self.unknowns.count + self.model.eliminated_freedom * self.blocks.point_count
        unknowns -= self.model.has_scale_gauge
        return self.model.dimension * len(self.view) + facts + supposed - unknowns

    # ------------------------------------------------------------------ estimation

    def cost(self, state: StateT) -> float:
        """Robust cost in units of sigma²; infinite where the state is impossible."""
        return self._evaluated(state)[0]

    def _evaluated(self, state: StateT) -> tuple[float, tuple[Prediction, PriorTerms] | None]:
        """Return the cost, and what it was computed from."""
        if not state.lens.is_possible:
            return np.inf, None
        seen = self.predict(state)
        distance = self._misfits(seen)
        if not np.isfinite(distance).all():
            return np.inf, None
        loss, terms = float(huber_loss(distance, HUBER_SIGMAS).sum()), self.prior_terms(state)
        return loss + terms[0], (seen, terms)

    def _misfits(self, seen: Prediction | Linearisation) -> np.ndarray:
        """Return the length of every residual (N,) in sigmas."""
        distance = lengths(seen.residual) / self.sigma_px
        return np.where(seen.ahead, distance, np.maximum(distance, BEHIND_SIGMAS))

    def root_weights(self, linearisation: Linearisation, robust: bool = True) -> np.ndarray:
        """Return the root of every observation's weight, (N, 1): Huber's, over the noise."""
        distance = lengths(linearisation.residual) / self.sigma_px
        weight = huber_weights(distance, HUBER_SIGMAS) if robust else np.ones(len(distance))
        root: np.ndarray = np.sqrt(weight * linearisation.ahead) / self.sigma_px
        return root[:, None]

    def normal_equations(self, state: StateT, damping: float = 0.0, robust: bool = True,
                         linearisation: Linearisation | None = None) -> ReducedSystem:
        """Reduced normal equations in units of sigma, priors and scale gauge included."""
        return self.weighted_equations(state, damping, robust, linearisation)[0]

    def weighted_equations(self, state: StateT, damping: float = 0.0, robust: bool = True,
                           linearisation: Linearisation | None = None,
                           ) -> tuple[ReducedSystem, np.ndarray]:
        """Return the normal equations, and the roots of the weights (N, 1)."""
        if linearisation is None:
            linearisation = self.linearise(state)
        unreduced, root = self._weighed(linearisation, robust)
        return self._reduced(unreduced, state, damping), root

    def _weighed(self, linearisation: Linearisation, robust: bool = True,
                 ) -> tuple[UnreducedSystem, np.ndarray]:
        """Weigh a linearisation: its equations, and the roots of the weights (N, 1)."""
        root = self.root_weights(linearisation, robust)
        wide = root[..., None]
        shared, view = linearisation.shared, linearisation.view
        full = np.empty((*shared.shape[:2], shared.shape[2] + view.shape[2]))
        np.concatenate([shared, view], axis=2, out=full)
        full *= wide
        return self.blocks.unreduced_rows(full, view.shape[2], linearisation.eliminated * wide,
                                          linearisation.residual * root), root

    def _reduced(self, unreduced: UnreducedSystem, state: StateT, damping: float,
                 terms: PriorTerms | None = None) -> ReducedSystem:
        """Eliminate, and add priors and scale gauge."""
        system = unreduced.reduced(damping)
        self.add_priors(system, state, terms=terms)
        gauge = self.model.gauge(state, self.unknowns)
        if gauge is not None:
            path = self.unknowns.path
            weight = float(np.mean(system.diagonal[path][self.unknowns.free[path]]))
            system.add_gauge(weight, gauge)
        return system

    def optimise(self, state: StateT, iterations: int = 50, tolerance: float = 1e-3) -> StateT:
        """
        Minimise the robust cost by Levenberg-Marquardt.

        Parameters
        ----------
        state : BundleState
        iterations : int
            At most; it bounds the time.
        tolerance : float
            Stop when an iteration lowers the cost by less than this, in units of sigma²: all
            unknowns together then move by less than about √(2 · tolerance) of their sigma.
            `bundle/tolerances.py` has those in use.

        Returns
        -------
        BundleState

        """
        def linearise(state: StateT, known: tuple[Prediction, PriorTerms] | None,
                      ) -> tuple[UnreducedSystem, np.ndarray, PriorTerms]:
            # one attempt in three begins where the last one failed, and changes the damping alone
            seen, terms = known or (self.predict(state), self.prior_terms(state))
            return *self._weighed(seen.differentiated(self.unknowns)), terms

        def attempt(state: StateT, shared: tuple[UnreducedSystem, np.ndarray, PriorTerms],
                    damping: float) -> tuple[StateT | None, float]:
            unreduced, root, terms = shared
            system = self._reduced(unreduced, state, damping, terms)
            factor = DampedFactor(system.matrix, system.diagonal, damping,
                                  self.unknowns.selection, overwrite=True)
            if not factor.usable:
                return None, 0.0
            step, steps = (
                curved_step(system, factor, partial(self._weighted_residuals, state, root))
                if self.model.is_bent else straight_step(system, factor))
            return self.moved(state, step, steps), -0.5 * float(system.gradient @ step)

        return minimise(state, self._evaluated, linearise, attempt, iterations, tolerance)

    def _weighted_residuals(self, state: StateT, root: np.ndarray, step: np.ndarray,
                            steps: np.ndarray) -> np.ndarray:
        residual: np.ndarray = root * self.predict(self.moved(state, step, steps)).residual
        return residual

    def refine_points(self: Bundle[SceneState], state: SceneState, iterations: int = 5,
                      ) -> SceneState:
        """
        Minimise the robust cost over the points of a scene alone, each by steps of its own.

        Points intersected in closed form may be far off in the image, and a few of them would
        move the cameras in the joint adjustment.
        """
        def costs(misfit: np.ndarray) -> np.ndarray:
            loss = huber_loss(misfit, HUBER_SIGMAS)
            return self.blocks.sum_over_points(np.nan_to_num(loss, nan=np.inf))

        def equations(seen: Prediction, misfit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            assert seen.by_points is not None
            weight = huber_weights(misfit, HUBER_SIGMAS) * seen.ahead
            return self.blocks.point_equations(seen.by_points(), seen.residual, weight)

        damping = np.full(self.blocks.point_count, 1e-3)
        seen = self.predict(state)
        misfit = self._misfits(seen)
        cost, (H, b) = costs(misfit), equations(seen, misfit)
        for left in reversed(range(iterations)):
            ridge = damping * np.einsum('pii->p', H) + 1e-300
            step = -np.linalg.solve(H + ridge[:, None, None] * np.eye(3), b[..., None])[..., 0]
            moved = self.moved(state, np.zeros(len(self.unknowns)), step)
            seen = self.predict(moved)
            misfit = self._misfits(seen)
            new_cost = costs(misfit)
            better = new_cost < cost
            damping *= np.where(better, 0.1, 10.0)
            state = replace(state, points=np.where(better[:, None], moved.points, state.points))
            if not left or (np.abs(cost - new_cost) < SETTLED).all():
                break
            cost = np.minimum(cost, new_cost)
            new = equations(seen, misfit)
            H[better], b[better] = new[0][better], new[1][better]
        return state

    # ------------------------------------------------------------------ noise

    def noise_sigma(self, state: StateT) -> float:
        """
        Estimate the standard deviation of an image coordinate while there may be outliers.

        Huber's proposal 2: the winsorised sum of squares, consistent for Gaussian noise. NaN
        without degrees of freedom.
        """
        return self.noise_sigma_of(lengths(self.residuals(state)))

    def noise_sigma_of(self, distance: np.ndarray) -> float:
        """Do as `noise_sigma` with the lengths (N,) of `residuals`."""
        distance = distance[np.isfinite(distance)]
        freedom, dimension = self.degrees_of_freedom, self.model.dimension
        if freedom <= 0 or not len(distance):
            return np.nan
        fraction = freedom / (dimension * len(distance))
        expected = winsorised_square(dimension)
        sigma = float(np.sqrt(np.mean(distance**2) / (dimension * fraction)))
        for _ in range(30):
            # residuals are smaller than the noise by the root of the fraction
            limit = HUBER_SIGMAS * sigma * np.sqrt(fraction)
            sigma = float(np.sqrt(np.mean(np.minimum(distance, limit)**2)
                                  / (expected * fraction)))
        return max(sigma, MIN_NOISE_PX)

    def noise_rms(self, state: StateT) -> float:
        """Estimate the standard deviation of an image coordinate once outliers are gone."""
        square = np.nansum(self.residuals(state)**2)
        return max(float(np.sqrt(square / max(self.degrees_of_freedom, 1))), MIN_NOISE_PX)

    # ------------------------------------------------------------------ information

    def information(self, state: StateT, linearisation: Linearisation | None = None,
                    ) -> Information:
        """
        Covariance at the optimum, and the influence of every observation.

        First order. For independent noise of the level `sigma_px` the covariance is the inverse
        of the normal matrix; the Huber loss enters by the ratio of the mean of ψ² to the square
        of the mean of ψ' (Huber 1981, 7.6). Fixed unknowns have zero rows. Directions that
        neither the data nor a fact determine come out very large, not infinite.
        """
        if linearisation is None:
            linearisation = self.linearise(state)
        system = self.normal_equations(state, linearisation=linearisation)
        inverse = self.inverse(system)
        factor, pull = self.loss_factors(linearisation)
        freedom, dimension = max(self.degrees_of_freedom, 1), self.model.dimension
        seen = dimension * int(np.count_nonzero(linearisation.ahead))
        tracks = seen
        if self.model.within_tracks:
            absorbed = self.model.eliminated_freedom * self.blocks.point_count
            tracks = max(dimension * len(self.view) - absorbed, 1)
        influence = system.influence(inverse[self.unknowns.shared]) * pull
        inverse *= factor
        # of thousands of views it is hundreds of megabytes, which the inverse has taken
        system = replace(system, matrix=np.empty((0, 0)))
        return Information(inverse, influence, freedom / seen, freedom / tracks, system,
                           self.unknowns.lens, factor)

    def covariance(self, state: StateT) -> np.ndarray | ChainInverse:
        """Covariance of what remains once a block is eliminated, for independent noise, (n, n)."""
        linearisation = self.linearise(state)
        system = self.normal_equations(state, linearisation=linearisation)
        covariance = self.inverse(system)
        covariance *= self.loss_factors(linearisation)[0]
        return covariance

    def ideal_covariance(self, state: StateT) -> np.ndarray | ChainInverse:
        """Covariance (n, n) if the residuals were Gaussian noise of the stated sigma."""
        return self.inverse(self.normal_equations(state))

    def inverse(self, system: ReducedSystem) -> np.ndarray | ChainInverse:
        """Invert the normal matrix of this adjustment, or of a like one, which is lost: (n, n)."""
        return inverse_information(system.matrix, self.unknowns.selection, system.diagonal,
                                   overwrite=True)

    def loss_factors(self, linearisation: Linearisation,
                     residual: np.ndarray | None = None) -> tuple[float, float]:
        """
        Tell what covariance and influences are multiplied by; see `huber_factors`.

        Parameters
        ----------
        linearisation : Linearisation
        residual : ndarray, shape (N, m), optional
            In place of those of the linearisation.

        Returns
        -------
        factor, pull : float

        """
        residual = linearisation.residual if residual is None else residual
        distance = np.linalg.norm(residual[linearisation.ahead], axis=1) / self.sigma_px
        dimension = self.model.dimension
        freedom = max(self.degrees_of_freedom, 1)
        factor, pull = huber_factors(distance, freedom / (dimension * len(distance)), dimension)
        # residuals far below the noise are those of a noise that is supposed at least
        factor = max(factor, LEAST_FACTOR)
        # Student's: the noise is estimated too
        freedom = max(freedom, 3)
        return factor * freedom / (freedom - 2), pull


def _with_facts(unknowns: Unknowns, priors: Priors) -> Unknowns:
    """Free the unknowns of the lens but those that a fact fixes."""
    free = unknowns.free.copy()
    free[unknowns.lens] = priors.free
    return replace(unknowns, free=free)
