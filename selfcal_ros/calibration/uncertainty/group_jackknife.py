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
What would the estimate be without a segment of views? A delete-a-group jackknife.

Nothing is optimised again: the optimum is linearised once, and the segment's observations are
taken out of its normal equations. One Gauss-Newton step goes to the optimum of the rest (case
deletion; Cook and Weisberg 1982, 5.2).
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from selfcal_ros.calibration.bundle.model import Linearisation
from selfcal_ros.calibration.bundle.robust_fit import bundle_of, RobustFit
from selfcal_ros.calibration.uncertainty.cluster_covariance import jackknife_excess

#: Stretches of views that are left out in turn, and the views that this needs.
SEGMENTS, MIN_VIEWS = 7, 6


def delete_a_group(fit: RobustFit) -> tuple[np.ndarray, np.ndarray]:
    """
    Estimate anew, to first order, without each of several segments of views.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.

    Returns
    -------
    shifts : ndarray, shape (G, k)
        Change of the internal parameters; G = 0 where too few views would remain.
    covariances : ndarray, shape (G, k, k)
        Of the estimates without a segment, for independent errors.

    """
    views = len(fit.state.path)
    groups = min(views, SEGMENTS) if views >= MIN_VIEWS else 0
    segment = (np.arange(views) * groups // views)[fit.observations.view]
    found = [_without(fit, segment != k) for k in range(groups)]
    shifts, covariances = zip(*filter(None, found)) if any(found) else ((), ())
    count = len(fit.state.lens)
    return (np.array(shifts).reshape(-1, count), np.array(covariances).reshape(-1, count, count))


def segment_excess(fit: RobustFit, variance_inflation: float) -> tuple[float, np.ndarray]:
    """
    Variance that errors shared by segments of views add to an optimum; see `jackknife_excess`.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    variance_inflation : float
        Variance over that with independent errors which is accounted for already.

    Returns
    -------
    ratio : float
        Of sigmas, mean over the parameters; 1 where nothing significant was found.
    ndarray, shape (k, k)
        Covariance to add.

    """
    return jackknife_excess(*delete_a_group(fit), fit.lens_covariance, variance_inflation)


def _without(fit: RobustFit, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Shift (k,) and covariance (k, k) of the estimate from some observations, or None."""
    observations = fit.observations
    rest, points = observations.select(kept)
    seen, view = np.unique(rest.view, return_inverse=True)
    if len(seen) < 3:
        return None
    rows = kept & np.isin(observations.point, points)
    every = fit.linearisation
    linearisation = Linearisation(*(getattr(every, field.name)[rows] for field in fields(every)))
    state = fit.state.of_views(seen, points)
    bundle = bundle_of(replace(rest, view=view), fit.motion.of_views(seen),
                       fit.bundle.priors, fit.bundle.sigma_px)
    system, root = bundle.weighted_equations(state, linearisation=linearisation)
    inverse = bundle.inverse(system)
    # the gradient's slope is not the weight where Huber's loss is no parabola
    _, pull = bundle.loss_factors(linearisation)
    step = -inverse @ system.gradient
    change = pull * system.predict(step, system.point_steps(step))
    # without the segment the rest is explained better; the small difference of two covariances
    # is what counts, so that the noise must be that of this estimate
    there = linearisation.residual + change / np.maximum(root, 1e-300)
    lens = bundle.unknowns.lens
    return pull * step[lens], bundle.loss_factors(linearisation, there)[0] * inverse[lens, lens]
