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
Few wrong tracks of high leverage, which pull the estimate until they agree with it.

Short tracks of a moving thing, all in the same few views, pull the poses of these views and the
lens. Then their residuals are no larger than the noise, and those of still points near them grow
a little: no test of residuals at this optimum shows the cause (masking and swamping; A. S. Hadi
and J. S. Simonoff 1993, Procedures for the Identification of Multiple Outliers in Linear Models).
It is visible from an optimum without them, as that of the most coherent half.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import refit, RobustFit
from selfcal_ros.calibration.estimators.coherent_start import coherent_fit
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.moving.sorting import drifts
from selfcal_ros.calibration.moving.track_judgement import judge_tracks
from selfcal_ros.calibration.result import Calibration

#: What tells that something shares its errors, and may bend the estimate.
SHARED_ERRORS = ('errors_within_track', 'errors_within_segment')
#: Tracks that others contradict bend an estimate which moves by more of its sigmas without them.
#: Without the few that chance contradicts, independent worlds of still points moved by 0.6.
MOVED = 1.0


def may_be_bent(result: Calibration) -> bool:
    """Tell whether errors that are not independent leave room for tracks that bend a result."""
    return any(one.kind in SHARED_ERRORS for one in result.findings)


def unbent_fit(fit: RobustFit, problem: SelfCalibrationProblem, sigma: dict[str, float],
               per_view: int) -> RobustFit | None:
    """
    Fit without the tracks that the most coherent half contradicts, if that is another estimate.

    Parameters
    ----------
    fit : RobustFit
        Of all views and tracks.
    problem : SelfCalibrationProblem
        That it solves.
    sigma : dict of str to float
        Stated for fx, cx and cy.
    per_view : int
        Tracks of a view, the longest first, that the half is sought among.

    Returns
    -------
    RobustFit or None
        None where the estimate stays where it is, and where patches drift: there still tracks
        contradict one another, too.

    """
    if fit.motion.zoom is not None or fit.observations.shutter is not None:
        return None
    test = judge_tracks(fit.bundle, fit.state, fit.observations)
    if test is None or drifts(test):
        return None
    half = coherent_fit(problem, per_view, [fit.state.camera(*problem.size)])
    if half is None or len(half.state.path) != len(fit.state.path):
        return None
    test = judge_tracks(half.bundle, half.state, fit.observations)
    if test is None:
        return None
    still = np.where(test.tested, test.explained, test.lost == 0)
    rest, points = fit.observations.select(still[fit.observations.point])
    if still.all() or len(np.unique(rest.view)) < len(fit.state.path):
        return None
    state = replace(fit.state, points=fit.state.points[points])
    without = refit(replace(fit, observations=rest, state=state), fit.motion)
    moved = [abs(without.state.lens[name] - fit.state.lens[name]) / sigma[of]
             for name, of in (('f', 'fx'), ('cx', 'cx'), ('cy', 'cy')) if sigma[of] > 0]
    if max(moved, default=0.0) <= MOVED:
        return None
    return replace(without, bundle=without.bundle.with_sigma(
        without.bundle.noise_rms(without.state)))
