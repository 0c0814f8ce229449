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
Small unknowns that every view has of its own, Gaussian about a mean that is as uncertain.

How far the camera moved while the rows of an image were read; how far an image was shifted. Their
size follows from the images. Of one more view they would be off by as much, and their mean is
what all images share: so is the uncertainty of what it is mixed up with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.unknowns import PriorTerms, Unknowns
from selfcal_ros.geometry.chain_inverse import ChainInverse


@dataclass(frozen=True)
class ViewEffects:
    """
    What is supposed of unknowns that every view has of its own.

    Attributes
    ----------
    names : tuple of str
        Of the unknowns of a view, m of them.
    sigma : float
        Standard deviation about their mean over the views, and of that mean, in their unit.

    """

    names: tuple[str, ...]
    sigma: float

    def extend(self, unknowns: Unknowns) -> Unknowns:
        """Add the unknowns to those that there are."""
        return unknowns.extended(of_view=self.names)

    def count(self, views: int) -> int:
        """Count the measurements that `add_prior` stands for."""
        return len(self.names) * views

    def moved(self, values: np.ndarray | None, step: np.ndarray, unknowns: Unknowns) -> np.ndarray:
        """Return values (V, m) after a step (n,) of all unknowns; None is zero."""
        more: np.ndarray = step[unknowns.of_views(*self.names)]
        return more if values is None else values + more

    def set_step(self, step: np.ndarray, unknowns: Unknowns, there: np.ndarray | None,
                 here: np.ndarray | None) -> None:
        """Write into a step (n,) of all unknowns how values change from here to there."""
        if there is not None:
            step[unknowns.of_views(*self.names)] = there - (0 if here is None else here)

    def add_prior(self, terms: PriorTerms, values: np.ndarray | None,
                  unknowns: Unknowns) -> PriorTerms:
        """Add what is supposed of values (V, m) to cost, gradient (n,) and diagonal (n,)."""
        cost, gradient, diagonal = terms
        places, matrix = unknowns.of_views(*self.names), self.information(unknowns.views)
        diagonal[places] += matrix[0, 0]
        if values is not None:
            own = values[:unknowns.views]
            slope = matrix @ own
            cost += 0.5 * float(np.sum(own * slope))
            gradient[places] += slope
        return cost, gradient, diagonal

    def information(self, views: int) -> np.ndarray:
        """Return what is supposed of one unknown of every view: inverse covariance (V, V)."""
        return without_mean(views) / self.sigma**2

    def couplings(self, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray]:
        """Return what that adds beside the diagonal: places (k,), and matrix (k, k)."""
        matrix = self.information(unknowns.views)
        beside = np.kron(matrix - np.diag(np.diag(matrix)), np.eye(len(self.names)))
        return unknowns.of_views(*self.names).ravel(), beside

    def size_after(self, values: np.ndarray, covariance: np.ndarray | ChainInverse,
                   unknowns: Unknowns) -> float:
        """
        Return the most probable size of what an optimum has found (MacKay 1992).

        Parameters
        ----------
        values : ndarray, shape (V, m)
        covariance : ndarray, shape (n, n), or ChainInverse
            Of all unknowns.
        unknowns : Unknowns

        Returns
        -------
        float
            For `sigma`.

        """
        places, apart = unknowns.of_views(*self.names).ravel(), without_mean(len(values))
        every = np.kron(apart, np.eye(len(self.names)))
        left = float(np.sum(every * covariance[np.ix_(places, places)])) / self.sigma**2
        measured = max(len(places) - left, 1.0)
        return float(np.sqrt(np.sum(values * (apart @ values)) / measured))


def without_mean(views: int) -> np.ndarray:
    """Return the inverse (V, V) of the covariance of values about a mean that is as uncertain."""
    inverse: np.ndarray = np.eye(views) - 1 / (1 + views)
    return inverse
