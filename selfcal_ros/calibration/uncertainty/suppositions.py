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
What the estimate supposes, tested at its optimum: the score test.

A supposition is a few further unknowns θ that the estimate takes to be zero: how far a stated
aspect ratio is off, the line delay of the shutter, the growth of the focal length. Their
derivatives of every observation are all that is needed. With points, path and lens eliminated,
the normal equations leave J θ = -u, and

    θ = -J⁻¹ u,   cov θ = J⁻¹,   χ² = uᵀ J⁻¹ u   with as many degrees of freedom as θ has

(Rao 1948; one Gauss-Newton step of the estimate that does not suppose it). Nothing is fitted
anew. Many suppositions share one elimination.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import block_diag, csr_array, identity

from selfcal_ros.calibration.bundle.information import eliminated
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.uncertainty.joint_equations import joint_equations
from selfcal_ros.geometry.distributions import chi2_sf, normal_isf
from selfcal_ros.geometry.selection_matrix import embedded_selection

#: Directions of which the elimination leaves less than this share are what the estimate has
#: already, and cannot be tested.
INDEPENDENT = 1e-8
#: Unknowns that have more than this part in such a direction may be anything.
OPEN_PART = 1e-3
#: Smallest probability that a number can hold.
_TINY = 1e-300


@dataclass(frozen=True)
class Supposition:
    """
    Further unknowns that the estimate takes to be zero.

    Attributes
    ----------
    name : str
        What is supposed, as a sentence names it.
    unknowns : tuple of str
        Names of the further unknowns; of those of the lens block, what the stated values may be
        off by.
    columns : ndarray, shape (N, 2, m)
        Derivative of every residual of the fit by them, pixels.
    of_views : bool
        Whether every view has unknowns of its own, m each.

    """

    name: str
    unknowns: tuple[str, ...]
    columns: np.ndarray
    of_views: bool = False


@dataclass(frozen=True)
class Tested:
    """
    What one step says of further unknowns.

    Attributes
    ----------
    name : str
    unknowns : tuple of str
    value : ndarray, shape (m,)
        Of the further unknowns: how far off the supposition is.
    covariance : ndarray, shape (m, m)
        Infinite on the diagonal where the images say nothing.
    response : ndarray, shape (k, m)
        How the unknowns of the lens follow them.
    chi2 : float
    freedom : int

    """

    name: str
    unknowns: tuple[str, ...]
    value: np.ndarray
    covariance: np.ndarray
    response: np.ndarray
    chi2: float
    freedom: int

    @property
    def shift(self) -> np.ndarray:
        """How the unknowns of the lens would move, shape (k,)."""
        moved: np.ndarray = self.response @ self.value
        return moved

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviations of the further unknowns, shape (m,)."""
        sigma: np.ndarray = np.sqrt(np.maximum(np.diag(self.covariance), 0))
        return sigma

    @property
    def p_value(self) -> float:
        """Probability of such a chi-square where the supposition holds."""
        return float(chi2_sf(self.chi2, self.freedom)) if self.freedom else 1.0

    @property
    def sigmas(self) -> float:
        """The same as the sigmas of a Gaussian that are exceeded as rarely."""
        p = self.p_value
        # far out the root of the chi-square is as good, and still has digits
        return (float(normal_isf(p / 2)) if p > _TINY
                else float(np.sqrt(max(self.chi2 - self.freedom, 0))))

    @property
    def information(self) -> np.ndarray:
        """What the images tell of the further unknowns, shape (m, m)."""
        told = np.isfinite(np.diag(self.covariance))
        information = np.zeros_like(self.covariance)
        information[np.ix_(told, told)] = np.linalg.pinv(self.covariance[np.ix_(told, told)],
                                                         hermitian=True)
        return information

    def with_prior(self, variance: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the further unknowns where each has a variance beforehand, about zero.

        Parameters
        ----------
        variance : float, or ndarray of shape (m,)

        Returns
        -------
        value : ndarray, shape (m,)
        covariance : ndarray, shape (m, m)

        """
        information = self.information
        covariance = np.linalg.inv(information + np.diag(1 / np.full(len(information), variance)))
        return covariance @ information @ self.value, covariance

    def about_zero(self, variance: float | np.ndarray) -> np.ndarray:
        """Return the second moments (m, m) of what `with_prior` finds: how far from zero it is."""
        found, after = self.with_prior(variance)
        moments: np.ndarray = after + np.outer(found, found)
        return moments


def free_response(fit: RobustFit, tested: Tested) -> np.ndarray:
    """Return how the unknowns of the lens follow further ones, (k, m); those held stay."""
    unknowns = fit.bundle.unknowns
    response: np.ndarray = tested.response * unknowns.free[unknowns.lens][:, None]
    return response


def added_covariance(fit: RobustFit, tested: Tested, variance: float | np.ndarray) -> np.ndarray:
    """
    Return what further unknowns that an estimate lacks may do to the unknowns of its lens.

    Parameters
    ----------
    fit : RobustFit
    tested : Tested
    variance : float, or ndarray of shape (m,)
        Of the further unknowns beforehand, about zero.

    Returns
    -------
    ndarray, shape (k, k)
        To add to the covariance of the unknowns of the lens.

    """
    response = free_response(fit, tested)
    covariance: np.ndarray = response @ tested.about_zero(variance) @ response.T
    return covariance


def likely_size(value: np.ndarray, information: np.ndarray, sizes: np.ndarray,
                further: np.ndarray | float = 0.0) -> float:
    """
    Return the standard deviation of unknowns that their estimate suggests.

    The root mean square over sizes that are as likely beforehand, each weighed by how probable it
    makes the estimate: where the images say little it stays large.

    Parameters
    ----------
    value : ndarray, shape (m,)
        The estimate, of unknowns about zero.
    information : ndarray, shape (m, m)
        Of the images; it may be singular.
    sizes : ndarray, shape (n,)
    further : ndarray, shape (n,), optional
        What else makes a size likely, as a logarithm.

    Returns
    -------
    float

    """
    told, vectors = np.linalg.eigh(information)
    told = np.maximum(told, 0)[:, None]
    ratio = 1 + told * sizes**2
    square = told * ((vectors.T @ value)**2)[:, None]
    log_probability = -0.5 * np.sum(square / ratio + np.log(ratio), axis=0) + further
    weight = np.exp(log_probability - log_probability.max())
    return float(np.sqrt(weight @ sizes**2 / weight.sum()))


@dataclass(frozen=True)
class JointInformation:
    """
    What the images say of all further unknowns at once, everything else eliminated.

    Attributes
    ----------
    suppositions : tuple of Supposition
    score : ndarray, shape (M,)
        Gradient of the cost by the further unknowns.
    information : ndarray, shape (M, M)
    raw : ndarray, shape (M,)
        Diagonal of the information before anything was eliminated.
    lens : ndarray, shape (k, M)
        How the unknowns of the lens follow each of them.
    places : dict of str to ndarray
        Where the unknowns of each supposition stand: shape (m,), or (views, m).
    factor, pull : float
        Of Huber's loss; see `huber_factors`.

    """

    suppositions: tuple[Supposition, ...]
    score: np.ndarray
    information: np.ndarray
    raw: np.ndarray
    lens: np.ndarray
    places: dict[str, np.ndarray]
    factor: float
    pull: float

    def test(self, name: str) -> Tested:
        """Test a supposition whose unknowns all views share."""
        one = next(one for one in self.suppositions if one.name == name)
        basis = np.zeros((len(self.score), len(one.unknowns)))
        basis[self.places[name], np.arange(len(one.unknowns))] = 1
        return self.test_along(basis, name, one.unknowns)

    def test_along(self, basis: np.ndarray, name: str, unknowns: tuple[str, ...]) -> Tested:
        """
        Test some directions of the further unknowns, the others held at zero.

        Parameters
        ----------
        basis : ndarray, shape (M, m)
        name : str
        unknowns : tuple of str
            A name for each direction.

        Returns
        -------
        Tested

        """
        return self.test_of(basis.T @ self.information @ basis, basis.T @ self.score,
                            np.einsum('ij,i,ij->j', basis, self.raw, basis), self.lens @ basis,
                            name, unknowns)

    def test_of(self, J: np.ndarray, u: np.ndarray, raw: np.ndarray, response: np.ndarray,
                name: str, unknowns: tuple[str, ...]) -> Tested:
        """
        Test directions of which these are known.

        Parameters
        ----------
        J : ndarray, shape (m, m)
            Information.
        u : ndarray, shape (m,)
            Gradient of the cost.
        raw : ndarray, shape (m,)
            Diagonal of the information before anything was eliminated.
        response : ndarray, shape (k, m)
            How the unknowns of the lens follow.
        name : str
        unknowns : tuple of str

        Returns
        -------
        Tested

        """
        scale = np.sqrt(np.maximum(raw, _TINY))
        values, vectors = np.linalg.eigh(J / np.outer(scale, scale))
        kept = values > INDEPENDENT
        root = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
        inverse = root @ root.T
        theta = -self.pull * inverse @ u
        total = float(np.sum((root.T @ u)**2)) * self.pull**2 / self.factor
        covariance = self.factor * inverse
        # what the estimate has already tells nothing: no value is excluded
        anything = (np.abs(vectors[:, ~kept]) > OPEN_PART).any(axis=1)
        covariance[anything, anything] = np.inf
        return Tested(name, unknowns, theta, covariance, response, total, int(kept.sum()))


def joint_information(fit: RobustFit, suppositions: Sequence[Supposition],
                      variance_inflation: float = 1.0, nuisance: np.ndarray | None = None,
                      nuisance_sigma: float | np.ndarray = 1.0,
                      ) -> JointInformation:
    """
    Eliminate all that the estimate knows from the further unknowns of suppositions.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    suppositions : sequence of Supposition
    variance_inflation : float
        Variance of the estimate over that with independent errors, which the covariance of
        the camera allows for, too.
    nuisance : ndarray, shape (N, 2, q), optional
        Derivatives by unknowns that are eliminated with the rest, as those of a smooth field.
    nuisance_sigma : float, or ndarray of shape (q,)
        Their standard deviation.

    Returns
    -------
    JointInformation

    """
    common = [one for one in suppositions if not one.of_views]
    own = [one for one in suppositions if one.of_views]
    if nuisance is None:
        nuisance = np.zeros((len(fit.bundle.view), 2, 0))
    joint = joint_equations(fit, [nuisance, *(one.columns for one in common)],
                            [one.columns for one in own], variance_inflation)
    system, unknowns = joint.system, fit.bundle.unknowns
    aside, shared = np.split(joint.shared, [nuisance.shape[2]])
    system.add_diagonal(aside, np.broadcast_to(1 / np.square(nuisance_sigma), aside.shape))

    places = {one.name: where for one, where in zip(common, _parts(shared, common))}
    places.update((one.name, where) for one, where in zip(own, _parts(joint.of_views, own)))
    further = np.concatenate([where.ravel() for where in places.values()])
    number = np.zeros(len(system.matrix), int)
    number[further] = np.arange(len(further))

    rest = np.r_[joint.place, aside]
    selection = csr_array(block_diag([unknowns.selection, identity(len(aside))]))
    selection = embedded_selection(selection, rest, len(system.matrix))
    coupling = system.columns(further)
    follows = -eliminated(system.matrix, selection, coupling, system.diagonal, overwrite=True)
    information = coupling[further] + coupling.T @ follows
    factor, pull = fit.bundle.loss_factors(fit.linearisation)
    return JointInformation(
        tuple(suppositions), system.gradient[further] + follows.T @ system.gradient,
        (information + information.T) / 2, system.diagonal[further],
        follows[unknowns.lens], {name: number[where] for name, where in places.items()},
        factor, pull)


def _parts(places: np.ndarray, suppositions: Sequence[Supposition]) -> list[np.ndarray]:
    """Part places, (m,) or (V, m), among suppositions that follow each other."""
    ends = np.cumsum([one.columns.shape[2] for one in suppositions], dtype=int)
    return np.split(places, ends, axis=-1)
