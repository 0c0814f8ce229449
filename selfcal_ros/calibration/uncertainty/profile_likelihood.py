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
The profile likelihood of a weak parameter, whose sigma the curvature understates.

With little parallax, little turning or circular motion the optimum lies in a long, curved valley:
the cost rises so slowly along it (focal length against angles, principal point against axis) that
the quadratic at the optimum says nothing of the far end. So the worst determined parameter is
moved by some of its sigmas, and all others are optimised anew. The cost there replaces the
quadratic along the valley (profile likelihood; Venzon and Moolgavkar 1988).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.lens import to_parameters
from selfcal_ros.calibration.bundle.priors import Prior
from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.tolerances import TO_ESTIMATE
from selfcal_ros.calibration.observability import observability_limits, UNOBSERVABLE_FACTOR
from selfcal_ros.geometry.chain_inverse import ChainInverse

#: Sigmas that the parameter is moved by; the quadratic rises by half their square.
REACH = 2.0
#: The parameter determined worst is followed when its sigma exceeds this fraction of what makes it
#: unobservable.
PROFILED_FRACTION = 0.02
#: Most cameras have pixels of about this aspect ratio: whether it is as unlikely as the sigma says
#: is seen from the cost there.
USUAL_ASPECT = 1.0
#: Displacements, each farther, before the valley counts as without an end.
MAX_DISPLACEMENTS = 4
#: A fall of the cost by more than this is another optimum.
BETTER_BY = 0.05
#: Where one better optimum follows another so often, the valley has none.
MAX_OPTIMA = 6


def profile_likelihood_excess(fit: RobustFit, size: tuple[int, int], fraction: float = 1.0,
                              least: float = PROFILED_FRACTION, optima: int = MAX_OPTIMA,
                              ) -> tuple[RobustFit, np.ndarray]:
    """
    Compare the cost along the valley of a weak optimum with the quadratic.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    size : (int, int)
        Width and height of the image.
    fraction : float
        Of all observations that the fit uses; its own sigmas are larger than those of all by
        the root of it, and the valley is followed so far only.
    least : float
        Nothing is followed where every sigma is a smaller share of what makes a parameter
        unobservable. 0: not only the worst parameter is followed, but focal length and
        principal point, too.
    optima : int
        Better optima to be tried at most; beyond, the parameter counts as not determined.

    Returns
    -------
    RobustFit
        A better optimum, if there was one in the valley.
    ndarray, shape (k, k)
        Covariance to add to that of the internal parameters from all observations, for
        independent errors.

    """
    joint = fraction * fit.covariance
    lens, unknowns = fit.state.lens, fit.bundle.unknowns
    limits = observability_limits(fit.state.camera(*size))
    sigma = np.sqrt(np.diag(to_parameters(joint, lens)))
    place = int(np.argmax(sigma / limits))
    if lens.names[place] == 'aspect' and not unknowns.free[place]:
        place = 0
    nothing = np.zeros((len(lens),) * 2)
    if not least * limits[place] < sigma[place] < UNOBSERVABLE_FACTOR * limits[place]:
        return fit, nothing
    places = [place] if least else [place, *(
        other for other in lens.places(('f', 'cx', 'cy')) if other != place)]
    scale = np.outer(limits, limits)
    excess = nothing
    for place in places:
        if not joint[place, place] > 0:
            continue
        found = _beyond(fit, place, joint, fraction)
        if isinstance(found, RobustFit):
            if optima > 0:
                return profile_likelihood_excess(found, size, fraction, least, optima - 1)
            open_end = np.zeros_like(nothing)
            open_end[place, place] = (UNOBSERVABLE_FACTOR * limits[place])**2
            return found, open_end
        values, vectors = np.linalg.eigh(found / scale)
        excess = excess + scale * ((vectors * np.maximum(values, 0)) @ vectors.T)
    # what is held has no variance, not even that of rounding
    free = unknowns.free[unknowns.lens]
    return fit, excess * np.outer(free, free)


def _beyond(fit: RobustFit, place: int, joint: np.ndarray | ChainInverse,
            fraction: float) -> np.ndarray | RobustFit:
    """Covariance (k, k) along the way of one parameter, less that to first order."""
    lens = fit.state.lens
    name, inner = lens.names[place], fit.bundle.unknowns.lens
    per_sigma = joint[place] / np.sqrt(joint[place, place])
    likely = USUAL_ASPECT - lens['aspect'] if name == 'aspect' else 0.0
    sides = []
    for side in (-1, 1):
        found = _displaced(fit, name, side * per_sigma, fraction, max(side * likely, 0.0))
        if isinstance(found, RobustFit):
            return found
        sides.append(found)
    # truths and estimates lie to either side equally often: the mean square of both ways; the
    # cost rises by the curvature of Huber's loss, which is the normal matrix over the pull
    factor, pull = fit.bundle.loss_factors(fit.linearisation)
    more: np.ndarray = (factor / pull * np.einsum('si,sj->ij', sides, sides) / 2
                        - np.outer(per_sigma[inner], per_sigma[inner]))
    return more


def _displaced(fit: RobustFit, name: str, sigma: np.ndarray, fraction: float, least: float = 0.0,
               ) -> np.ndarray | RobustFit:
    """
    Move one parameter, let the rest follow, and compare the rise of the cost with a quadratic.

    Parameters
    ----------
    fit : RobustFit
    name : str
        Of the parameter, among those of the lens.
    sigma : ndarray, shape (n,)
        Change of all unknowns but the points where it moves by one sigma, to first order.
    fraction : float
    least : float
        Way of the parameter that is gone in any case.

    Returns
    -------
    ndarray, shape (k,)
        The displacement at which the cost of all observations has risen by a half; or
    RobustFit
        where the cost is lower than at the optimum.

    """
    state, step, before = fit.state, REACH * sigma, fit.cost
    unknowns = fit.bundle.unknowns
    for _ in range(MAX_DISPLACEMENTS):
        start = fit.bundle.moved(state, step)
        bundle = fit.bundle.with_priors(
            fit.bundle.priors.updated({name: Prior(start.lens[name], 0.0)}))
        moved = bundle.optimise(bundle.refine_points(start), iterations=30,
                                tolerance=TO_ESTIMATE * fraction)
        # a fact with a sigma counts, also where it is about the parameter that was moved
        rise = fit.bundle.cost(moved) - before
        if rise < -BETTER_BY:
            better = replace(fit, state=fit.bundle.optimise(moved, iterations=50,
                                                            tolerance=TO_ESTIMATE))
            if better.cost < before - BETTER_BY:
                return better
        # of one sigma: the quadratic rises with the square of the displacement
        sigmas = np.sqrt(2 * max(rise, 1e-6) / fraction)
        displacement = moved.lens.values - fit.state.lens.values
        if sigmas > 0.7 * REACH and abs(moved.lens[name] - fit.state.lens[name]) >= least:
            break
        # as far again, the displacement the valley went
        step = fit.model.step_between(fit.state, moved, unknowns, step)
        state = moved
    distance: np.ndarray = displacement / sigmas
    return distance
