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
Whether the points of an optimum lie ahead of the cameras or behind them (chirality).

A homogeneous point may pass through infinity: then its directions stay ahead of the cameras while
its place is behind them. Noise puts far points there. An optimum that puts many points there by
more than their noise explains the images inside out, and is wrong however small its residuals
are (chirality; Hartley and Zisserman 2004, chapter 21).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import OUTLIER_SIGMAS, RobustFit

#: Points that are farther than this behind their cameras, in sigmas, are so not by noise.
BEHIND_BY = 3.0
#: Rank of what a point's own observations say, relative to their sum.
_FLOOR = 1e-9


def inverse_depths(fit: RobustFit) -> np.ndarray:
    """
    Inverse depth of every point over its sigma with the cameras held.

    Parameters
    ----------
    fit : RobustFit

    Returns
    -------
    ndarray, shape (P,)
        Negative where the point lies behind the cameras that see it.

    """
    state, blocks = fit.state, fit.bundle.blocks
    J = fit.linearisation.eliminated / fit.bundle.sigma_px
    H = blocks.sum_over_points(np.swapaxes(J, 1, 2) @ J)
    floor = _FLOOR * np.einsum('pii->p', H) + 1e-300
    inverse = np.linalg.inv(H + floor[:, None, None] * np.eye(3))
    by_weight = state.tangents[:, 3]
    sigma = np.sqrt(np.einsum('pi,pij,pj->p', by_weight, inverse, by_weight))
    placed = state.placed(blocks) @ state.path.mount.T
    if state.lens.model.is_perspective:
        toward = placed[:, 2]
    else:
        toward = np.einsum('ni,ni->n', placed,
                           state.lens.pixel_directions(fit.observations.xy))
    side = np.sign(blocks.sum_over_points(np.sign(toward)))
    depths: np.ndarray = side * state.points[:, 3] / np.maximum(sigma, 1e-300)
    return depths


def share_behind(fit: RobustFit) -> float:
    """Share of the points that lie on the other side than most, by more than noise."""
    depths = inverse_depths(fit)
    return float(min(np.mean(depths < -BEHIND_BY), np.mean(depths > BEHIND_BY)))


def cost_ahead(fit: RobustFit) -> float:
    """
    Cost, and what it takes to bring all points before their cameras, to second order.

    A point costs no more than all its observations as outliers. The mirror image of a scene, with
    all translations the other way, has the same images: the better of the two counts.
    """
    depths, most = inverse_depths(fit), OUTLIER_SIGMAS**2 * fit.bundle.blocks.length
    return fit.cost + 0.5 * min(float(np.sum(np.minimum(np.minimum(side * depths, 0)**2, most)))
                                for side in (1, -1))


def cost_of_all_ahead(fit: RobustFit, sigma_px: float) -> float:
    """
    Cost of all observations at a common noise, and of points behind: to compare optima by.

    Outliers count what makes them such.
    """
    common = replace(fit, bundle=fit.bundle.with_sigma(sigma_px))
    return cost_ahead(common) + 0.5 * OUTLIER_SIGMAS**2 * fit.outliers


def seen_ahead(fit: RobustFit) -> RobustFit:
    """
    Return a fit with most points before their cameras.

    Its mirror image explains the same: all translations the other way, and all depths.
    """
    if np.mean(inverse_depths(fit) < 0) <= 0.5:
        return fit
    state = fit.state
    path = replace(state.path, translation=-state.path.translation)
    return replace(fit, state=replace(state, path=path,
                                      points=state.points * [1.0, 1.0, 1.0, -1.0]))
