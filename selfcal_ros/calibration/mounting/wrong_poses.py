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
Outliers among the poses of the body.

Each pose is tested against the mount and the errors that the other poses give (a deletion test,
with externally studentised residuals). Few poses leave few degrees of freedom:
then even a large misfit may be chance.
"""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.mounting.pose_errors import PoseErrors
from selfcal_ros.geometry.distributions import chi2_sf, f_sf

#: One wrong verdict on a pose in so many calibrations.
FALSE_ALARM = 0.02
#: Without so many degrees of freedom of the others, nothing is set aside.
LEAST_SPARE = 3.0
#: A misfit is free by this share of its variance at least, however far the pose leads.
_LEAST_FREE = 1e-3
#: Variances this near to the smallest are no larger than they must be: misfits may be smaller.
_AT_FLOOR = 1.5


def agreeing(errors: PoseErrors, residual: np.ndarray, spread: np.ndarray, keep: np.ndarray,
             measured: np.ndarray) -> np.ndarray:
    """
    Tell which poses agree with the others.

    Parameters
    ----------
    errors : PoseErrors
        As the poses that count show them.
    residual : ndarray, shape (m, 6)
        Misfits of the state that these poses give.
    spread : ndarray, shape (m, 6, 6)
        Covariance of what that state predicts.
    keep : ndarray of bool, shape (m,)
        Which poses count. The others may come back.
    measured : ndarray of bool, shape (6,)
        Components that the poses measure.

    Returns
    -------
    ndarray of bool, shape (m,)

    """
    blocks = [list(kind) for kind in errors.axes if kind and measured[list(kind)].all()]
    level = FALSE_ALARM / max(len(residual) * len(blocks), 1)
    agree = np.ones(len(residual), bool)
    whole = errors.covariances
    for block in blocks:
        C, P = (one[:, block][:, :, block] for one in (whole, spread))
        whiten = np.linalg.inv(np.linalg.cholesky(C))
        # what counts has bent the state towards itself, what does not has not
        free = np.eye(len(block)) - np.where(keep, 1, -1)[:, None, None] * (
            whiten @ P @ np.swapaxes(whiten, 1, 2))
        values, axes = np.linalg.eigh(free)
        along = np.einsum('mji,mjk,mk->mi', axes, whiten, residual[:, block])
        misfit = (along**2 / np.maximum(values, _LEAST_FREE)).sum(axis=1)
        own = [k for k, kind in enumerate(errors.axes) if not kind or list(kind) == block]
        if errors.stated[own].all():
            agree &= chi2_sf(misfit, len(block)) > level
            continue
        spare = np.maximum(values[keep].sum() - len(block) * keep, 1e-3)
        left = np.maximum((along[keep]**2).sum() - misfit * keep, 1e-9) / spare
        if (errors.variances[own] < _AT_FLOOR * errors.floors[own]).all():
            left = np.maximum(left, 1.0)
        chance = f_sf(misfit / len(block) / left, len(block), spare)
        agree &= (chance > level) | (spare < LEAST_SPARE)
    return agree
