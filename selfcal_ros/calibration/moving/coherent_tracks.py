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
The half of the tracks that one still scene explains best: least trimmed squares over tracks.

A moving thing pulls the whole path where its tracks are many, or the longest. Then it is the
still tracks that look like outliers, and tests of single tracks start from a wrong estimate. Half
of the tracks do without the moving thing. Concentration steps find them: fit a half, keep the
half that fits best, and again (P. J. Rousseeuw and K. Van Driessen 2006, Computing LTS Regression
for Large Data Sets, section 3). Whole tracks are kept or left: a single observation often agrees
by chance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.bundle import Bundle
from selfcal_ros.calibration.bundle.motion import MotionModel
from selfcal_ros.calibration.bundle.priors import Priors
from selfcal_ros.calibration.bundle.robust_fit import (bundle_of, fit_robustly, Observations,
                                                       OUTLIER_SIGMAS, RobustFit, with_all_points)
from selfcal_ros.calibration.bundle.state import SceneState
from selfcal_ros.calibration.bundle.tolerances import TO_GO_ON
from selfcal_ros.calibration.moving.track_judgement import freedom_of, judge_tracks
from selfcal_ros.geometry.distributions import chi2_isf

#: Steps at most, and the share of the tracks that changes where they end.
STEPS, SETTLED = 24, 0.01
#: Tracks that a view keeps, whatever its tracks are worth.
LEAST_OF_VIEW = 10
#: The scale falls by this factor in a step, or to so many times the noise of the half.
FALL, ABOVE = 1.5, 3.0


def coherent_half(observations: Observations, state: SceneState, motion: MotionModel,
                  priors: Priors, sigma_px: float, noise_px: float) -> RobustFit | None:
    """
    Fit the half of the tracks that one still scene explains best, from where a state stands.

    Parameters
    ----------
    observations : Observations
    state : SceneState
        Its poses and lens are the start, its points do not matter.
    motion : MotionModel
    priors : Priors
    sigma_px : float
        Scale to begin with: the farther the state may be from the truth, the larger.
    noise_px : float
        Of an image coordinate, as pairs of views tell; the scale does not fall below it.

    Returns
    -------
    RobustFit
        Of the half. Its noise is that of the median of all tracks.
        None where the half leaves views out, or the lens folds.

    """
    before = np.zeros(len(observations.track), bool)
    for _ in range(STEPS):
        half = _best_half(observations, state, motion, priors, sigma_px)
        if half is None:
            return None
        rest, points = observations.select(half[observations.point])
        placed = with_all_points(state, rest)
        if placed is None or len(np.unique(rest.view)) < len(state.path):
            return None
        bundle = bundle_of(rest, motion, priors, sigma_px)
        state = bundle.optimise(bundle.refine_points(placed), iterations=4, tolerance=TO_GO_ON)
        left_px = bundle.noise_sigma(state)
        if not np.isfinite(left_px):
            return None
        is_fine = sigma_px == noise_px
        sigma_px = max(min(sigma_px / FALL, ABOVE * left_px), noise_px)
        if is_fine and np.mean(half != before) < SETTLED:
            break
        before = half
    fit = fit_robustly(rest, state, motion, priors, noise_px)
    return _of_all(fit, observations)


def _best_half(observations: Observations, state: SceneState, motion: MotionModel,
               priors: Priors, sigma_px: float) -> np.ndarray | None:
    """Mark the tracks (P,) that leave the least for their length, and the best few of a view."""
    left = _left(observations, state, bundle_of(observations, motion, priors, sigma_px))
    if left is None:
        return None
    half = left <= np.median(left[np.isfinite(left)])
    order = np.lexsort((left[observations.point], observations.view))
    ordered = observations.view[order]
    rank = np.arange(len(order)) - np.searchsorted(ordered, ordered)
    half[observations.point[order[rank < LEAST_OF_VIEW]]] = True
    coherent: np.ndarray = half & np.isfinite(left)
    return coherent


def _of_all(fit: RobustFit, observations: Observations) -> RobustFit | None:
    """Let the noise of a half be that of the median of all tracks."""
    left = _left(observations, fit.state, fit.bundle)
    if left is None:
        return None
    scale = np.sqrt(max(1.0, float(np.median(left[np.isfinite(left)]))))
    return replace(fit, bundle=fit.bundle.with_sigma(fit.bundle.sigma_px * scale))


def _left(observations: Observations, state: SceneState, bundle: Bundle[SceneState],
          ) -> np.ndarray | None:
    """Squares (P,) that tracks leave, over the median of chance; infinite for short ones."""
    test = judge_tracks(bundle, state, observations)
    if test is None or not test.tested.any():
        return None
    square = test.square + OUTLIER_SIGMAS**2 * test.lost
    usual = chi2_isf(0.5, np.maximum(freedom_of(test.length), 1))
    return np.where(test.tested, square / usual, np.inf)
