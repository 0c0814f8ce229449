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
Second-order terms of the covariance, from the parameter-effects curvature of the model.

Where parameters trade against each other (k1 against k2, focal length against angles) the cost is
thin across a surface that is bent. The ellipsoid at the estimate is tangent to that surface, and
the truth, a sigma away along it, lies off the ellipsoid by the offset. How the Fisher information
turns along the surface says how much: its Christoffel symbols are the second derivatives of the
model in units of sigmas. They are the parameter-effects curvature of Bates and Watts (1980), and
the mean square of the offset follows in closed form.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.observability import observability_limits, UNOBSERVABLE_FACTOR
from selfcal_ros.geometry.distributions import chi2_isf

#: The offset is followed along what is determined worst: the directions whose sigma exceeds this
#: fraction of what makes a parameter unobservable. It grows with the square of the way.
CURVED_FRACTION = 0.1
#: Whether the truth lies inside an ellipsoid is decided at its surface, where the offset is larger
#: than on average: the one that holds this fraction is taken for all.
SURFACE = 0.8


def mean_square_offset(slopes: np.ndarray) -> np.ndarray:
    """
    Mean square of how far a bent model lies from its tangent, for Gaussian errors.

    A are the second derivatives of the model, in coordinates u in which the information is the
    identity. The truth, off the estimate by u of N(0, I), lies off the tangent by ½ Aₖ(u, u).

    Parameters
    ----------
    slopes : ndarray, shape (p, p, p)
        Derivative of the information along u_j, first index j; zero where it need not be known.

    Returns
    -------
    ndarray, shape (p, p)
        ½ Σ Aₖᵢⱼ Aₗᵢⱼ + ¼ Σ Aₖᵢᵢ Σ Aₗⱼⱼ.

    """
    A = 0.5 * (slopes.transpose(1, 0, 2) + slopes.transpose(1, 2, 0) - slopes)
    mean = np.einsum('kii->k', A)
    spread: np.ndarray = 0.5 * np.einsum('kij,lij->kl', A, A) + 0.25 * np.outer(mean, mean)
    return spread


def second_order_covariance(fit: RobustFit, size: tuple[int, int], scale: float = 1.0,
                            ) -> np.ndarray:
    """
    Covariance that the internal parameters have beyond first order.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    size : (int, int)
        Width and height of the image.
    scale : float
        Variance of the errors, over that which the covariance of the fit is for.

    Returns
    -------
    ndarray, shape (k, k)
        For errors of that variance. Zero where every direction is determined well, and where one
        is not determined at all.

    """
    bundle, nothing = fit.bundle, np.zeros((len(fit.state.lens),) * 2)
    free = bundle.unknowns.free_lens
    joint = scale * fit.covariance
    limits = observability_limits(fit.state.camera(*size))
    limits[fit.state.lens.places(('aspect',))] /= fit.state.lens['f']
    limits = limits[free]
    squares, vectors = np.linalg.eigh(joint[np.ix_(free, free)] / np.outer(limits, limits))
    if not (squares[0] > 0 and CURVED_FRACTION**2 < squares[-1] < UNOBSERVABLE_FACTOR**2):
        return nothing
    # columns: independent changes of the parameters, one sigma each; everything else follows
    root = limits[:, None] * vectors * np.sqrt(squares)
    ways = np.linalg.solve(root, joint[free]).T
    system = bundle.normal_equations(fit.state, linearisation=fit.linearisation)

    def information(step: np.ndarray) -> np.ndarray:
        there = bundle.moved(fit.state, step, system.point_steps(step))
        inverse = bundle.inverse(bundle.normal_equations(there))
        told: np.ndarray = root.T @ np.linalg.solve(scale * inverse[np.ix_(free, free)], root)
        return told

    slopes = np.zeros((len(free),) * 3)
    try:
        for k in np.flatnonzero(squares > CURVED_FRACTION**2):
            slopes[k] = (information(ways[:, k]) - information(-ways[:, k])) / 2
    except np.linalg.LinAlgError:
        # a sigma away there is no camera any more
        return nothing
    excess = nothing.copy()
    excess[np.ix_(free, free)] = root @ mean_square_offset(slopes) @ root.T
    p = len(free)
    # of |u|⁴ at the surface to its mean
    excess_of: np.ndarray = excess * chi2_isf(1 - SURFACE, p)**2 / (p * (p + 2))
    return excess_of
