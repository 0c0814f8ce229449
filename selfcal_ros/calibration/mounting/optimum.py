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
"""What an adjustment of a mount gives: the state, its errors and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.mounting.model import Prediction, State
from selfcal_ros.calibration.mounting.pose_errors import PoseErrors


@dataclass(frozen=True)
class Optimum:
    """
    The estimate.

    Attributes
    ----------
    state : State
    covariance : ndarray, shape (16 + k, 16 + k)
        Of all unknowns; what is held has zeros, what is open `VAGUE_M` and its like.
    information : ndarray, shape (16 + k, 16 + k)
        Of the poses, the images and the facts.
    errors : PoseErrors
    cautious : PoseErrors
        The same with room for what few poses leave open of them; covariance and information are
        by these.
    freedom : ndarray, shape (K,)
        Degrees of freedom of each variance.
    keep : ndarray of bool, shape (m,)
        Which misfits count.
    cost : float
        Robust, for comparing starts.
    prediction : Prediction

    """

    state: State
    covariance: np.ndarray
    information: np.ndarray
    errors: PoseErrors
    cautious: PoseErrors
    freedom: np.ndarray
    keep: np.ndarray
    cost: float
    prediction: Prediction
