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
Is every image shifted by itself, as by a stabiliser?

A shift looks like a small turn, but for perspective: that makes a turn of the camera displace the
rim of an image by more than its middle. So wide images tell how far each was shifted, and a few
pixels of it are the largest of errors where they are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.image_shift import by_shift, SHIFT_NAMES, shifts
from selfcal_ros.calibration.bundle.robust_fit import (fit_robustly, Observations, RobustFit,
                                                       with_all_points)
from selfcal_ros.calibration.estimators.view_effects_choice import (evidence_of_views,
                                                                    left_otherwise_px)
from selfcal_ros.calibration.initialisation.problem import SelfCalibrationProblem
from selfcal_ros.calibration.uncertainty.suppositions import Supposition
from selfcal_ros.findings.finding import Finding
from selfcal_ros.geometry.projective import lengths

#: Least gain of log probability for which shifts are tried: odds of twenty thousand to one. Most
#: cameras have no stabiliser.
LEAST_GAIN = 10.0
#: What shifts leave is no more than this share of the noise before: at first, while it is not yet
#: known what lens and path explain; beside rows that are read in turn; and at last.
LEFT_AT_FIRST, LEFT_BESIDE_ROWS, LEFT_AT_LAST = 0.9, 0.95, 0.99
#: A fit finds shifts of the size that one step tells, up to this factor.
ALIKE = 2.0
#: The usual shift is at least this share of the root mean square: few images that are torn, or
#: turned over, are no stabiliser's (Gaussian shifts: 0.83).
SPREAD = 0.4
#: A stabiliser crops a tenth of an image at most, a twentieth at each side. Images that seem to be
#: shifted further (root mean square) have turned, or were read in turn.
LARGEST = 0.05
#: Standard deviations that are tried, pixels.
SIZES_PX = 0.02 * 2.0**(0.5 * np.arange(24))


def with_image_shifts(first: RobustFit, fit: RobustFit, observations: Observations,
                      problem: SelfCalibrationProblem, most: float) -> RobustFit | None:
    """
    Fit with a shift of each image, if the images ask for that.

    Parameters
    ----------
    first : RobustFit
        To start from, with a global shutter.
    fit : RobustFit
        What explains the images best so far, perhaps with rows read in turn.
    observations : Observations
        All that they were to explain, outliers included.
    problem : SelfCalibrationProblem
    most : float
        Share of the noise that may be left.

    Returns
    -------
    RobustFit or None
        None where images are not shifted.

    """
    instants = problem.instants
    if fit.motion.shift is not None or not instants:
        return None
    sigma_px, gain = shift_evidence(fit, problem.size)
    if gain <= LEAST_GAIN:
        return None
    limit_px = most * left_otherwise_px(fit, instants, gain)
    found = _shifted(first, observations, sigma_px)
    if found is None or found.bundle.sigma_px > limit_px or not are_shifts(found):
        return None
    return _shifted(found, observations, _size_after(found))


def are_shifts(fit: RobustFit) -> bool:
    """Tell whether shifts are those of a stabiliser, and of the size that was supposed."""
    assert fit.motion.shift is not None
    beyond = np.log(_size_after(fit) / fit.motion.shift.sigma)
    return bool(abs(beyond) < np.log(ALIKE)) and _spread(fit) > SPREAD


def are_within_crop(fit: RobustFit, size: tuple[int, int]) -> bool:
    """Tell whether shifts, once it is known how rows are read, leave what a stabiliser crops."""
    return shift_px(fit) < LARGEST * max(size)


def shift_px(fit: RobustFit) -> float:
    """Return the root mean square shift of an image, pixels."""
    shift = fit.state.shift
    assert shift is not None
    return float(np.sqrt(np.mean(np.sum(shift**2, axis=1))))


def shift_evidence(fit: RobustFit, size: tuple[int, int]) -> tuple[float, float]:
    """
    Tell how far images are shifted, pixels, and how sure that is; see `evidence_of_views`.

    Parameters
    ----------
    fit : RobustFit
        At its optimum, without shifts.
    size : (int, int)
        Width and height of the image.

    """
    return evidence_of_views(fit, size, Supposition(
        'shifts', SHIFT_NAMES, by_shift(len(fit.bundle.xy)), of_views=True), SIZES_PX)


def shift_findings(fit: RobustFit) -> tuple[Finding, ...]:
    """Say how far images are shifted, root mean square; nothing where they are not."""
    if fit.motion.shift is None:
        return ()
    return (Finding('images_shifted', shift_px=shift_px(fit)),)


def _shifted(fit: RobustFit, observations: Observations, sigma_px: float) -> RobustFit | None:
    """Fit with shifts of this size; what was an outlier without need not be one."""
    state = with_all_points(fit.state, observations)
    if state is None:
        return None
    return fit_robustly(observations, state, replace(fit.motion, shift=shifts(sigma_px)),
                        fit.bundle.priors, fit.bundle.sigma_px)


def _size_after(fit: RobustFit) -> float:
    """Return the most probable size of the shifts that a fit has found, pixels."""
    shift, effects = fit.state.shift, fit.motion.shift
    assert shift is not None and effects is not None
    found = effects.size_after(shift, fit.covariance, fit.bundle.unknowns)
    return float(np.clip(found, SIZES_PX[0], SIZES_PX[-1]))


def _spread(fit: RobustFit) -> float:
    """Return the usual shift over the root mean square."""
    shift = fit.state.shift
    assert shift is not None
    apart = lengths(shift - np.median(shift, axis=0))
    return float(np.median(apart) / np.sqrt(np.mean(apart**2)))
