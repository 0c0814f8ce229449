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
"""What the covariance of a camera that only rotates has to allow for."""

from __future__ import annotations

import numpy as np

from selfcal_ros.calibration.uncertainty.assessed_estimate import (
    allow_for_distortion_misfit, allow_for_hidden_decentring, allow_for_prism, allow_for_segments,
    allow_for_uneven_ground, allow_for_uneven_growth, allowing_for_growth, apply_lens_posterior,
    AssessedEstimate, Chain)
from selfcal_ros.calibration.uncertainty.hidden_lever import hidden_lever


def rotation_corrections(may_miss: bool, choices: np.ndarray,
                         instants: tuple[float, ...] = ()) -> Chain:
    """
    Return what the covariance of rotations has to allow for.

    Parameters
    ----------
    may_miss : bool
        Whether the camera may miss the point that it turns about.
    choices : ndarray, shape (k, k)
        Covariance that choices on the way to the optimum add.
    instants : tuple of float
        Of the views, where the focal length may have varied.

    Returns
    -------
    Chain

    """
    def allow_for_choices(found: AssessedEstimate) -> AssessedEstimate:
        return found.widened(choices)

    return Chain((allow_for_distortion_misfit, allow_for_segments, allow_for_choices,
                  allowing_for_growth(instants), allow_for_uneven_ground,
                  allow_for_uneven_growth, apply_lens_posterior,
                  allow_for_hidden_decentring, allow_for_prism,
                  *((_allow_for_lever,) if may_miss else ())))


def _allow_for_lever(found: AssessedEstimate) -> AssessedEstimate:
    """Allow for a lever between the camera and the point that rests, too short to be seen."""
    lever = hidden_lever(found.fit, found.variance_inflation)
    return found.widened(lever.covariance, lever.findings(found.covariance))
