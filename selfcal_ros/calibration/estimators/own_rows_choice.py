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
Do views that are far apart in time move while their rows are read, each in its own way?

What an optimum says by one linear step tells the size of the motion (`view_effects_choice`), and
the fit with that motion tells it again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.clock import STENCIL
from selfcal_ros.calibration.bundle.own_rows import OwnRows, ROW_NAMES
from selfcal_ros.calibration.bundle.robust_fit import (fit_robustly, Observations, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.bundle.shutter import FAR_APART, row_shifts, RowShifts
from selfcal_ros.calibration.estimators.shutter_choice import (by_clock, doubt_of_pace,
                                                               possible_clocks, ShutterDecision)
from selfcal_ros.calibration.estimators.view_effects_choice import (evidence_of_views,
                                                                    left_otherwise_px)
from selfcal_ros.calibration.uncertainty.suppositions import Supposition
from selfcal_ros.findings.finding import Finding

#: Least gain of log probability for which the motion is tried: odds of three to one.
LEAST_GAIN = 1.0
#: What the motion leaves is no more than this share of the noise before. Uneven ground and lenses
#: seem to move views a little, too, by 2 % at most.
CLEARLY_LESS = 0.97
#: A line delay is estimated beside the motion of single views where it is surer than this how the
#: camera moves at each: a tenth of what is enough to estimate it alone.
SURE_OF_PACE = 0.03
#: Shares of the motion between views that are tried. The interval is longer than the readout: what
#: asks for more than all of them is that the path is wrong.
SIZES = 1e-3 * 2.0**(0.5 * np.arange(17))
#: Rounds in which the size settles, and the change of its log that ends them.
ROUNDS, SETTLED = 2, 0.2


def with_own_rows(decision: ShutterDecision, observations: Observations,
                  size: tuple[int, int]) -> ShutterDecision:
    """
    Let each view move by itself while it is read, if the images ask for that.

    Parameters
    ----------
    decision : ShutterDecision
        With one line delay, or none.
    observations : Observations
        All that it was to explain, its outliers included.
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    ShutterDecision
        As it was where views do not move by themselves, or their neighbours tell how.

    """
    fit, clock = decision.fit, decision.fit.observations.clock
    if clock is None or fit.observations.neighbours is not None:
        return decision
    read = ([fit] if fit.observations.shutter is not None
            else [by_clock(fit, one) for one in possible_clocks(clock, size)])
    evidence = [own_motion_evidence(one, size) for one in read]
    best = int(np.argmax([gain for _, gain in evidence]))
    fit, (sigma, gain) = read[best], evidence[best]
    if gain <= LEAST_GAIN:
        return decision
    sigmas = float(np.sqrt(2 * gain))
    left_px = left_otherwise_px(fit, tuple(clock.times.tolist()), gain)
    found = None
    for _ in range(ROUNDS):
        moving = _moving(fit, observations, sigma)
        if moving is None or (found is not None and moving.bundle.sigma_px > fit.bundle.sigma_px):
            break
        found, fit, before = sigma, moving, sigma
        sigma = _size_after(fit)
        if abs(np.log(sigma / before)) < SETTLED:
            break
    # with the size that the fit found: that of the linear step may be an eighth of it
    if found is None or sigma >= SIZES[-1] or fit.bundle.sigma_px > CLEARLY_LESS * left_px:
        return decision
    return ShutterDecision(fit, (Finding('rows_by_view', share=found, sigmas=sigmas),))


def own_motion_evidence(fit: RobustFit, size: tuple[int, int]) -> tuple[float, float]:
    """
    Tell how far views move by themselves while they are read, and how sure that is.

    Parameters
    ----------
    fit : RobustFit
        At its optimum, without such motion.
    size : (int, int)
        Width and height of the image.

    Returns
    -------
    sigma : float
        Of `OwnRows`.
    gain : float
        Log of the probability over that without such motion, were the errors independent. What
        moves views makes those of neighbours in an image alike, so that is no argument against it.

    """
    bundle, clock, shutter = fit.bundle, fit.observations.clock, fit.observations.shutter
    assert clock is not None
    before = np.zeros_like(bundle.xy) if shutter is None else shutter.at(fit.state, bundle.view)
    shifts = row_shifts(fit.state, bundle.blocks, bundle.xy, clock,
                        own=OwnRows.supposed(1.0, STENCIL), before=before)
    assert shifts.own is not None
    return evidence_of_views(fit, size, Supposition(
        'rows', ROW_NAMES, shifts.own.slope, of_views=True), SIZES)


def _moving(fit: RobustFit, observations: Observations, sigma: float) -> RobustFit | None:
    """Fit with motion of each view of this size; what was an outlier without need not be one."""
    clock, shutter = fit.observations.clock, fit.observations.shutter
    assert clock is not None
    near = STENCIL
    if shutter is None or doubt_of_pace(fit) > SURE_OF_PACE:
        # the views are too far apart to tell more than how the camera moves on the whole
        shutter, near = RowShifts.none(len(fit.bundle.xy), clock.known), FAR_APART
    offered = replace(observations, clock=clock).read_like(
        replace(shutter, own=OwnRows.supposed(sigma, near)))
    state = with_all_points(fit.state, offered)
    if state is None:
        return None
    return fit_robustly(offered, state, fit.motion, fit.bundle.priors, fit.bundle.sigma_px)


def _size_after(fit: RobustFit) -> float:
    """Return the most probable size of the motion that a fit has found (MacKay 1992)."""
    shutter, motion = fit.observations.shutter, fit.state.row_motion
    assert shutter is not None and shutter.own is not None and motion is not None
    found = shutter.own.effects.size_after(motion, fit.covariance, fit.bundle.unknowns)
    return float(np.clip(found, SIZES[0], SIZES[-1]))
