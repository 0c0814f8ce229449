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
A stated lens model against the lens that the images would choose.

Where the residuals of a stated lens show a smooth field, either the lens is like no model, or the
model is the wrong one. So the lens is chosen anew, as if nothing were stated. If that leaves
little of the field, the statement is to blame, and not the lens.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from selfcal_ros.calibration.bundle.robust_fit import RobustFit
from selfcal_ros.calibration.estimators.lens_selection import choose_lens
from selfcal_ros.calibration.uncertainty.distortion_misfit import (DistortionMisfit,
                                                                   find_distortion_misfit)
from selfcal_ros.calibration.uncertainty.facts_verdict import (Contradiction, LENS_MODEL,
                                                               MOVED_FRACTION)
from selfcal_ros.calibration.uncertainty.hidden_decentring import possible_decentring
from selfcal_ros.geometry.camera import MATRIX_PARAMETERS
from selfcal_ros.geometry.camera_facts import CameraFacts

#: A model that leaves more than this share of the field does not explain it.
LEFT_SHARE = 0.5
#: Of the coefficients that were held, those are told that are so many sigmas off.
TOLD_SIGMAS = 3.0


def contradicted_lens(fit: RobustFit, stated: CameraFacts, size: tuple[int, int],
                      variance_inflation: float, field: DistortionMisfit,
                      ) -> Contradiction | None:
    """
    Hold a stated lens model against the lens that the images would choose.

    Parameters
    ----------
    fit : RobustFit
        At its optimum, with the stated lens.
    stated : CameraFacts
        As they were stated; a lens that was left open contradicts nothing.
    size : (int, int)
        Width and height of the image.
    variance_inflation : float
        Variance of the estimate over that with independent errors.
    field : DistortionMisfit
        What the stated lens leaves.

    Returns
    -------
    Contradiction or None
        None where no other lens explains most of the field.

    """
    if stated.distortion == 'auto':
        return None
    chosen = choose_lens(fit, replace(stated, distortion='auto'), size,
                         lambda _: variance_inflation, lambda *_: True)
    if chosen.facts.distortion == stated.distortion:
        return None
    other = chosen.fit
    left = find_distortion_misfit(other, size, variance_inflation, possible_decentring(other))
    if left is not None and left.rms_px > LEFT_SHARE * field.rms_px:
        return None
    as_surely = other.bundle.with_sigma(fit.bundle.sigma_px)
    gain = 2 * (fit.cost - as_surely.cost(other.state)) / variance_inflation
    # coefficients of two models are not comparable
    before, names = fit.state.camera().parameters, len(MATRIX_PARAMETERS)
    moved = other.state.camera().parameters[:names] - before[:names]
    shift = np.r_[moved, np.zeros(len(before) - names)]
    return Contradiction(LENS_MODEL, _preferred(fit, other, chosen.facts.distortion, stated),
                         float(np.sqrt(max(gain, 0.0))), shift,
                         bool(np.abs(moved).max() > MOVED_FRACTION * fit.state.lens['f']))


def _preferred(fit: RobustFit, other: RobustFit, name: str, stated: CameraFacts,
               ) -> list[dict[str, Any]]:
    """Name the coefficients that were held, or the other model."""
    lens, (_, _, _, free) = other.state.lens, fit.lenses()[0]
    if lens.model is not fit.state.lens.model:
        return [{'name': 'lens', 'value': name, 'sigma': 0.0, 'stated': stated.distortion}]
    sigma = dict(zip(lens.names, np.sqrt(np.diag(other.lens_covariance))))
    held = [one for one in lens.model.coefficients if one not in free]
    told = [one for one in held if abs(lens[one]) > TOLD_SIGMAS * sigma[one]] or held
    return [{'name': one, 'value': float(lens[one]), 'sigma': float(sigma[one]), 'stated': 0.0}
            for one in told]
