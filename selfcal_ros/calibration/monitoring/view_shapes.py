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
Images that are stretched or sheared, each by its own amount.

A line delay explains rows that are read one after the other as far as the keyframes tell how the
camera moved. A wheel in a joint, or a step of a foot, lies between them: such images are
stretched along their columns and sheared along their rows, each by its own amount. The size of
that follows from the images (type-II maximum likelihood; Bishop 2006, 3.5).
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.uncertainty.random_effects import most_probable_size
from selfcal_ros.calibration.uncertainty.suppositions import joint_information, Supposition

#: Sizes that are tried: displacements at the upper and lower border of the image, pixels.
SIZES_PX = 0.02 * 2.0**(0.5 * np.arange(20))
#: Least gain of log probability over images of one shape.
GAIN = 2.0


def shape_of_views(fit: RobustFit, rows: int, variance_inflation: float,
                   ) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Tell how the lens moves, and how uncertain it gets, where every image has its own shape.

    Parameters
    ----------
    fit : RobustFit
        At its optimum; the unknowns of the lens that are told of are free.
    rows : int
        Height of the image.
    variance_inflation : float
        Variance over that with independent errors.

    Returns
    -------
    step : ndarray, shape (k,)
        Of the unknowns of the lens, beyond that for images of one shape.
    root : ndarray, shape (k, m)
        Root of the covariance that is added to theirs.
        None where the images are of one shape, as far as they tell.

    """
    row = fit.bundle.xy[:, 1] + fit.linearisation.residual[:, 1]
    below = (row - fit.state.lens['cy']) / (rows / 2)
    zero = np.zeros(len(below))
    joint = joint_information(fit, [
        Supposition('stretch', ('stretch',), np.column_stack([zero, below])[:, :, None], True),
        Supposition('shear', ('shear',), np.column_stack([below, zero])[:, :, None], True)],
        max(variance_inflation, 1.0))
    values, vectors = np.linalg.eigh(joint.information)
    values, turned = np.maximum(values, 0), vectors.T @ joint.score
    size_px, gain = most_probable_size(values, turned, SIZES_PX)
    if gain < GAIN:
        return None
    variance = size_px**2 / (1 + size_px**2 * values)
    lens = joint.lens @ vectors
    step: np.ndarray = -lens @ (variance * turned)
    root: np.ndarray = lens * np.sqrt(variance)
    return step, root
