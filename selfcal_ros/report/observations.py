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
"""Which observations a calibration rests on, and how far they are from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from selfcal_ros.calibration.result import Calibration
from selfcal_ros.values.tracks import Tracks

#: Observations farther than so many sigmas from the prediction were rejected.
OUTLIER_SIGMAS = 4.0


@dataclass(frozen=True)
class ObservationTable:
    """
    Observations of the reconstructed points.

    Attributes
    ----------
    view : ndarray of int, shape (N,)
        Index of the view in the reconstruction.
    track : ndarray of int, shape (N,)
    xy : ndarray, shape (N, 2)
        Pixels, as measured.
    residual : ndarray, shape (N, 2)
        Predicted less measured, pixels; NaN where the lens does not see.
    used : ndarray of bool, shape (N,)
        False for outliers.

    """

    view: np.ndarray
    track: np.ndarray
    xy: np.ndarray
    residual: np.ndarray
    used: np.ndarray


def observations(result: Calibration, tracks: Tracks) -> ObservationTable:
    """
    Predict the observations of the reconstructed points.

    Parameters
    ----------
    result : Calibration
    tracks : Tracks
        Those that were calibrated from.

    Returns
    -------
    ObservationTable

    """
    shape = result.reconstructed
    rows, view, point = shape.places_of(tracks.frame, tracks.track)
    xy = tracks.xy[rows]
    X = shape.when_seen(view, point, xy)
    # a homogeneous point has no sign: take the one that most of its views see where they look
    # as the camera of the mean focal length would see them
    plain, scale = result.steadied(view, xy)
    along = np.nan_to_num(np.einsum('ni,ni->n', X, result.camera.rays(plain)))
    balance = np.bincount(point, np.sign(along), minlength=len(shape.points))
    ahead = X * np.where(balance[point] < 0, -1, 1)[:, None]
    residual = (result.camera.project(ahead) - plain) * scale
    with np.errstate(invalid='ignore', over='ignore'):
        distance = np.linalg.norm(residual, axis=1)
        finite = np.sort(distance[np.isfinite(distance)])
        limit = OUTLIER_SIGMAS * result.noise_sigma_px
        # a lens field that was allowed for is no part of the camera: it stays in the residuals
        if 0 < result.observation_count <= len(finite):
            limit = max(limit, finite[result.observation_count - 1])
        used = distance <= limit
    return ObservationTable(view, tracks.track[rows], xy, residual, used)
