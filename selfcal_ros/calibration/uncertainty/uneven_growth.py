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
What is not known of a focal length that grows steadily: steadily in what?

    log f = log f0 + r c + b (c² - mean),   c from -1/2 to 1/2

Where the focal length grows by as much in every interval, b is -r² / 2. Where its inverse falls
so, b is r² / 2. The estimate takes b for zero. With a zoom of a tenth that is 0.1 % of the focal
length. Where turns and translations hide it, principal points follow. So b has a standard
deviation of r² / 2, and one step tells what the images say of it. What it may do is added to the
covariance of the camera. So is a growth r itself that the images hint at, where the estimate has
none: too little, or too few tracks say so to believe it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.bundle.zoom import ZoomModel
from selfcal_ros.calibration.uncertainty.suppositions import (added_covariance, free_response,
                                                              joint_information, Supposition,
                                                              Tested)

#: A growth that is so many sigmas from none is held by the sigmas of the camera.
DOUBTFUL_SIGMAS = 2.5


@dataclass(frozen=True)
class UnevenGrowth:
    """
    What a growth of the focal length that is not quite steady may do.

    Attributes
    ----------
    of_views : ndarray, shape (V,)
        Variance of the log of each view's focal length.
    covariance : ndarray, shape (k, k)
        To add to that of the unknowns of the lens.

    """

    of_views: np.ndarray
    covariance: np.ndarray


def uneven_growth(fit: RobustFit, variance_inflation: float = 1.0) -> UnevenGrowth | None:
    """
    Ask the images of an optimum whether a steady growth bends.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    variance_inflation : float
        Variance of the estimate over that with independent errors of the images.

    Returns
    -------
    UnevenGrowth or None
        None where the focal length does not grow steadily.

    """
    model, zoom = fit.motion.zoom, fit.state.zoom
    if model is None or zoom is None or not model.is_steady:
        return None
    size = 0.5 * model.rate_of(zoom.log_focal)**2
    if not size:
        return None
    bend = model.course**2 - np.mean(model.course**2)
    tested = _tested(fit, bend, variance_inflation)
    return UnevenGrowth(tested.about_zero(size**2)[0, 0] * bend**2,
                        added_covariance(fit, tested, size**2))


def possible_growth(fit: RobustFit, instants: tuple[float, ...],
                    variance_inflation: float = 1.0) -> np.ndarray:
    """
    Ask the images of an optimum whether a focal length grows that was taken for constant.

    Parameters
    ----------
    fit : RobustFit
        At its optimum of constant focal length.
    instants : tuple of float
        Of `ZoomModel`.
    variance_inflation : float
        Variance of the estimate over that with independent errors of the images.

    Returns
    -------
    ndarray, shape (k, k)
        To add to the covariance of the unknowns of the lens; zero where nothing hints at it.

    """
    tested = _tested(fit, ZoomModel(instants, 0.0).course, variance_inflation)
    shift = (free_response(fit, tested) @ tested.value) * (tested.sigmas > DOUBTFUL_SIGMAS)
    return np.outer(shift, shift)


def _tested(fit: RobustFit, course: np.ndarray, variance_inflation: float) -> Tested:
    """Test whether the log of the focal length has a part that follows a course (V,)."""
    # a magnification about the principal point, of all that a view sees
    seen = fit.bundle.xy + fit.linearisation.residual - fit.state.lens.values[2:4]
    columns = (course[fit.bundle.view][:, None] * seen)[:, :, None]
    return joint_information(fit, [Supposition('growth', ('growth',), columns)],
                             variance_inflation).test('growth')
