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
How planar a motion is: exactly, or out of its plane by sigmas that the images tell.

A vehicle keeps to its ground but for tilt and height of its views, which are small and soft. They
cost freedom, which few views hardly have, so they are held where the images do not need them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.motion import PLANAR
from selfcal_ros.calibration.bundle.robust_fit import fit_robustly, is_chance, refit, RobustFit
from selfcal_ros.geometry.chain_inverse import ChainInverse
from selfcal_ros.geometry.scaled_inverse import squared_distance

#: Of fewer views a gross error in a short track looks like a way out of the plane; no more than
#: this share of the observations may be such.
FEW_VIEWS, FEW_GROSS = 16, 0.025
#: An exact plane is not fitted where the linear model has it cost more than so many times what
#: chance does. Huber's loss of few observations that alone contradict it grows less than that.
HOPELESS = 10.0
#: Floor of the out-of-plane sigmas that are estimated from the data.
MINIMUM_TILT_RAD, MINIMUM_HEIGHT = 1e-5, 1e-5


def out_of_plane(fit: RobustFit) -> tuple[float, float]:
    """
    Estimate the standard deviations of tilt (rad) and height (per distance between views).

    Empirical Bayes: the mean of the squared estimates and of their variances.
    """
    path, unknowns, variance = fit.state.path, fit.bundle.unknowns, fit.covariance.diagonal()
    tilt = np.sqrt(np.mean(path.tilt**2 + variance[unknowns.of_views('tilt_x', 'tilt_y')]))
    of_height = variance[unknowns.of_views('height')[1:, 0]]
    height = np.sqrt(np.mean(path.translation[1:, 2]**2 + of_height))
    return (max(float(tilt), MINIMUM_TILT_RAD),
            max(float(height) / path.step_length(), MINIMUM_HEIGHT))


def choose_motion(relaxed: RobustFit, variance_inflation: float = 1.0) -> tuple[RobustFit, bool]:
    """
    Decide whether the plane of motion is exact.

    It is when its cost exceeds that of the relaxed motion by no more than the additional
    freedom explains (a likelihood ratio test at 4 sigma). With few views it is, too, when that
    holds but for few observations. Otherwise the out-of-plane sigmas are estimated from the data.

    Parameters
    ----------
    relaxed : RobustFit
        Of nearly planar motion.
    variance_inflation : float
        Variance of the estimate over that with independent errors; the excess is divided by it.

    Returns
    -------
    fit : RobustFit
    exact : bool

    """
    if not relaxed.motion.tilt_sigma_rad:
        # decided before, on other tracks of the same recording
        return relaxed, True
    flat = replace(relaxed.state, path=relaxed.state.path.flat())
    freedom = 3 * len(flat.path) - 1
    few = len(flat.path) < FEW_VIEWS
    if few or is_chance(_supposed_excess(relaxed) / (HOPELESS * variance_inflation), freedom):
        exact = refit(relaxed, PLANAR.with_images_of(relaxed.motion), flat)
        excess = 2 * (exact.cost - relaxed.cost) / variance_inflation
        if is_chance(excess, freedom):
            return exact, True
        sound = _but_for_few(relaxed, exact, freedom, variance_inflation) if few else None
        if sound is not None:
            return sound, True
    fit = relaxed
    for _ in range(3):
        before = fit.motion
        tilt, height = out_of_plane(fit)
        fit = refit(fit, replace(before, tilt_sigma_rad=tilt, height_sigma=height))
        if abs(tilt / before.tilt_sigma_rad - 1) < 0.2:
            break
    return fit, False


def _supposed_excess(relaxed: RobustFit) -> float:
    """Return twice what an exact plane costs by the linear model of the relaxed motion."""
    path, unknowns, covariance = relaxed.state.path, relaxed.bundle.unknowns, relaxed.covariance
    if isinstance(covariance, ChainInverse):
        return 0.0
    places = np.r_[unknowns.of_views('tilt_x', 'tilt_y').ravel(),
                   unknowns.of_views('height')[1:, 0]]
    out_of_it = np.r_[path.tilt.ravel(), path.translation[1:, 2]]
    free = covariance[places, places] > 0
    places, out_of_it = places[free], out_of_it[free]
    return squared_distance(out_of_it, covariance[np.ix_(places, places)])


def _but_for_few(relaxed: RobustFit, exact: RobustFit, freedom: float, variance_inflation: float,
                 ) -> RobustFit | None:
    """Return a fit whose plane is exact but for few observations, if there is one."""
    sound = fit_robustly(relaxed.observations, exact.state, exact.motion, relaxed.bundle.priors,
                         relaxed.bundle.sigma_px)
    kept, before = sound.observations, relaxed.observations
    if len(kept.view) < (1 - FEW_GROSS) * len(before.view):
        return None
    points = np.searchsorted(before.track, kept.track)
    start = replace(relaxed.state, points=relaxed.state.points[points])
    free = refit(sound, relaxed.motion, start)
    excess = 2 * (sound.cost - free.cost) / variance_inflation
    sound = replace(sound, outliers=relaxed.outliers + len(before.view) - len(kept.view))
    return sound if is_chance(excess, freedom) else None
