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
A path in parts of different scale (scale drift): how it is found, and how it is repaired.

A start under a wrong focal length drifts in scale along the path. A robust adjustment may mend
the parts and not the drift between them: then nearly all tracks that pass a view are rejected as
outliers. Where scale drifts through zero, a part is inside out: its points lie behind its views.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.depths import share_behind
from selfcal_ros.calibration.bundle.robust_fit import Observations, RobustFit, with_all_points
from selfcal_ros.calibration.estimators.model_selection import first_fit
from selfcal_ros.calibration.estimators.supported_optimum import MAX_BEHIND
from selfcal_ros.calibration.estimators.zoom_selection import nearer
from selfcal_ros.calibration.initialisation.multi_start import starts
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.findings.finding import Finding

#: Of the tracks that pass a view, a sound fit keeps half at least, and a torn one hardly any.
TORN_SHARE = 0.25
#: So many tracks pass a view, or nothing is said of it: before a fit is begun anew, where a false
#: alarm costs time alone, and before a user is told.
LEAST_TRACKS, LEAST_TOLD = 3, 12


def passing_shares(tried: Observations, kept: Observations, views: int,
                   least: int = LEAST_TRACKS) -> np.ndarray:
    """
    Tell how many of the tracks that pass each view a fit has kept on both sides of it.

    Parameters
    ----------
    tried, kept : Observations
        What a fit began with, and what it did not set aside.
    views : int
    least : int
        Of the tracks that pass a view.

    Returns
    -------
    ndarray, shape (views,)
        Shares; NaN at both ends, and where too few pass.

    """
    tracks = np.union1d(tried.track, kept.track)
    passing = []
    for observations in (tried, kept):
        first, last = np.full(len(tracks), views), np.full(len(tracks), -1)
        place = np.searchsorted(tracks, observations.track)[observations.point]
        np.minimum.at(first, place, observations.view)
        np.maximum.at(last, place, observations.view)
        at = np.arange(views)[:, None]
        passing.append((first < at) & (last > at))
    before, after = passing[0].sum(axis=1), (passing[0] & passing[1]).sum(axis=1)
    enough = before >= least
    return np.where(enough, after / np.maximum(before, 1), np.nan)


def is_torn(tried: Observations, kept: Observations, views: int) -> bool:
    """Tell whether at some view a fit has set nearly all tracks aside that pass it."""
    return bool((passing_shares(tried, kept, views) < TORN_SHARE).any())


def mended(fit: RobustFit, tried: Observations, problem: SelfCalibrationProblem) -> RobustFit:
    """
    Return a fit whose path holds together, where there is one.

    Parameters
    ----------
    fit : RobustFit
    tried : Observations
        That it began with.
    problem : SelfCalibrationProblem
        Of the same views.

    Returns
    -------
    RobustFit
        Begun anew with the calibration that was found, if `fit` is torn or has points behind its
        views, and that explains more.

    """
    inside_out = problem.pivot is None and share_behind(fit) > MAX_BEHIND
    if not inside_out and not is_torn(tried, fit.observations, problem.views):
        return fit
    for start, _ in starts(problem, iter([fit.state.camera(*problem.size)])):
        state = with_all_points(start, tried)
        if state is not None:
            fit = nearer(fit, first_fit(problem, tried, state), tried)
    return fit


def torn_findings(tried: Observations, kept: Observations, frames: np.ndarray,
                  ) -> tuple[Finding, ...]:
    """Tell the frames at which a path is torn all the same."""
    shares = passing_shares(tried, kept, len(frames), LEAST_TOLD)
    torn = np.flatnonzero(shares < TORN_SHARE)
    return (Finding('path_torn', frame=int(frames[torn[0]]), count=len(torn),
                    kept_percent=100 * float(shares[torn[0]])),) if len(torn) else ()
