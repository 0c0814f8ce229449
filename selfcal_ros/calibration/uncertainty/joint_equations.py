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
"""Normal equations of an optimum and of further unknowns that it does not have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.geometry.reduced_system import ReducedSystem


@dataclass(frozen=True)
class JointEquations:
    """
    Normal equations of the unknowns of an optimum and further ones, its points eliminated.

    Attributes
    ----------
    system : ReducedSystem
        With the priors of the optimum; nothing is supposed of the further unknowns.
    place : ndarray of int, shape (n,)
        Where the unknowns of the optimum stand.
    shared : ndarray of int, shape (m,)
        Where the further unknowns stand that all views share.
    of_views : ndarray of int, shape (V, w)
        Where those stand that every view has of its own.
    root : ndarray, shape (N, 1)
        Roots of the observations' weights, 1/px.

    """

    system: ReducedSystem
    place: np.ndarray
    shared: np.ndarray
    of_views: np.ndarray
    root: np.ndarray


def joint_equations(fit: RobustFit, shared: Sequence[np.ndarray],
                    of_views: Sequence[np.ndarray] = (), variance_inflation: float = 1.0,
                    ) -> JointEquations:
    """
    Put the unknowns of an optimum and further ones into one system of normal equations.

    Parameters
    ----------
    fit : RobustFit
        At its optimum.
    shared : sequence of ndarray, shape (N, 2, m)
        Derivatives of every residual by further unknowns that all views share, pixels.
    of_views : sequence of ndarray, shape (N, 2, w)
        The same of unknowns that every view has of its own.
    variance_inflation : float
        Variance over that with independent errors: observations weigh less by it.

    Returns
    -------
    JointEquations

    """
    bundle, state, linearisation = fit.bundle, fit.state, fit.linearisation
    root = bundle.root_weights(linearisation) / np.sqrt(variance_inflation)
    # many columns: one copy, and weighed in place
    slopes = np.concatenate([linearisation.shared, *shared, linearisation.view, *of_views],
                            axis=2)
    slopes *= root[..., None]
    first, view = linearisation.shared.shape[2], linearisation.view.shape[2]
    own = view + sum(columns.shape[2] for columns in of_views)
    count = slopes.shape[2] - own
    system = bundle.blocks.unreduced_rows(
        slopes, own, linearisation.eliminated * root[..., None],
        linearisation.residual * root).reduced()
    by_view = np.arange(count, len(system.matrix)).reshape(bundle.blocks.view_count, own)
    place = np.r_[:first, by_view[:, :view].ravel()]
    bundle.add_priors(system, state, place)
    gauge = bundle.model.gauge(state, bundle.unknowns)
    if gauge is not None:
        wide = np.zeros(len(system.matrix))
        wide[place] = gauge
        system.add_gauge(float(np.mean(system.diagonal[place])), wide)
    return JointEquations(system, place, np.arange(first, count), by_view[:, view:], root)
