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
"""Levenberg-Marquardt: the descent, the damped step and its geodesic acceleration."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.sparse import csr_array

from selfcal_ros.geometry.chain_factor import ChainFactor, NotPositive
from selfcal_ros.geometry.chain_matrix import ChainMatrix
from selfcal_ros.geometry.reduced_system import ReducedSystem


#: A step that changes nothing means a minimum where the damping is below the first, and nothing
#: helps any more where it is above the second.
_SMALL, _HOPELESS = 1e-2, 1e8
#: Fewer unknowns are copied sooner than packed in place.
_MANY = 1000
#: Length of twice the acceleration over that of the step, at most (Transtrum and Sethna 2012).
_MAX_ACCELERATION = 0.75

_State = TypeVar('_State')
_Seen = TypeVar('_Seen')
_Shared = TypeVar('_Shared')


# a step that is tried may lead to numbers that are none; its cost is infinite then
@np.errstate(divide='ignore', over='ignore', invalid='ignore')
def minimise(state: _State, evaluate: Callable[[_State], tuple[float, _Seen]],
             linearise: Callable[[_State, _Seen], _Shared],
             attempt: Callable[[_State, _Shared, float], tuple[_State | None, float]],
             iterations: int, tolerance: float, least: float = 1e-10) -> _State:
    """
    Minimise a cost by Levenberg-Marquardt.

    Parameters
    ----------
    state
        Where to start.
    evaluate : callable
        state to its cost, infinite where it is impossible, and to what else is known then.
    linearise : callable
        state, and what else is known of it, to what every attempt from there shares; called once
        for each state that is reached.
    attempt : callable
        (state, what it shares, damping) to a state one damped step further, None where there is
        none, and the decrease of the cost by the linear model.
    iterations : int
    tolerance : float
        Stop when an iteration lowers the cost by less than this.
    least : float
        Smallest damping.

    Returns
    -------
    state

    """
    cost, seen = evaluate(state)
    linearisation: _Shared | None = None
    damping, growth = 1e-4, 2.0
    for _ in range(iterations):
        linearisation = linearise(state, seen) if linearisation is None else linearisation
        moved, expected = attempt(state, linearisation, damping)
        new_cost, new_seen = (np.inf, seen) if moved is None else evaluate(moved)
        decrease = cost - new_cost
        if abs(decrease) < tolerance and damping < _SMALL:
            return moved if moved is not None and decrease > 0 else state
        if moved is not None and decrease > 0:
            # trust the model as far as it held (Nielsen 1999)
            gain = min(decrease / max(expected, 1e-300), 1.0)
            damping = max(damping * max(0.1, 1 - (2 * gain - 1)**3), least)
            state, cost, seen, linearisation, growth = moved, new_cost, new_seen, None, 2.0
        else:
            damping, growth = max(damping, 1e-8) * growth, growth * 2
            if damping > _HOPELESS:
                break
    return state


def places_of(unknowns: csr_array) -> np.ndarray | None:
    """
    Find where each independent unknown stands, where none moves with another.

    Parameters
    ----------
    unknowns : csr_array, shape (n, k)
        Of `selection_matrix`.

    Returns
    -------
    ndarray of int, shape (k,), or None

    """
    if unknowns.nnz != unknowns.shape[1]:
        return None
    places = np.empty(unknowns.nnz, int)
    places[unknowns.indices] = np.flatnonzero(np.diff(unknowns.indptr))
    return places


def restricted(matrix: np.ndarray, unknowns: csr_array, overwrite: bool = False) -> np.ndarray:
    """
    Return the normal matrix of the independent unknowns.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Its rows are contiguous.
    unknowns : csr_array, shape (n, k)
        Of `selection_matrix`.
    overwrite : bool
        Whether the result may take the memory of the matrix, which is lost then: of thousands of
        views it is hundreds of megabytes.

    Returns
    -------
    ndarray, shape (k, k)

    """
    places = places_of(unknowns)
    if places is None:
        folded: np.ndarray = unknowns.T @ (unknowns.T @ matrix).T
        return folded
    size = len(places)
    if not overwrite or size < _MANY:
        of_places: np.ndarray = matrix[np.ix_(places, places)]
        return of_places
    packed = matrix.reshape(-1)[:size * size].reshape(size, size)
    if size < len(matrix):
        # no row is written where a later one is still to be read
        for row, place in zip(packed, places):
            row[:] = matrix[place, places]
    return packed


class DampedFactor:
    """
    Cholesky factor of the damped normal equations of the unknowns.

    Parameters
    ----------
    matrix : ndarray or ChainMatrix, shape (n, n)
    diagonal : ndarray, shape (n,)
        Scales the parameters (pixels, radians, lengths) to one unit.
    damping : float
        Levenberg-Marquardt factor.
    unknowns : csr_array, shape (n, k)
        Of `selection_matrix`.
    overwrite : bool
        Whether the factor may take the memory of the matrix, which is lost then.

    Attributes
    ----------
    usable : bool
        False where the damped matrix is not positive definite.

    """

    def __init__(self, matrix: np.ndarray | ChainMatrix, diagonal: np.ndarray, damping: float,
                 unknowns: csr_array, overwrite: bool = False):
        self._unknowns = E = unknowns
        self._places = places_of(E)
        if self._places is not None:
            self._members, scale = 1.0, diagonal[self._places]
        else:
            taking_part, self._collecting = abs(E), E.T
            self._members, scale = taking_part.sum(axis=0), taking_part.T @ diagonal
        scale = np.maximum(scale, 1e-300)
        # an unknown that nothing measures must not blow up the scaled matrix
        middle = np.partition(scale, len(scale) // 2)[len(scale) // 2] if len(scale) else 0.0
        self._root = np.sqrt(np.maximum(scale, 1e-12 * middle))
        self._factor: np.ndarray | ChainFactor
        if isinstance(matrix, ChainMatrix):
            try:
                self._factor, self.usable = ChainFactor(matrix, E, self._root, damping), True
            except NotPositive:
                self.usable = False
            return
        H = restricted(matrix, E, overwrite)
        H /= self._root[:, None]
        H /= self._root
        np.einsum('ii->i', H)[:] += damping
        # of a symmetric matrix rows are columns, which saves a copy
        factor, failed = dpotrf(H.T, lower=1, overwrite_a=1, clean=0)
        self._factor = factor
        self.usable = not failed and bool(np.isfinite(np.diag(factor)).all())

    def _independent(self, values: np.ndarray) -> np.ndarray:
        """Collect values (n, ...) by the independent unknowns (k, ...)."""
        collected: np.ndarray = (self._collecting @ values if self._places is None
                                 else values[self._places])
        return collected

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for a step of all parameters; the held ones stay. Shapes (n,) or (n, m)."""
        root = self._root if right.ndim == 1 else self._root[:, None]
        wanted = self._independent(right) / root
        solved = (self._factor.solve(wanted) if isinstance(self._factor, ChainFactor)
                  else dpotrs(self._factor, wanted, lower=1)[0]) / root
        if self._places is None:
            step: np.ndarray = self._unknowns @ solved
        else:
            step = np.zeros_like(right)
            step[self._places] = solved
        return step

    def length(self, step: np.ndarray) -> float:
        """Length of a step (n,) in the scaled unknowns."""
        return float(np.linalg.norm(self._independent(step) / self._members * self._root))


def straight_step(system: ReducedSystem, factor: DampedFactor,
                  ) -> tuple[np.ndarray, np.ndarray]:
    """Return the Levenberg-Marquardt step (n,) and that of the points (P, p)."""
    step = factor.solve(-system.gradient)
    return step, system.point_steps(step)


def curved_step(system: ReducedSystem, factor: DampedFactor,
                ahead: Callable[[np.ndarray, np.ndarray], np.ndarray], reach: float = 0.1,
                ) -> tuple[np.ndarray, np.ndarray]:
    """
    Levenberg-Marquardt step with geodesic acceleration (Transtrum and Sethna 2012).

    Where the cost has a long, curved valley, a straight step leaves it. The second derivative of
    the residuals along the step gives the correction.

    Parameters
    ----------
    system : ReducedSystem
    factor : DampedFactor
    ahead : callable
        (step (n,), point_steps (P, 3)) to the weighted residuals (N, m) there.
    reach : float
        Share of the step at which the second derivative is taken.

    Returns
    -------
    step : ndarray, shape (n,)
    point_steps : ndarray, shape (P, 3)

    """
    step, points = straight_step(system, factor)
    change = (ahead(reach * step, reach * points) - system.residual) / reach
    second = 2 / reach * (change - system.predict(step, points))
    gradient, half_b = system.right_hand_side(second)
    acceleration = factor.solve(-gradient)
    # a longer correction than this means that the second-order model does not hold
    if not 2 * factor.length(acceleration) < _MAX_ACCELERATION * factor.length(step):
        return step, points
    return step + 0.5 * acceleration, points + 0.5 * system.point_steps(acceleration, half_b)
