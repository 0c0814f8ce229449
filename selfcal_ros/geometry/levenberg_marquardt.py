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
"""Levenberg-Marquardt: the damped step, its bend, and how far the linear model is trusted."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve, LinAlgError

from selfcal_ros.geometry.optimise import ReducedSystem


class Damping:
    """
    How far Levenberg-Marquardt trusts its linear model (Nielsen 1999).

    Attributes
    ----------
    factor : float
        Of the diagonal, to be added to it.
    least : float

    """

    def __init__(self, factor: float = 1e-4, least: float = 1e-10):
        self.factor, self._least, self._growth = factor, least, 2.0

    @property
    def small(self) -> bool:
        """Whether a step that changes nothing means a minimum, and not a short step."""
        return self.factor < 1e-2

    @property
    def hopeless(self) -> bool:
        """Whether no step is short enough."""
        return self.factor > 1e8

    def succeeded(self, decrease: float, expected: float) -> None:
        """Trust the model as far as it held: the cost fell, and should have fallen."""
        gain = min(decrease / max(expected, 1e-300), 1.0)
        self.factor = max(self.factor * max(0.1, 1 - (2 * gain - 1)**3), self._least)
        self._growth = 2.0

    def failed(self) -> None:
        """Trust it less, and ever less when that does not help."""
        self.factor = max(self.factor, 1e-8) * self._growth
        self._growth *= 2


class DampedFactor:
    """
    Cholesky factor of the damped normal equations of the unknowns.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    diagonal : ndarray, shape (n,)
        Scales the parameters (pixels, radians, lengths) to one unit.
    damping : float
        Levenberg-Marquardt factor.
    unknowns : csr_array, shape (n, k)
        Of `unknowns_of`.

    Attributes
    ----------
    usable : bool
        False where the damped matrix is not positive definite.

    """

    def __init__(self, matrix, diagonal, damping, unknowns):
        self._unknowns = E = unknowns
        self._members = E.sum(axis=0)
        scale = np.maximum(E.T @ diagonal, 1e-300)
        # an unknown that nothing measures must not blow up the scaled matrix
        self._root = np.sqrt(np.maximum(scale, 1e-12 * np.median(scale)))
        H = (E.T @ (E.T @ matrix).T) / np.outer(self._root, self._root)
        H[np.diag_indices_from(H)] += damping
        try:
            self._factor = cho_factor(H)
        except (LinAlgError, ValueError):
            self._factor = None
        self.usable = self._factor is not None

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve for a step of all parameters; the held ones do not move. Shapes (n,)."""
        right = (self._unknowns.T @ right) / self._root
        return self._unknowns @ (cho_solve(self._factor, right) / self._root)

    def length(self, step: np.ndarray) -> float:
        """Length of a step (n,) in the scaled unknowns."""
        return float(np.linalg.norm(self._unknowns.T @ step / self._members * self._root))


def curved_step(system: ReducedSystem, factor: DampedFactor, ahead, reach: float = 0.1):
    """
    Levenberg-Marquardt step with geodesic acceleration (Transtrum and Sethna 2012).

    Where the valley of the cost is long and bent, the second derivative along the step follows
    the bend.

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
    step = factor.solve(-system.gradient)
    points = system.point_steps(step)
    change = (ahead(reach * step, reach * points) - system.residual) / reach
    second = 2 / reach * (change - system.predict(step, points))
    gradient, half_b = system.right_hand_side(second)
    bend = factor.solve(-gradient)
    if not 2 * factor.length(bend) < 0.75 * factor.length(step):
        return step, points
    return step + 0.5 * bend, points + 0.5 * system.point_steps(bend, half_b)
