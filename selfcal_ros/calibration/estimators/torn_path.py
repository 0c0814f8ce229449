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

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.depths import share_behind
from selfcal_ros.calibration.bundle.robust_fit import Observations, RobustFit, with_all_points
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.estimators.model_selection import first_fit
from selfcal_ros.calibration.estimators.supported_optimum import MAX_BEHIND
from selfcal_ros.calibration.estimators.zoom_selection import nearer
from selfcal_ros.calibration.initialisation.continued_path import continued_path
from selfcal_ros.calibration.initialisation.multi_start import START_TRACKS_PER_VIEW, starts
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.projective import lengths

#: Of the tracks that pass a view, a sound fit keeps half at least, and a torn one hardly any.
TORN_SHARE = 0.25
#: So many tracks pass a view, or nothing is said of it: before a fit is begun anew, where a false
#: alarm costs time alone, and before a user is told.
LEAST_TRACKS, LEAST_TOLD = 3, 12
#: A view of which less than this share is kept, of what is kept of most views, is not where it
#: should be; nor one that leaves so many times what the quarter of views leaves that leaves least.
WEAK, LOUD = 0.8, 1.3
#: A path is continued from so many stretches of sound views of each kind, the longest, of so many
#: views at least; and so many times, while that explains more.
MOST_STRETCHES, LEAST_VIEWS, ROUNDS = 3, 4, 3
#: It is another path if it rejects fewer of the observations by this share, or leaves less than
#: this share of the noise. Else it is the same, with other outliers by chance.
FEWER, LESS = 0.01, 0.97


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
    before = fit
    for start, _ in starts(problem, iter([fit.state.camera(*problem.size)])):
        state = with_all_points(start, tried)
        if state is not None:
            fit = nearer(fit, first_fit(problem, tried, state), tried)
    return fit if fit is before else continued(fit, tried, problem)


def continued(fit: RobustFit, tried: Observations, problem: SelfCalibrationProblem) -> RobustFit:
    """Continue a path from where it is sound, while that explains more; see `mended`."""
    if problem.pivot is not None or problem.flat is not None:
        return fit
    for _ in range(ROUNDS):
        before = fit
        fit = _once_continued(fit, tried, problem)
        if fit is before:
            break
    return fit


def _once_continued(fit: RobustFit, tried: Observations, problem: SelfCalibrationProblem,
                    ) -> RobustFit:
    """Continue a path from where it is sound to its weak views, if that explains more."""
    best, state, seen = fit, fit.state, problem.observations
    # as a camera of one focal length would see it
    steady = replace(problem, motion=replace(problem.motion, zoom=None), observations=replace(
        seen, xy=state.steadied(seen.xy, seen.view)))
    for first, last in sound_stretches(fit, tried):
        known = SceneState(state.lens, state.path.of_views(np.arange(first, last + 1)))
        path = continued_path(steady, known, first, START_TRACKS_PER_VIEW, exact=False)
        anew = None if path is None else with_all_points(
            replace(state, path=path.aligned(problem.motion)), tried)
        if anew is None:
            continue
        other = first_fit(problem, tried, anew)
        if (other.outliers < fit.outliers - FEWER * len(tried.view)
                or other.bundle.sigma_px < LESS * fit.bundle.sigma_px):
            best = nearer(best, other, tried)
    return best


def sound_stretches(fit: RobustFit, tried: Observations) -> list[tuple[int, int]]:
    """
    Find the stretches of successive views between those that a fit explains badly.

    Parameters
    ----------
    fit : RobustFit
    tried : Observations
        That it began with.

    Returns
    -------
    list of (int, int)
        First and last view of each, the longest stretches first: of views that keep what they
        show, and of those that leave little of it, too. None where no view is weak.

    """
    views, found = len(fit.state.path), fit.observations
    count = np.maximum(np.bincount(found.view, minlength=views), 1)
    kept = count / np.maximum(np.bincount(tried.view, minlength=views), 1)
    share = np.fmin(kept, passing_shares(tried, found, views))
    rms = np.sqrt(np.bincount(
        found.view, lengths(fit.bundle.residuals(fit.state))**2, views) / count)
    keeps = share > WEAK * np.percentile(share, 75)
    stretches: dict[tuple[int, int], None] = {}
    for sound in (keeps, keeps & (rms < LOUD * np.nanpercentile(rms, 25))):
        edges = np.flatnonzero(np.diff(np.r_[False, sound, False]))
        some = [(int(first), int(end) - 1) for first, end in zip(edges[::2], edges[1::2])
                if LEAST_VIEWS <= end - first < views]
        stretches |= dict.fromkeys(sorted(some, key=lambda one: one[0] - one[1])[:MOST_STRETCHES])
    return list(stretches)


def torn_findings(tried: Observations, kept: Observations, frames: np.ndarray,
                  ) -> tuple[Finding, ...]:
    """Tell the frames at which a path is torn all the same."""
    shares = passing_shares(tried, kept, len(frames), LEAST_TOLD)
    torn = np.flatnonzero(shares < TORN_SHARE)
    return (Finding('path_torn', frame=int(frames[torn[0]]), count=len(torn),
                    kept_percent=100 * float(shares[torn[0]])),) if len(torn) else ()
